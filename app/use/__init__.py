"""A calibrated unit in use: estimates over a file or a live stream, and the map that follows the drift."""
