"""A lot from its folder to verdicts: train f, fit every unit, audit, report; no screen here."""
