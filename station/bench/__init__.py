"""Opening of a station: drivers by kind, station file, bench of devices, simulated station."""
