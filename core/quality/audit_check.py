"""Which audits of a lot may be wrong: one recording for two units, exchanged files, loads in another unit.

A doubt is about one audit. It is set aside and named, and the others decide on the lot; a person may confirm it.
"""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from softcal.core.messages.reason import Reason, reason
from softcal.core.unit.measured_error import AuditResult
from softcal.core.unit.method import Method, ReleaseConfig

Readings = Mapping[str, AuditResult]
SuspectAudits = dict[str, Reason]


def find_suspect_audits(readings: Readings, method: Method) -> SuspectAudits:
    """Return the audits of one lot that may not be what they are said to be, by serial, and why.

    Those that a person confirmed are not among the readings.
    """
    suspects = _one_recording(readings)
    for check in (_exchanged, _out_of_line, _foreign_units):
        suspects |= check({serial: one for serial, one in readings.items() if serial not in suspects}, method)
    return suspects


def _one_recording(readings: Readings) -> SuspectAudits:
    by_output: dict[str, list[str]] = {}
    for serial, reading in readings.items():
        by_output.setdefault(reading.output_sha256, []).append(serial)
    return {
        serial: reason("doubt.one_recording", other=next(name for name in serials if name != serial))
        for serials in by_output.values()
        if len(serials) > 1
        for serial in serials
    }


def _exchanged(readings: Readings, method: Method) -> SuspectAudits:
    """A zero that moved moves all units alike; only an exchange carries each of two to the other's.

    How far units rest from where they did is what the other audits of the lot show.
    """
    suspects, config = SuspectAudits(), method.release
    for first, second in combinations(readings, 2):
        shifts = [_rest_shift(one) for name, one in readings.items() if name not in (first, second)]
        if len(shifts) < config.min_others:
            continue
        pair = readings[first], readings[second]
        median = float(np.median(shifts))
        # Three quarters of a normal distribution are within 1.15 SD; a quarter may be exchanged themselves.
        scale = float(np.quantile(np.abs(np.subtract(shifts, median)), 0.75)) / 1.15
        spread = max(scale, config.min_rest * min(one.span for one in pair))
        # By how much, squared, each audit rests nearer to where the other unit does than to its own.
        nearer = [
            (_rest_shift(unit) - median) ** 2 - (unit.audit_rest - other.unit_rest - median) ** 2
            for unit, other in (pair, pair[::-1])
        ]
        if min(nearer) > (config.exchanged * spread) ** 2:
            for serial, other_serial in ((first, second), (second, first)):
                rest, unit_rest = readings[serial].audit_rest, readings[serial].unit_rest
                suspects[serial] = reason("doubt.exchanged", other=other_serial, rest=rest, unit_rest=unit_rest)
    return suspects


def _rest_shift(reading: AuditResult) -> float:
    return reading.audit_rest - reading.unit_rest


def _compare_to_others(
    values: Mapping[str, float], config: ReleaseConfig
) -> Iterator[tuple[str, float, list[float], float]]:
    """Yield each serial and its value with those of the others and their median, where there are enough others."""
    for serial, value in values.items():
        others = [other for name, other in values.items() if name != serial]
        if len(others) >= config.min_others:
            yield serial, value, others, float(np.median(others))


def _out_of_line(readings: Readings, method: Method) -> SuspectAudits:
    suspects, stretch = SuspectAudits(), method.findings.stretch
    gains = {serial: one.line.gain for serial, one in readings.items()}
    for serial, gain, others, median in _compare_to_others(gains, method.release):
        if median > 0 and not median / stretch <= gain <= median * stretch:
            suspects[serial] = reason("doubt.gain", gain=gain, usual=median, others=len(others))
    return suspects


def _foreign_units(readings: Readings, method: Method) -> SuspectAudits:
    """Name an audit that rests far from where its unit does while the others rest where theirs do."""
    suspects, config = SuspectAudits(), method.release
    shifts = {serial: _rest_shift(one) / max(one.span, 1e-12) for serial, one in readings.items()}
    for serial, shift, others, median in _compare_to_others(shifts, config):
        farthest = max(abs(other - median) for other in others)
        if abs(shift - median) > max(config.foreign_unit_rest, config.foreign_unit_factor * farthest):
            one = readings[serial]
            suspects[serial] = reason(
                "doubt.foreign_unit", rest=one.audit_rest, unit_rest=one.unit_rest, others=len(others)
            )
    return suspects
