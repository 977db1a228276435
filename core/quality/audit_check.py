"""Whether the audits of a lot can all be true: one recording for two units, exchanged files, loads in another unit."""

from collections.abc import Mapping

import numpy as np

from softcal.core.errors import InputError
from softcal.core.unit.audit_reading import AuditReading
from softcal.core.unit.method import ReleaseConfig

NOTHING = "nothing was released: put the right file into audit/ and run the batch again"


def check_audits(
    readings: Mapping[str, AuditReading],
    rules: ReleaseConfig = ReleaseConfig(),  # noqa: B008 - frozen
) -> None:
    """Refuse audits that contradict one another.

    Args:
        readings: by serial, of one lot.
        rules: what cannot be true.

    Raises:
        InputError: which audits cannot be true, and why; nothing may be released on them.
    """
    _check_recordings(readings)
    _check_exchanged(readings, rules)
    _check_gains(readings, rules)
    _check_strangers(readings, rules)


def _check_recordings(readings: Mapping[str, AuditReading]) -> None:
    owners: dict[str, str] = {}
    for serial, reading in readings.items():
        first = owners.setdefault(reading.output_sha256, serial)
        if first != serial:
            raise InputError(f"the audits of {first} and {serial} are one recording; one is of another unit; {NOTHING}")


def _check_exchanged(readings: Mapping[str, AuditReading], rules: ReleaseConfig) -> None:
    """A zero that moved moves all units alike; only an exchange carries each of two to the other's."""
    serials = list(readings)
    for k, first in enumerate(serials):
        for second in serials[k + 1 :]:
            one, other = readings[first], readings[second]
            span = min(one.span, other.span)
            if abs(one.unit_rest - other.unit_rest) < rules.other_rest * span:
                continue
            moved = max(abs(one.audit_rest - other.unit_rest), abs(other.audit_rest - one.unit_rest))
            if moved < rules.same_rest * span:
                raise InputError(
                    f"the audits of {first} and {second} look exchanged: each rests at {one.audit_rest:.4g} and "
                    f"{other.audit_rest:.4g} where the other unit does; {NOTHING}"
                )


def _check_strangers(readings: Mapping[str, AuditReading], rules: ReleaseConfig) -> None:
    """Refuse an audit that rests far from where its unit does while the others rest where theirs do."""
    moved = {serial: (one.audit_rest - one.unit_rest) / max(one.span, 1e-12) for serial, one in readings.items()}
    for serial, own in moved.items():
        others = [other for name, other in moved.items() if name != serial]
        if len(others) < rules.least_others:
            continue
        usual = float(np.median(others))
        farthest = max(abs(other - usual) for other in others)
        if abs(own - usual) > max(rules.stranger_rest, rules.stranger_factor * farthest):
            reading = readings[serial]
            raise InputError(
                f"the audit of {serial} rests at {reading.audit_rest:.4g} where its unit rests at "
                f"{reading.unit_rest:.4g}; the {len(others)} others rest where their units do: is it of another unit? "
                f"{NOTHING}"
            )


def _check_gains(readings: Mapping[str, AuditReading], rules: ReleaseConfig) -> None:
    for serial, reading in readings.items():
        others = [other.gain for name, other in readings.items() if name != serial]
        if len(others) < rules.least_others:
            continue
        usual = float(np.median(others))
        if usual > 0 and not usual / rules.most_gain <= reading.gain <= usual * rules.most_gain:
            raise InputError(
                f"the audit of {serial} contradicts the others: its estimates are {reading.gain:.3g} x the reference, "
                f"those of the {len(others)} others {usual:.3g} x; is its reference in another unit, or of another "
                f"sensor? {NOTHING}"
            )
