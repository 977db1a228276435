"""The numerics of softcal: no file, port, clock, environment or global random state here."""
