"""What leaves the factory: calibration files of units with their manifest, written and read back."""
