"""The numerics of softcal: numbers in, numbers out. No file, port, clock, environment or global random state here."""
