"""The devices of a station: the catalogue, the station file, and the bench."""
