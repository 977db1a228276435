"""Comparison of a recording with the source's: unit of measure and sign of the reference.

Named, never corrected. No I/O here.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array, LabelledRecording

FACTORS: dict[str, dict[str, float]] = {
    "N": {"kgf": 9.80665, "lbf": 4.44822, "gf": 1e3 / 9.80665},
    "kgf": {"N": 9.80665, "lbf": 2.20462},
    "kPa": {"psi": 6.89476, "bar": 100.0, "mmHg": 7.50062},
    "mm": {"in": 25.4, "cm": 10.0},
}
"""Unit of measure → others of its quantity, and the factor between the two."""

MAX_RANGE_RATIO = 1.4
"""How far the ratio of two ranges of loads may lie from a factor: both were pressed by one programme."""

ONE_SIDED = 0.3
"""A reference is of one sign where its other end is at most this part of it."""


def compare_recordings(source: LabelledRecording, other: LabelledRecording) -> tuple[Reason, ...]:
    """Return findings that a reference has another unit of measure than the source's, or another sign.

    A reference in another unit has that factor in the loads and, nearer than 1, in the loads by output, too: an
    insensitive sensor shows the second alone, a light press the first alone.
    """
    if any(np.ptp(values) == 0 for one in (source, other) for values in (one.reference, one.unlabelled.output)):
        # A channel that never moves shows neither.
        return ()
    return (*_signs(source, other), *_units(source, other))


def compare_with_source(source: LabelledRecording, others: Iterable[LabelledRecording]) -> tuple[Reason, ...]:
    """Return the findings of several recordings relative to the source, each with its serial."""
    return tuple(
        reason("inspect.of_unit", serial=other.serial, what=finding)
        for other in others
        for finding in compare_recordings(source, other)
    )


def _signs(source: LabelledRecording, other: LabelledRecording) -> Iterator[Reason]:
    sides = [_sign_under_load(one.reference) for one in (source, other)]
    if sides[0] * sides[1] < 0:
        yield reason("inspect.other_sign", column="reference")
    # Against the load itself, whichever sign it is written with.
    directions = [(side or 1) * one.direction for side, one in zip(sides, (source, other), strict=True)]
    if directions[0] * directions[1] < 0 and (0 not in sides or sides == [0, 0]):
        yield reason("inspect.other_sign", column="output")


def _units(source: LabelledRecording, other: LabelledRecording) -> Iterator[Reason]:
    loads, outputs = (
        _span(b) / max(_span(a), np.finfo(float).tiny)
        for a, b in ((source.reference, other.reference), (source.unlabelled.output, other.unlabelled.output))
    )
    if min(loads, outputs) <= 0:
        return
    unit = source.reference_unit
    factors = {**FACTORS.get(unit, {}), f"k{unit} or m{unit}": 1e3}
    log_ratio = abs(np.log(loads))
    unit_name = min(factors, key=lambda name: abs(log_ratio - np.log(factors[name])))
    by_output = np.log(loads / outputs) * np.sign(np.log(loads))
    is_near = abs(log_ratio - np.log(factors[unit_name])) < np.log(MAX_RANGE_RATIO)
    if is_near and abs(by_output - np.log(factors[unit_name])) < abs(by_output):
        yield reason("inspect.other_unit", times=loads, factor=factors[unit_name], named=unit_name, unit=unit)


def _sign_under_load(reference: Array) -> int:
    """Return the sign of a reference under load; 0 for both signs."""
    low, high = np.quantile(reference, (0.01, 0.99))
    small, large = sorted((abs(low), abs(high)))
    return int(np.sign(low + high)) if small <= ONE_SIDED * large else 0


def _span(values: Array) -> float:
    return float(np.subtract(*np.quantile(values, (0.99, 0.01))))
