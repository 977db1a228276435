"""Recording of a run: samples and their checks."""
