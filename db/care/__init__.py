"""What keeps a registry whole: checks, backup and restore, upgrades, bringing two registries together."""
