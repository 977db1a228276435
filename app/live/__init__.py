"""Estimates while the samples come: where they are read from, where they go, what the terminal shows."""
