"""What leaves the factory: calibration files with their manifest, written and read back."""
