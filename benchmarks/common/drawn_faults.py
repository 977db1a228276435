"""Faults as data: a kind, its size, a moment, with or without a load cell, on three stages; and what is said."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from common.fault_trial import without_cell
from common.proof_trial import GoodRig, draw_good_rig, open_good_rig

from softcal.core.errors import DeviceError
from softcal.core.messages.reason import root_of
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.simulated.far_end import FarEnd
from softcal.station.tasks.acquisition import RunProgress, record
from softcal.station.tasks.durations import PRESSING
from softcal.station.testing.faults import filter_cell, hang, limit_speed, loosen

STAGES = ("grbl", "zaber", "esm")

Begin = Callable[[SimulatedStation, float], None]


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault.

    Args:
        low, high, unit: its size is drawn between these, evenly in its logarithm.
        begin: (station, size) breaks the station.
        is_there_before: whether it is there before the run; else it begins at a drawn moment of the profile.
        has_cell: whether the station has a load cell.
    """

    name: str
    low: float
    high: float
    unit: str
    begin: Begin
    is_there_before: bool = False
    has_cell: bool = True


def _force(change: Callable[[float, float], float]) -> Begin:
    return lambda station, size: setattr(station.rig, "force_fault", lambda now_s, force_N: change(force_N, size))


def _output(change: Callable[[float, float], float]) -> Begin:
    return lambda station, size: setattr(station.rig, "output_fault", lambda now_s, output_V: change(output_V, size))


def _drift(station: SimulatedStation, rate_mV_s: float) -> None:
    since_s = station.world.now_s()
    station.rig.output_fault = lambda now_s, output_V: output_V + 1e-3 * rate_mV_s * (now_s - since_s)


def _delay(station: SimulatedStation, late_s: float) -> None:
    station.force_wire.delay_s += late_s


def _freeze(station: SimulatedStation, size: float) -> None:
    station.far_end(FarEnd, "stage").frozen_mm = station.axis.position_mm


def _slip(station: SimulatedStation, lost_mm: float) -> None:
    station.rig.lose_steps(lost_mm)


def _stretch(station: SimulatedStation, times: float) -> None:
    station.rig.steps_share = times


KINDS = (
    FaultKind("low pass of the load cell", 0.02, 0.3, "s", filter_cell, True),
    FaultKind("delay of the load cell that is not stated", 0.02, 0.3, "s", _delay, True),
    FaultKind("load cell follows no faster than so", 0.5, 4.0, "N/s", limit_speed, True),
    FaultKind("gain of the load cell changes", 0.03, 0.5, "", _force(lambda force_N, size: (1.0 - size) * force_N)),
    FaultKind("zero of the load cell moves", 0.05, 1.0, "N", _force(lambda force_N, size: force_N + size)),
    FaultKind("load cell hangs", 0.1, 2.0, "s", hang),
    FaultKind("gain of the output falls", 0.02, 0.3, "", _output(lambda output_V, size: (1.0 - size) * output_V)),
    FaultKind("output drifts", 2.0, 50.0, "mV/s", _drift),
    FaultKind("output at 0 V for a moment", 0.02, 0.06, "s", lambda s, size: loosen(s, size, lambda output_V: 0.0)),
    FaultKind("output halved for a moment", 0.02, 0.06, "s", lambda s, size: loosen(s, size, lambda x: 0.5 * x)),
    FaultKind("steps are lost", 0.05, 1.0, "mm", _slip),
    FaultKind("steps are lost, no load cell", 0.05, 1.0, "mm", _slip, has_cell=False),
    FaultKind("position report frozen", 1.0, 1.0, "", _freeze),
    FaultKind("position report frozen, no load cell", 1.0, 1.0, "", _freeze, has_cell=False),
    FaultKind("steps per mm too many, no load cell", 1.2, 2.0, "times", _stretch, True, has_cell=False),
)


@dataclass(frozen=True)
class DrawnFault:
    """One fault on one rig.

    Args:
        size: NaN for a good rig.
        moment: share of the profile after which it begins.
    """

    rig: GoodRig
    kind: FaultKind | None
    size: float
    moment: float


def draw_fault(seed: int, kind: FaultKind | None) -> DrawnFault:
    """Draw a rig, the size and the moment of a fault; without a kind a good rig."""
    rng = np.random.default_rng([seed, 58])
    rig = replace(draw_good_rig(seed), stage_kind=str(rng.choice(STAGES)))
    low, high = (1.0, 1.0) if kind is None else (kind.low, kind.high)
    size = float(np.exp(rng.uniform(math.log(low), math.log(high))))
    return DrawnFault(rig, kind, size, float(rng.uniform(0.15, 0.85)))


def press_drawn(drawn_fault: DrawnFault) -> str:
    """Return the code of what is said of a rig, "" for nothing."""
    with open_good_rig(drawn_fault.rig) as (full, station):
        kind, pending = drawn_fault.kind, [drawn_fault.kind is not None]
        bench = full if kind is None or kind.has_cell else without_cell(full)
        if kind is not None and kind.is_there_before:
            pending = [False]
            kind.begin(station, drawn_fault.size)

        def on_progress(progress: RunProgress) -> None:
            if progress.phase == PRESSING and pending[0] and kind is not None:
                pending[0] = False
                at_s = station.world.now_s() + drawn_fault.moment * drawn_fault.rig.profile.duration_s
                station.world.at(at_s, lambda: kind.begin(station, drawn_fault.size))

        try:
            recording = record(bench, "F1", drawn_fault.rig.profile, bench.force is not None, on_progress)
        except DeviceError as error:
            return root_of(error.reason).code
        remarks = [remark.code for remark in recording.remarks]
        is_filtered = bool(recording.alignment.force_time_constant_s)
        return ", ".join([*remarks, *(["said with its time constant"] if is_filtered else [])])
