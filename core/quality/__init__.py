"""Decisions about lots, lines and stations from facts: gate, control chart, gauge study, yields, audits, rules."""
