"""The shared network f: its evaluation and its training."""
