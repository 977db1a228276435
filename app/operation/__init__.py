"""A calibrated unit in use: estimates over a file or a stream, the map following the drift."""
