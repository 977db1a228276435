"""What a station does: record, rest, test itself, find its devices, serve."""
