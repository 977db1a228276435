"""A unit in long use: the stream in, cycles and activities, the drift that is followed, the map that is applied."""
