"""What keeps a registry whole: checks, backups, upgrades, bringing two registries together."""
