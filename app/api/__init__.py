"""What `import softcal` gives: arrays and pandas in, pandas out. Everything here calls what the command line calls."""
