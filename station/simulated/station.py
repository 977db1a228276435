"""A whole simulated station: one rig, three devices on three serial lines, one world in which time passes."""

from collections.abc import Sequence

import numpy as np

from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Twin, TwinStream
from softcal.station.simulated.esm import SimulatedEsm
from softcal.station.simulated.force_gauge import SimulatedIndicator, SimulatedLoadstar, SimulatedMark10
from softcal.station.simulated.grbl import SimulatedGrbl
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.rig import Rig
from softcal.station.simulated.text_stream import SimulatedTextStream
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import FarEnd, World
from softcal.station.simulated.zaber import SimulatedZaber

ACCELERATION_MM_S2 = 200.0
FREE_MM = 4.0
"""Stage position above any unit."""


class SimulatedStation:
    """Stage, load cell and readout around one unit; every part is public so that tests can break it.

    Args:
        unit: the unit under the stage.
        rng: draws noise, delays, clock errors and how units come to lie.
        time_factor: simulated seconds per real second at most; None runs as fast as the computer can.
        stage_kind, force_kind: dialects, as in a station file. The fault switches of `stage` and `force` are those of
            GRBL and HX711.
        beside: more units under the same stage, each on a channel of its own.
    """

    counts_per_N = 9870.0
    zero_counts = 84_210.0

    def __init__(
        self,
        unit: Twin,
        rng: np.random.Generator,
        time_factor: float | None = None,
        stage_kind: str = "grbl",
        force_kind: str = "hx711",
        beside: Sequence[Twin] = (),
    ) -> None:
        self.world = World(time_factor)
        self.metadata = unit.metadata
        self._rng, self._beside, self.channels = rng, tuple(beside), 1 + len(beside)
        self.free_mm = FREE_MM
        self.axis = Axis(ACCELERATION_MM_S2)
        self.axis.position_mm = 2.3  # Where somebody left it: nothing is known before homing.
        self.rig = Rig(self.axis)
        self.mount(unit)
        self.stage_wire, self.force_wire, self.readout_wire = (Wire(child) for child in rng.spawn(3))
        self.stage_kind, self.force_kind = stage_kind, force_kind
        nowhere = Wire(rng)
        nowhere.unplug()
        self.stage = SimulatedGrbl(self.stage_wire if stage_kind == "grbl" else nowhere, self.axis)
        self.force = SimulatedTextStream(
            self.force_wire if force_kind == "hx711" else nowhere,
            self._force_counts,
            80.0,
            float(rng.normal(0, 1e-3)),
            banner=b"softcal load cell 1\r\n",
        )
        self.readout = SimulatedTextStream(
            self.readout_wire, self._output_counts, unit.metadata.sample_rate_Hz, float(rng.normal(0, 1e-3))
        )
        for far_end in (self._stage_end(), self._force_end(), self.readout):
            self.world.add(far_end)

    def _stage_end(self) -> FarEnd:
        if self.stage_kind == "esm":
            gauge = SimulatedMark10(self.force_wire, lambda now_s: self.rig.read(now_s)[0])
            return SimulatedEsm(self.stage_wire, self.axis, gauge)
        return SimulatedZaber(self.stage_wire, self.axis) if self.stage_kind == "zaber" else self.stage

    def _force_end(self) -> FarEnd:
        if self.force_kind == "mark10":
            return SimulatedMark10(self.force_wire, lambda now_s: self.rig.read(now_s)[0])
        if self.force_kind == "indicator":
            return SimulatedIndicator(self.force_wire, lambda now_s: self.rig.read(now_s)[0])
        if self.force_kind == "loadstar":
            return SimulatedLoadstar(self.force_wire, lambda now_s: self.rig.read(now_s)[0])
        return self.force

    def mount(self, unit: Twin) -> None:
        """Put a unit under the stage, a little higher or lower than the one before."""
        clearance_mm = self.free_mm + 1.0 + float(self._rng.uniform(-0.2, 0.2))
        streams = [TwinStream(each, self._rng.spawn(1)[0]) for each in (unit, *self._beside)]
        self.rig.mount(streams, clearance_mm, self.world.now_s())

    def mount_rigid(self, stiffness_N_mm: float = 60.0) -> None:
        """Put something hard under the stage."""
        self.mount(Twin(BaseParameters(k1_N_mm=stiffness_N_mm, kappa_per_N=0.001), (), self.metadata))

    def close(self) -> None:
        """Pull all cables."""
        for wire in (self.stage_wire, self.force_wire, self.readout_wire):
            wire.close()

    def _force_counts(self, now_s: float) -> tuple[int, ...]:
        force_N = self.rig.read(now_s)[0]
        counts = self.zero_counts + self.counts_per_N * force_N
        return (int(np.clip(round(counts), -(2**23), 2**23 - 1)),)

    def _output_counts(self, now_s: float) -> tuple[int, ...]:
        return tuple(round(output_V / self.metadata.step_V) for output_V in self.rig.read(now_s)[1])
