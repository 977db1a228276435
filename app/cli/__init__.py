"""The console script `softcal`: a module a command; each parses, calls a use case and prints."""
