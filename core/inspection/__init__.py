"""Inspection of a recording before any fit: invalid samples, gaps, steps, lag of the reference."""
