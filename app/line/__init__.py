"""The production line: the rig, the resident station, orders of the operator's screen."""
