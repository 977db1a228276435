"""The production line: the rig as a use case, the resident station, what the operator's screen may order."""
