"""Devices of a station: keys of their configuration, what a driver declares, calibration of a load cell."""
