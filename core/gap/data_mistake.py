"""A mistake in recordings: what it is, where it shows, what would repair it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.gap.method import METHOD
from softcal.core.words.reason import Reason, in_words, reason

Kind = Literal[
    "unit_factor",
    "gain",
    "zero",
    "sign",
    "swapped_columns",
    "swapped_divider",
    "other_unit",
    "swapped_runs",
    "rate",
    "out_of_range",
    "constant",
]


@dataclass(frozen=True)
class DataMistake:
    """One mistake: what it is, where it shows, and what would repair it.

    Args:
        channel: `stage`, `force`, `output`, `temperature` or `time`; `one+other` where exchanged.
        runs: numbers of the runs; empty for all.
        factor: repaired values over recorded ones; None where there is no such number.
    """

    what: Kind
    channel: str
    runs: tuple[int, ...]
    factor: float | None
    evidence: Reason
    repair: Reason

    def record(self) -> dict[str, object]:
        return in_words(vars(self) | {"runs": list(self.runs) or "all"}, "evidence", "repair")


def numbers(case: Case) -> list[int]:
    """Return the numbers of the runs of a case: those of their folders, or their places from 1."""
    names = [run.name for run in case.runs]
    return [int(n) for n in names] if all(n.isdigit() for n in names) else list(range(1, len(names) + 1))


def apart(channel: str, run: int, factor: float, units: Mapping[str, float], others: float = 0.0) -> DataMistake:
    """Return what is wrong with one run against the others: its unit, else its gain.

    Args:
        factor: what brings its values to those of the others.
        units: what values in each must be multiplied by.
        others: logarithm of the factor by which the others differ among themselves.
    """
    evidence = reason("data.run.apart", channel=channel, ratio=1.0 / factor)
    if unit := unit_of(factor, units, others):
        return of_unit(channel, (run,), unit, units[unit], evidence)
    return of_gain(channel, (run,), factor, evidence)


def unit_of(factor: float, units: Mapping[str, float], others: float = 0.0) -> str:
    """Return the unit whose factor this is, empty where it is none."""
    if factor <= 0.0:
        return ""
    near = min(units, key=lambda unit: abs(np.log(units[unit] / factor)))
    return near if abs(np.log(units[near] / factor)) < np.log(METHOD.mistake.same_factor) + others else ""


def of_unit(
    channel: str, runs: tuple[int, ...], unit: str, factor: float, evidence: Reason, repair: str = "data.repair.unit"
) -> DataMistake:
    """Return the mistake of a channel that is in another unit."""
    mended = reason(repair, channel=channel, factor=factor, unit=unit)
    return DataMistake("unit_factor", channel, runs, factor, evidence, mended)


def of_gain(channel: str, runs: tuple[int, ...], factor: float, evidence: Reason) -> DataMistake:
    """Return the mistake of a channel with a wrong gain."""
    repair = reason("data.repair.gain", channel=channel, factor=factor)
    return DataMistake("gain", channel, runs, factor, evidence, repair)


def of_sign(channel: str, runs: tuple[int, ...], evidence: Reason) -> DataMistake:
    """Return the mistake of a channel with the other sign."""
    return DataMistake("sign", channel, runs, -1.0, evidence, reason("data.repair.sign", channel=channel))
