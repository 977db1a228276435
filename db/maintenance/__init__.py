"""Maintenance of a registry: checks, backups, upgrades, synchronisation of two registries."""
