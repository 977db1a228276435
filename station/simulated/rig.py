"""The physical rig behind all simulated devices: where the stage is decides force and output."""

from collections.abc import Callable, Sequence
from heapq import merge
from itertools import groupby, islice
from typing import Any, Protocol, TypeAlias

import numpy as np

from softcal.core.recording import Array
from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.motion import Axis

SINK_MM_N = 0.02
"""How far a weight sinks from one reading to the next for each N the unit does not bear yet; softer than any unit."""

MAX_AHEAD = 256
"""Instants at most for which units are computed ahead of the stage."""


class Physics(Protocol):
    """A unit that remembers its past; `softcal.core.twin.simulate.TwinStream` is one."""

    @property
    def is_causal(self) -> bool:
        """Whether instants in chunks of any size give the same numbers."""

    def advance(self, t_s: Array, stage_mm: Array) -> tuple[Array, Array]:
        """Advance the time and return (force_N, output_V) as read by load cell and converter."""

    def state(self) -> Any:
        """Return all that `advance` depends on."""

    def go_back(self, state: Any) -> None:
        """Restore an earlier state."""


StagePath: TypeAlias = Sequence[tuple[float, float]]
"""Instants in s with the position in mm at each."""


class PressedUnits:
    """Several units under one stage, read one after the other.

    They are computed in blocks ahead. Where the stage goes another way than was expected, they go back to the start of
    the block and come the way it went, so that readings are those of units read one by one.
    """

    def __init__(self, units: Sequence[Physics]) -> None:
        self._units, self._is_causal = units, all(unit.is_causal for unit in units)
        self._way: StagePath = ()
        self._row_count = 0
        self._rows: list[tuple[float, ...]] = []
        self._states: list[Any] = []

    def read(self, t_s: float, u_mm: float, coming: Callable[[int], StagePath]) -> tuple[float, ...]:
        """Return force_N of the first unit and output_V of each, at the next instant.

        Args:
            coming: count -> at most so many further instants, without further commands.
        """
        if self._row_count == len(self._way) or self._way[self._row_count] != (t_s, u_mm):
            self._look_ahead(t_s, u_mm, coming)
        self._row_count += 1
        return self._rows[self._row_count - 1]

    def _look_ahead(self, t_s: float, u_mm: float, coming: Callable[[int], StagePath]) -> None:
        if self._row_count < len(self._way):
            for unit, state in zip(self._units, self._states, strict=True):
                unit.go_back(state)
            self._advance(self._way[: self._row_count])
        count = min(2 * self._row_count, MAX_AHEAD) if self._is_causal else 0
        self._way, self._row_count = [(t_s, u_mm), *coming(count)], 0
        self._states = [unit.state() for unit in self._units] if len(self._way) > 1 else []
        self._rows = self._advance(self._way)

    def _advance(self, way: StagePath) -> list[tuple[float, ...]]:
        if not way:
            return []
        t_s, u_mm = np.array(way).T
        readings = [unit.advance(t_s, u_mm) for unit in self._units]
        return list(zip(readings[0][0].tolist(), *(output_V.tolist() for _, output_V in readings), strict=True))


class SimulatedRig:
    """Stage, unit and load cell in one frame.

    `weight_N` is a dead weight on the unit. Faults are switches: `force_fault` and `output_fault` replace what a device
    would see: (time, true value) -> value. `steps_share` is the way of the carriage for each mm that is counted.

    Args:
        axis: the drive; its position counts downward from the homing switch, mm.

    `samplers` are the devices that read the unit by themselves.
    """

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.samplers: Sequence[FarEnd] = ()
        self.weight_N = self._sunk_mm = 0.0
        self.force_fault: Callable[[float, float], float] | None = None
        self.output_fault: Callable[[float, float], float] | None = None
        self._stalled_at_mm: float | None = None
        self._lost_mm, self.steps_share = 0.0, 1.0
        self.largest_force_N = 0.0

    def mount(self, units: Sequence[Physics], clearance_mm: float, now_s: float) -> None:
        """Put a unit, or several units side by side, under the stage; the load cell measures the first.

        Args:
            clearance_mm: stage position that is the unit's u = 0.
            now_s: the unit's own time 0.
        """
        self._units, self.clearance_mm, self._mounted_s = PressedUnits(units), clearance_mm, now_s
        self.weight_N = self._sunk_mm = 0.0
        self._read_s, self._force_N, self._outputs_V = -1.0, 0.0, (0.0,) * len(units)

    def read(self, now_s: float) -> tuple[float, tuple[float, ...]]:
        self.axis.advance(now_s)
        if now_s > self._read_s:
            self._read_s = now_s
            u_mm = self.carriage_mm - self.clearance_mm
            if self.weight_N:
                # A weight sinks until the unit bears it, whatever the stage does above it.
                self._sunk_mm = max(0.0, self._sunk_mm + SINK_MM_N * (self.weight_N - self._force_N))
                u_mm = max(u_mm, self._sunk_mm)
            row = self._units.read(now_s - self._mounted_s, u_mm, self._coming)
            self._force_N, self._outputs_V = row[0], row[1:]
            self.largest_force_N = max(self.largest_force_N, self._force_N)
        force_N, outputs_V = self._force_N, self._outputs_V
        if self.force_fault:
            force_N = self.force_fault(now_s, force_N)
        if self.output_fault:
            outputs_V = tuple(self.output_fault(now_s, output_V) for output_V in outputs_V)
        return force_N, outputs_V

    def _coming(self, count: int) -> StagePath:
        if self.weight_N:
            return ()  # How far it sinks depends on the reading before.
        later_s = (s for s in merge(*(sampler.coming_s() for sampler in self.samplers)) if s > self._read_s)
        times_s = [s for s, _ in islice(groupby(later_s), count)]
        counted_mm = self.axis.positions_mm(times_s, is_fed=True)
        return [
            (s - self._mounted_s, self._carriage_at_mm(mm) - self.clearance_mm)
            for s, mm in zip(times_s, counted_mm, strict=False)
        ]

    def _carriage_at_mm(self, counted_mm: float) -> float:
        counted_mm = counted_mm if self._stalled_at_mm is None else self._stalled_at_mm
        return self.steps_share * counted_mm - self._lost_mm

    @property
    def carriage_mm(self) -> float:
        """Position of the carriage in mm, whatever the controller counts."""
        return self._carriage_at_mm(self.axis.position_mm)

    def cut_motor(self) -> None:
        """Cut the supply of the motor: the controller keeps counting, the carriage stays."""
        self._stalled_at_mm = self.axis.position_mm

    def lose_steps(self, lost_mm: float) -> None:
        """The motor slips: from now on the carriage is higher than the controller counts."""
        self._lost_mm += lost_mm
