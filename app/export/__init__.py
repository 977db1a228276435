"""Export of calibration files with their manifest, and checks of an export folder."""
