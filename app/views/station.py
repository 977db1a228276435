"""What the pages of the rig show: checks with golden units, sources, profiles."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.messages.figures import decimals_of, with_decimals
from softcal.core.messages.reason import Reason
from softcal.core.profiles import Profile
from softcal.core.quality.control_chart import ControlChart, control_chart
from softcal.core.recording import Array, LabelledRecording
from softcal.db.entries import GoldenRun
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class GoldenUnit:
    """The checks of a station with a golden unit, oldest first, and the chart of those passed."""

    station: str
    lot_id: str
    serial: str
    runs: tuple[GoldenRun, ...]
    chart: ControlChart | None
    note: Reason | None


def golden_units(registry: Registry) -> list[GoldenUnit]:
    """Return the checks by station, lot and golden unit."""
    by_unit: dict[tuple[str, str, str], list[GoldenRun]] = {}
    for run in registry.stations.golden_runs():
        by_unit.setdefault((run.station, run.lot_id, run.serial), []).append(run)
    units = []
    for key, runs in sorted(by_unit.items()):
        chart, note = None, None
        try:
            chart = control_chart(np.array([run.value for run in runs if run.passed]))
        except InputError as error:
            note = error.reason
        units.append(GoldenUnit(*key, tuple(runs), chart, note))
    return units


def source_values(source: LabelledRecording) -> Mapping[str, str]:
    """Return what a person checks in a source recording, by key of its label."""
    output, reference = source.unlabelled.output, source.reference
    return {
        "column.duration": f"{len(output) / source.unlabelled.sample_rate_Hz:.0f} s",
        "source.samples": f"{len(output)}",
        "source.reach": f"{_span(reference)} {source.reference_unit}",
        "source.swing": f"{_span(output)} {source.unlabelled.output_unit}",
    }


def _span(values: Array) -> str:
    """Return least and largest value, with the decimals of the larger one's third digit."""
    ends = float(values.min()), float(values.max())
    return " … ".join(with_decimals(value, decimals_of(max(map(abs, ends))) + 1) for value in ends)


@dataclass(frozen=True)
class Bound:
    """One bound, depth or speed, a profile is held against."""

    name: str
    value: float
    largest: float
    unit: str

    @property
    def is_within(self) -> bool:
        """Whether the profile stays within it."""
        return self.value <= self.largest


def bounds(profile: Profile, deepest_mm: float, fastest_mm_s: float, start_mm: float = 0.0) -> tuple[Bound, ...]:
    """Return the bounds of a station beside what a profile asks of it that begins at `start_mm`."""
    return (
        Bound("depth", start_mm + profile.deepest_mm, deepest_mm, "mm"),
        Bound("speed", profile.fastest_mm_s, fastest_mm_s, "mm/s"),
    )
