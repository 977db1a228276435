"""Maintenance and quality figures of the registry: checks, studies, yields, support, trims."""
