"""Which audits of a lot may be wrong: one recording for two units, exchanged files, loads in another unit.

A doubt is about one audit. It is set aside and named, and the others decide on the lot; a person may confirm it.
"""

from collections.abc import Mapping

import numpy as np

from softcal.core.unit.audit_reading import AuditReading
from softcal.core.unit.method import ReleaseConfig
from softcal.core.words.reason import Reason, reason

Readings = Mapping[str, AuditReading]
Doubts = dict[str, Reason]


def doubtful_audits(
    readings: Readings,
    rules: ReleaseConfig = ReleaseConfig(),  # noqa: B008 - frozen
) -> Doubts:
    """Return the audits that may not be what they are said to be, by serial, and why.

    Args:
        readings: by serial, of one lot, without those that a person confirmed.
        rules: what is out of line.
    """
    found: Doubts = {}
    for look in (_one_recording, _exchanged, _out_of_line, _strangers):
        found |= look({serial: one for serial, one in readings.items() if serial not in found}, rules)
    return found


def _one_recording(readings: Readings, _: ReleaseConfig) -> Doubts:
    of: dict[str, list[str]] = {}
    for serial, reading in readings.items():
        of.setdefault(reading.output_sha256, []).append(serial)
    return {
        serial: reason("doubt.one_recording", other=next(name for name in same if name != serial))
        for same in of.values()
        if len(same) > 1
        for serial in same
    }


def _exchanged(readings: Readings, rules: ReleaseConfig) -> Doubts:
    """A zero that moved moves all units alike; only an exchange carries each of two to the other's.

    How far units rest from where they did is what the other audits of the lot show.
    """
    found: Doubts = {}
    serials = list(readings)
    for k, first in enumerate(serials):
        for second in serials[k + 1 :]:
            moved = [_moved(one) for name, one in readings.items() if name not in (first, second)]
            if len(moved) < rules.least_others:
                continue
            pair = readings[first], readings[second]
            usual = float(np.median(moved))
            # Three quarters of a normal distribution are within 1.15 SD; a quarter may be exchanged themselves.
            shown = float(np.quantile(np.abs(np.subtract(moved, usual)), 0.75)) / 1.15
            spread = max(shown, rules.least_rest * min(one.span for one in pair))
            far = (rules.exchanged * spread) ** 2
            # By how much, squared, each audit rests nearer to where the other unit does than to its own.
            nearer = [
                (_moved(own) - usual) ** 2 - (own.audit_rest - other.unit_rest - usual) ** 2
                for own, other in (pair, pair[::-1])
            ]
            if min(nearer) > far:
                for own, name in zip(pair, (second, first), strict=True):
                    serial = first if name == second else second
                    found[serial] = reason("doubt.exchanged", other=name, rest=own.audit_rest, unit_rest=own.unit_rest)
    return found


def _moved(reading: AuditReading) -> float:
    return reading.audit_rest - reading.unit_rest


def _out_of_line(readings: Readings, rules: ReleaseConfig) -> Doubts:
    found: Doubts = {}
    for serial, reading in readings.items():
        others = [other.gain for name, other in readings.items() if name != serial]
        if len(others) < rules.least_others:
            continue
        usual = float(np.median(others))
        if usual > 0 and not usual / rules.most_gain <= reading.gain <= usual * rules.most_gain:
            found[serial] = reason("doubt.gain", gain=reading.gain, usual=usual, others=len(others))
    return found


def _strangers(readings: Readings, rules: ReleaseConfig) -> Doubts:
    """Name an audit that rests far from where its unit does while the others rest where theirs do."""
    found: Doubts = {}
    moved = {serial: _moved(one) / max(one.span, 1e-12) for serial, one in readings.items()}
    for serial, own in moved.items():
        others = [other for name, other in moved.items() if name != serial]
        if len(others) < rules.least_others:
            continue
        usual = float(np.median(others))
        farthest = max(abs(other - usual) for other in others)
        if abs(own - usual) > max(rules.stranger_rest, rules.stranger_factor * farthest):
            one = readings[serial]
            found[serial] = reason("doubt.stranger", rest=one.audit_rest, unit_rest=one.unit_rest, others=len(others))
    return found
