"""What is known and stays known: lots, recordings, networks, calibrations, and their trail."""
