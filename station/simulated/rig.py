"""The physical rig behind all simulated devices: where the stage is decides force and output."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from softcal.core.recording import Array
from softcal.station.simulated.motion import Axis

SINK_MM_N = 0.02
"""How far a weight sinks from one reading to the next for each N the unit does not bear yet; softer than any unit."""


class Physics(Protocol):
    """A unit that remembers its past; `softcal.core.twin.simulate.TwinStream` is one."""

    def advance(self, t_s: Array, stage_mm: Array) -> tuple[Array, Array]:
        """Go on in time and return (force_N, output_V) as load cell and converter read them."""


class SimulatedRig:
    """Stage, unit and load cell in one frame.

    `weight_N` is a dead weight on the unit. Faults are switches: `force_fault` and `output_fault` replace what a device
    would see: (time, true value) -> value.

    Args:
        axis: the drive; its position counts downward from the homing switch, mm.
    """

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.weight_N = self._sunk_mm = 0.0
        self.force_fault: Callable[[float, float], float] | None = None
        self.output_fault: Callable[[float, float], float] | None = None
        self._stands_at_mm: float | None = None
        self._lost_mm = 0.0
        self.largest_force_N = 0.0

    def mount(self, units: Sequence[Physics], clearance_mm: float, now_s: float) -> None:
        """Put a unit under the stage, or several beside each other; the load cell feels the first one.

        Args:
            clearance_mm: stage position that is the unit's u = 0.
            now_s: the unit's own time 0.
        """
        self._units, self.clearance_mm, self._mounted_s = units, clearance_mm, now_s
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
            at_s, at_mm = np.array([now_s - self._mounted_s]), np.array([u_mm])
            readings = [unit.advance(at_s, at_mm) for unit in self._units]
            self._force_N = float(readings[0][0][0])
            self._outputs_V = tuple(float(output[0]) for _, output in readings)
            self.largest_force_N = max(self.largest_force_N, self._force_N)
        force_N, outputs_V = self._force_N, self._outputs_V
        if self.force_fault:
            force_N = self.force_fault(now_s, force_N)
        if self.output_fault:
            outputs_V = tuple(self.output_fault(now_s, output_V) for output_V in outputs_V)
        return force_N, outputs_V

    @property
    def carriage_mm(self) -> float:
        """Where the carriage is, whatever the controller counts."""
        return (self.axis.position_mm if self._stands_at_mm is None else self._stands_at_mm) - self._lost_mm

    def cut_motor(self) -> None:
        """The motor loses its supply: the controller counts on, the carriage stays where it is."""
        self._stands_at_mm = self.axis.position_mm

    def lose_steps(self, lost_mm: float) -> None:
        """The motor slips: from now on the carriage is higher than the controller counts."""
        self._lost_mm += lost_mm
