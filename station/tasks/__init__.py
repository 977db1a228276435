"""Tasks of a station: record, read at rest, self-test, find devices, serve."""
