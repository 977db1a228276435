"""The rig as a use case: press a unit, write its recording, or press a whole simulated lot for the demo."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.profiles import source_profile, unit_profile
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.twin.simulate import Twin
from softcal.station.acquisition import record
from softcal.station.bench import open_simulated_bench


@dataclass(frozen=True)
class PressedLot:
    """A lot as the station records it: the source with its reference, units without, audits to score them."""

    source: LabelledRecording
    units: Mapping[str, OutputRecording]
    audits: Mapping[str, LabelledRecording]


@dataclass(frozen=True)
class PressTimes:
    """How long each kind of run presses, in s."""

    source_s: float = 170.0
    unit_s: float = 25.0
    audit_s: float = 25.0


def press_simulated_lot(
    twins: Sequence[Twin],
    serials: Sequence[str],
    seed: int = 0,
    times: PressTimes | None = None,
    on_run: Callable[[str], None] | None = None,
) -> PressedLot:
    """Press every unit of a simulated lot on one simulated station, over its serial lines.

    Args:
        twins, serials: (number of units,) the units, the source first.
        seed: of mounting, noise and profiles.
        times: how long each run presses; audits take as long as a unit's run and are only there to score.
        on_run: called with a sentence before each run.

    Raises:
        DeviceError: the station failed.
    """
    times, rng = times or PressTimes(), np.random.default_rng(seed)
    units: dict[str, OutputRecording] = {}
    audits: dict[str, LabelledRecording] = {}
    tell = on_run or (lambda sentence: None)
    with open_simulated_bench(twins[0], seed) as (bench, station):
        tell(f"source unit {serials[0]}: pressing with the load cell")
        source = record(bench, serials[0], source_profile(rng, times.source_s), with_reference=True)
        for twin, serial in zip(twins[1:], serials[1:], strict=True):
            station.mount(twin)
            tell(f"unit {serial}: pressing, output only")
            profile = unit_profile(rng, times.unit_s)
            units[serial] = record(bench, serial, profile, with_reference=False).output_recording()
            tell(f"unit {serial}: audit with the load cell, to score")
            audit = record(bench, serial, unit_profile(rng, times.audit_s), with_reference=True)
            audits[serial] = audit.labelled_recording()
    return PressedLot(source.labelled_recording(), units, audits)
