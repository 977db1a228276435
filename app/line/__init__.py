"""The production line: the rig, the resident station, what the operator's screen may order."""
