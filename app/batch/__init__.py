"""A lot from its folder to verdicts: train f, fit every unit in workers, report; no screen here."""
