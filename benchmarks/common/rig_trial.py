"""Trials of safety: a rig of any drive, cell and unit, pressed by the real code, and the largest force it truly saw."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from common.fault_trial import is_report_true

from softcal.core.errors import DeviceError
from softcal.core.profiles import Profile
from softcal.core.recording import Array
from softcal.core.twin.simulate import Twin
from softcal.station.bench.bench import Bench, open_bench, simulated_config
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.tasks.acquisition import RunProgress, record

GONE_S = 10.0
"""Longer than anything that was sent ahead takes."""

START_MM = 0.5
"""Where the stage was left, above everything."""


@dataclass(frozen=True)
class ForceLaw:
    """F = coefficient·x^power + stop_N_mm·max(0, x − stop_mm), x the depth below the surface in mm, F in N."""

    coefficient: float = 1.2
    power: float = 1.4
    stop_mm: float = 100.0
    stop_N_mm: float = 0.0

    def force_N(self, depth_mm: Array | float) -> Array:
        """Return the force at depths in mm; 0 above the surface."""
        x = np.maximum(0.0, depth_mm)
        return np.asarray(self.coefficient * x**self.power + self.stop_N_mm * np.maximum(0.0, x - self.stop_mm))


class LawUnit:
    """A unit under the simulated stage whose output follows its force; a `simulated.rig.Physics`.

    Its noise is drawn instant by instant, so that it is the same in chunks of any size.

    Args:
        law: its force law; u = 0 of the rig is its surface.
        rng: of the noise.
        noise_N, noise_V: standard deviation of load cell and output.
    """

    is_causal = True

    def __init__(self, law: ForceLaw, rng: np.random.Generator, noise_N: float = 0.004, noise_V: float = 0.002) -> None:
        self.law, self._rng, self._noise = law, rng, (noise_N, noise_V)

    def advance(self, t_s: Array, stage_mm: Array) -> tuple[Array, Array]:
        """Return (force_N, output_V) at these stage positions, noise included."""
        force_N = self.law.force_N(stage_mm)
        output_V = 0.5 + 4.0 * force_N / (force_N + 8.0)
        noise_N, noise_V = self._rng.normal(0.0, self._noise, (len(stage_mm), 2)).T
        return force_N + noise_N, output_V + noise_V

    def state(self) -> Mapping[str, Any]:
        """Return where the noise has got to."""
        return self._rng.bit_generator.state

    def go_back(self, state: Mapping[str, Any]) -> None:
        """Go back to such a state."""
        self._rng.bit_generator.state = state


@dataclass(frozen=True)
class RigCase:
    """One rig.

    Args:
        acceleration_mm_s2: of the drive ($122); 10 is what a fresh GRBL has.
        law: force law of what lies under the stage.
        surface_mm: stage position of its surface.
        cell_Hz, cell_late_s: rate of the load cell, and how late its line is.
        limit_N, capacity_N: force limit of the station, and of the cell.
        latency_s: as the station file states it; −1 for not.
        stiffest_N_mm: as the station file states it.
        approach_mm: where no unit should reach.
    """

    acceleration_mm_s2: float = 200.0
    law: ForceLaw = ForceLaw()
    surface_mm: float = 2.2
    cell_Hz: float = 80.0
    cell_late_s: float = 0.0
    limit_N: float = 5.0
    capacity_N: float = 20.0
    latency_s: float = UNKNOWN_S
    stiffest_N_mm: float = 1000.0
    approach_mm: float = 1.8
    seed: int = 1


@contextmanager
def open_rig(case: RigCase) -> Iterator[tuple[Bench, SimulatedStation]]:
    """Open the bench of a case, and its far ends."""
    rng = np.random.default_rng(case.seed)
    station = SimulatedStation(Twin(), rng)
    station.axis.acceleration_mm_s2 = station.stage.settings[122] = case.acceleration_mm_s2
    station.axis.position_mm = START_MM
    station.stage.assume_zero()
    station.force.rate_Hz = case.cell_Hz
    station.force_wire.delay_s += case.cell_late_s
    station.rig.mount([LawUnit(case.law, rng.spawn(1)[0])], case.surface_mm, 0.0)
    plain = simulated_config(station)
    assumed = replace(plain.force, rate_Hz=case.cell_Hz, capacity_N=case.capacity_N, latency_s=case.latency_s)  # type: ignore[type-var]
    safety = replace(plain.safety, force_N=case.limit_N, stiffest_N_mm=case.stiffest_N_mm, speed_mm_s=25.0)
    silence_s = max(safety.silence_s, min(1.0, 4.0 / case.cell_Hz))
    fixture = replace(plain.fixture, approach_mm=case.approach_mm)
    config = replace(plain, force=assumed, safety=replace(safety, silence_s=silence_s), fixture=fixture)
    try:
        with open_bench(config, station.world) as bench:
            yield bench, station
    finally:
        station.close()


@dataclass(frozen=True)
class RigOutcome:
    """What became of a run.

    Args:
        largest_N: true force at the deepest point the stage reached.
        message: "" where the run went through, else what the operator reads.
        is_up: whether the stage stands above the unit at the end.
        is_true: whether what the operator reads of the stage is so.
        station_s: how long it took.
    """

    largest_N: float
    message: str
    is_up: bool
    is_true: bool
    station_s: float

    @property
    def ends(self) -> str:
        """How it ended, in two words."""
        if not self.message:
            return "went through"
        return "stopped and lifted" if self.is_up else "stopped on the unit"


def press(case: RigCase, profile: Profile) -> RigOutcome:
    """Press a case with a profile."""
    with open_rig(case) as (bench, station):
        why: DeviceError | None = None
        try:
            record(bench, "S1", profile, with_reference=True)
        except DeviceError as error:
            why = error
        depth_mm = station.axis.deepest_mm - case.surface_mm
        is_up = station.rig.carriage_mm <= case.surface_mm
        is_true = is_up if why is None else is_report_true(why, bench, station)
        largest_N = float(case.law.force_N(depth_mm))
        return RigOutcome(largest_N, str(why or ""), is_up, is_true, station.world.now_s())


class _HostGone(BaseException):
    """Ends a run after its host has said nothing for long enough."""


def press_until_gone(case: RigCase, profile: Profile, phase: str, at_mm: float) -> float | None:
    """Press a case until its host dies; return the true force at the deepest point that the stage then reaches.

    Args:
        phase: of the run in which the host dies.
        at_mm: depth of the stage below the surface at which it does, mm.

    Returns:
        The force in N; None where the run never came there.
    """
    phases_seen, deepest_mm = [""], list[float]()
    with open_rig(case) as (bench, station):

        def die_there() -> None:
            if phases_seen[0] == phase and station.axis.position_mm - case.surface_mm >= at_mm:
                station.world.sleep_s(GONE_S)
                deepest_mm.append(station.axis.deepest_mm)
                raise _HostGone

        def follow(progress: RunProgress) -> None:
            phases_seen[0] = progress.phase

        try:
            record(bench, "S1", profile, True, follow, None, die_there)
        except (DeviceError, _HostGone):
            pass  # What matters is where the stage had come to before anybody could do anything.
    return float(case.law.force_N(deepest_mm[0] - case.surface_mm)) if deepest_mm else None
