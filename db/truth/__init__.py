"""What is known and stays known: lots, recordings, networks, calibrations, what is in use, and the trail of it all."""
