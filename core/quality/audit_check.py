"""Whether the audits of a lot can all be true: one recording for two units, exchanged files, loads in another unit."""

from collections.abc import Mapping

import numpy as np

from softcal.core.errors import InputError
from softcal.core.unit.audit_reading import AuditReading

MOST_GAIN = 3.0
"""Units of one kind do not differ by this factor in what they answer (`FindingConfig.stretch`)."""

LEAST_OTHERS = 3
"""A reading is out of line with at least so many others."""

SAME_REST, OTHER_REST = 0.01, 0.05
"""Shares of a unit's span: outputs at rest nearer than the first are one unit's, further apart than the second two."""

NOTHING = "nothing was released: put the right file into audit/ and run the batch again"


def check_audits(readings: Mapping[str, AuditReading]) -> None:
    """Refuse audits that contradict one another.

    Args:
        readings: by serial, of one lot.

    Raises:
        InputError: which audits cannot be true, and why; nothing may be released on them.
    """
    _check_recordings(readings)
    _check_exchanged(readings)
    _check_gains(readings)


def _check_recordings(readings: Mapping[str, AuditReading]) -> None:
    owners: dict[str, str] = {}
    for serial, reading in readings.items():
        first = owners.setdefault(reading.output_sha256, serial)
        if first != serial:
            raise InputError(f"the audits of {first} and {serial} are one recording; one is of another unit; {NOTHING}")


def _check_exchanged(readings: Mapping[str, AuditReading]) -> None:
    """A zero that moved moves all units alike; only an exchange carries each of two to the other's."""
    serials = list(readings)
    for k, first in enumerate(serials):
        for second in serials[k + 1 :]:
            one, other = readings[first], readings[second]
            span = min(one.span, other.span)
            if abs(one.unit_rest - other.unit_rest) < OTHER_REST * span:
                continue
            moved = max(abs(one.audit_rest - other.unit_rest), abs(other.audit_rest - one.unit_rest))
            if moved < SAME_REST * span:
                raise InputError(
                    f"the audits of {first} and {second} look exchanged: each rests at {one.audit_rest:.4g} and "
                    f"{other.audit_rest:.4g} where the other unit does; {NOTHING}"
                )


def _check_gains(readings: Mapping[str, AuditReading]) -> None:
    for serial, reading in readings.items():
        others = [other.gain for name, other in readings.items() if name != serial]
        if len(others) < LEAST_OTHERS:
            continue
        usual = float(np.median(others))
        if usual > 0 and not usual / MOST_GAIN <= reading.gain <= usual * MOST_GAIN:
            raise InputError(
                f"the audit of {serial} contradicts the others: its estimates are {reading.gain:.3g} x the reference, "
                f"those of the {len(others)} others {usual:.3g} x; is its reference in another unit, or of another "
                f"sensor? {NOTHING}"
            )
