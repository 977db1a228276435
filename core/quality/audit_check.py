"""Which audits of a lot may be wrong: one recording for two units, exchanged files, loads in another unit.

A doubt is about one audit. It is set aside and named, and the others decide on the lot; a person may confirm it.
"""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from softcal.core.messages.reason import Reason, reason
from softcal.core.unit.method import Method, ReleaseConfig
from softcal.core.unit.state import AuditResult

Readings = Mapping[str, AuditResult]
Doubts = dict[str, Reason]


def doubtful_audits(readings: Readings, method: Method) -> Doubts:
    """Return the audits of one lot that may not be what they are said to be, by serial, and why.

    Those that a person confirmed are not among the readings.
    """
    doubts = _one_recording(readings)
    for look in (_exchanged, _out_of_line, _foreign_units):
        doubts |= look({serial: one for serial, one in readings.items() if serial not in doubts}, method)
    return doubts


def _one_recording(readings: Readings) -> Doubts:
    of: dict[str, list[str]] = {}
    for serial, reading in readings.items():
        of.setdefault(reading.output_sha256, []).append(serial)
    return {
        serial: reason("doubt.one_recording", other=next(name for name in same if name != serial))
        for same in of.values()
        if len(same) > 1
        for serial in same
    }


def _exchanged(readings: Readings, method: Method) -> Doubts:
    """A zero that moved moves all units alike; only an exchange carries each of two to the other's.

    How far units rest from where they did is what the other audits of the lot show.
    """
    doubts, config = Doubts(), method.release
    for first, second in combinations(readings, 2):
        moved = [_moved(one) for name, one in readings.items() if name not in (first, second)]
        if len(moved) < config.min_others:
            continue
        pair = readings[first], readings[second]
        usual = float(np.median(moved))
        # Three quarters of a normal distribution are within 1.15 SD; a quarter may be exchanged themselves.
        shown = float(np.quantile(np.abs(np.subtract(moved, usual)), 0.75)) / 1.15
        spread = max(shown, config.min_rest * min(one.span for one in pair))
        # By how much, squared, each audit rests nearer to where the other unit does than to its own.
        nearer = [
            (_moved(own) - usual) ** 2 - (own.audit_rest - other.unit_rest - usual) ** 2
            for own, other in (pair, pair[::-1])
        ]
        if min(nearer) > (config.exchanged * spread) ** 2:
            for serial, other_serial in ((first, second), (second, first)):
                rest, unit_rest = readings[serial].audit_rest, readings[serial].unit_rest
                doubts[serial] = reason("doubt.exchanged", other=other_serial, rest=rest, unit_rest=unit_rest)
    return doubts


def _moved(reading: AuditResult) -> float:
    return reading.audit_rest - reading.unit_rest


def _beside(values: Mapping[str, float], config: ReleaseConfig) -> Iterator[tuple[str, float, list[float], float]]:
    """Yield each serial and its value with those of the others and their median, where there are enough others."""
    for serial, own in values.items():
        others = [other for name, other in values.items() if name != serial]
        if len(others) >= config.min_others:
            yield serial, own, others, float(np.median(others))


def _out_of_line(readings: Readings, method: Method) -> Doubts:
    doubts, stretch = Doubts(), method.findings.stretch
    gains = {serial: one.line.gain for serial, one in readings.items()}
    for serial, gain, others, usual in _beside(gains, method.release):
        if usual > 0 and not usual / stretch <= gain <= usual * stretch:
            doubts[serial] = reason("doubt.gain", gain=gain, usual=usual, others=len(others))
    return doubts


def _foreign_units(readings: Readings, method: Method) -> Doubts:
    """Name an audit that rests far from where its unit does while the others rest where theirs do."""
    doubts, config = Doubts(), method.release
    moved = {serial: _moved(one) / max(one.span, 1e-12) for serial, one in readings.items()}
    for serial, own, others, usual in _beside(moved, config):
        farthest = max(abs(other - usual) for other in others)
        if abs(own - usual) > max(config.foreign_unit_rest, config.foreign_unit_factor * farthest):
            one = readings[serial]
            doubts[serial] = reason(
                "doubt.foreign_unit", rest=one.audit_rest, unit_rest=one.unit_rest, others=len(others)
            )
    return doubts
