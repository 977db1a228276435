"""A lot from its folder to verdicts: train f, fit every unit, audit, report, trim; no screen here."""
