"""A whole simulated station: one rig, three devices on three lines, one world of time."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Twin, TwinStream
from softcal.station.bench.catalogue import driver_of
from softcal.station.devices.config import ForceConfig, ReadoutConfig, Role, StageConfig
from softcal.station.devices.driver import AnyDriver, Simulated, Surroundings
from softcal.station.simulated.grbl import SimulatedGrbl
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.rig import SimulatedRig
from softcal.station.simulated.text_stream import CELL_COUNTS_PER_N, CELL_ZERO_COUNTS, SimulatedTextStream
from softcal.station.simulated.wire import BleEnd, SocketEnd, Wire
from softcal.station.simulated.world import World

ACCELERATION_MM_S2 = 200.0
FREE_MM = 4.0
"""Stage position above any unit."""

_E = TypeVar("_E")


class SimulatedStation:
    """Simulated stage, load cell and readout around one unit; every part is public so that tests can break it.

    Args:
        rng: draws noise, delays, clock errors and how units come to lie.
        time_factor: simulated seconds per real second at most; None runs as fast as the computer can.
        other_units: further units under the same stage, each on its own channel.
    """

    counts_per_N, zero_counts = CELL_COUNTS_PER_N, CELL_ZERO_COUNTS

    def __init__(
        self,
        unit: Twin,
        rng: np.random.Generator,
        time_factor: float | None = None,
        stage_kind: str = StageConfig.kind,
        force_kind: str = ForceConfig.kind,
        other_units: Sequence[Twin] = (),
        readout_kind: str = ReadoutConfig.kind,
    ) -> None:
        self.world = World(time_factor)
        self.metadata = unit.metadata
        self._rng, self._other_units, self.channels = rng, tuple(other_units), 1 + len(other_units)
        self.free_mm = FREE_MM
        self.axis = Axis(ACCELERATION_MM_S2)
        self.axis.position_mm = 2.3  # Where somebody left it: nothing is known before homing.
        self.rig = SimulatedRig(self.axis)
        self.mount(unit)
        drivers = driver_of("stage", stage_kind), driver_of("cell", force_kind), driver_of("readout", readout_kind)
        self.is_threaded = any(driver.is_threaded for driver in drivers)
        self.stage_wire, self.force_wire, self.readout_wire = (
            wire_for(driver, child) for driver, child in zip(drivers, rng.spawn(3), strict=True)
        )
        stage: Simulated[StageConfig] = drivers[0].simulate(self._around(self.stage_wire))
        cell: Simulated[ForceConfig] = drivers[1].simulate(self._around(self.force_wire))
        readout: Simulated[ReadoutConfig] = drivers[2].simulate(self._around(self.readout_wire))
        self.stage_config, self.force_config, self.readout_config = stage.config, cell.config, readout.config
        self.reading_per_V = readout.reading_per_V
        self._far_ends = (stage.far_end, cell.far_end, readout.far_end)
        self.rig.samplers = [far_end for far_end in self._far_ends if far_end is not None]
        for far_end in self.rig.samplers:
            self.world.add(far_end)

    def _around(self, wire: Wire) -> Surroundings:
        return Surroundings(
            wire,
            self.axis,
            lambda now_s: self.rig.read(now_s)[0],
            lambda now_s: self.rig.read(now_s)[1],
            self.metadata,
            self._rng,
            self.stage_wire.port,
        )

    @property
    def stage(self) -> SimulatedGrbl:
        return self.far_end(SimulatedGrbl, "stage")

    @property
    def force(self) -> SimulatedTextStream:
        return self.far_end(SimulatedTextStream, "cell")

    @property
    def readout(self) -> SimulatedTextStream:
        return self.far_end(SimulatedTextStream, "readout")

    def far_end(self, kind: type[_E], role: Role) -> _E:
        """The far end of any stage, load cell or readout, with its fault switches."""
        far_end = self._far_ends[("stage", "cell", "readout").index(role)]
        if not isinstance(far_end, kind):
            actual_kind = type(far_end).__name__
            raise ValueError(f"these fault switches are those of {kind.__name__}; the station has {actual_kind}")
        return far_end

    def mount(self, unit: Twin) -> None:
        """Put a unit under the stage, at a slightly different height than the previous unit."""
        clearance_mm = self.free_mm + 1.0 + float(self._rng.uniform(-0.2, 0.2))
        streams = [TwinStream(each, self._rng.spawn(1)[0]) for each in (unit, *self._other_units)]
        self.rig.mount(streams, clearance_mm, self.world.now_s())

    def mount_rigid(self) -> None:
        """Put a rigid object under the stage."""
        self.mount(Twin(BaseParameters(k1_N_mm=60.0, kappa_per_N=0.001), (), self.metadata))

    def close(self) -> None:
        for wire in (self.stage_wire, self.force_wire, self.readout_wire):
            wire.close()


def wire_for(driver: AnyDriver, rng: np.random.Generator) -> Wire:
    """Return a line of the kind that a driver uses: serial, Bluetooth, or a socket."""
    match driver.wires[0]:
        case "serial":
            return Wire(rng)
        case "ble":
            return Wire(rng, medium=BleEnd())
        case _:
            return Wire(rng, medium=SocketEnd())
