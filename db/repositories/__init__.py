"""Repositories of the tables that only grow: lots, recordings, networks, calibrations, and their audit trail."""
