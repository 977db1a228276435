"""Calibrations that line, batch, screens, Python and REST share: audits, decisions, fits of lots, previews, results."""
