"""The console script `softcal`: one module per command; each parses, calls one use case and prints."""
