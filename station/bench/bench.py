"""The devices of a station, opened together: real ones, or simulated ones behind their drivers."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.core.errors import DeviceError, NoReply
from softcal.core.messages.reason import Reason, several
from softcal.station.bench.catalogue import driver_of
from softcal.station.bench.station_file import with_driver_keys
from softcal.station.clock import HostClock
from softcal.station.devices.config import (
    DeviceConfig,
    FixtureConfig,
    ForceConfig,
    ReadoutConfig,
    SafetyConfig,
    StageConfig,
    StationConfig,
)
from softcal.station.devices.driver import Opening
from softcal.station.interfaces import Clock, ForceReader, Readout, Stage

if TYPE_CHECKING:
    from softcal.core.twin.simulate import Twin
    from softcal.station.bench.simulated_station import SimulatedStation

SIMULATED_NAME = "simulated"
"""Name of every simulated station: nothing it measures is traceable."""


@dataclass(frozen=True)
class Bench:
    """Open devices and the clock they live in."""

    config: StationConfig
    clock: Clock
    stage: Stage
    readout: Readout
    force: ForceReader | None


@contextmanager
def open_bench(config: StationConfig, clock: Clock | None = None) -> Iterator[Bench]:
    """Open every device, and give all ports back at the end; `DeviceError` names all that are missing."""
    clock = clock or HostClock()
    with ExitStack() as stack:
        missing: list[Reason] = []

        def open_device(device_config: DeviceConfig, stage: Stage | None = None) -> Any:
            try:
                device = _open(device_config, Opening(clock, stage))
            except DeviceError as error:
                missing.append(error.reason)
                return None
            stack.callback(device.close)
            return device

        stage: Stage | None = open_device(config.stage)
        readout: Readout | None = open_device(config.readout, stage)
        force: ForceReader | None = open_device(config.force, stage) if config.force is not None else None
        if missing or stage is None or readout is None:
            raise NoReply(several(missing))
        yield Bench(config, clock, stage, readout, force)


@contextmanager
def open_simulated_bench(
    unit: "Twin | None" = None,
    seed: int = 0,
    time_factor: float | None = None,
    stage_kind: str = StageConfig.kind,
    force_kind: str = ForceConfig.kind,
    other_units: "Sequence[Twin]" = (),
    readout_kind: str = ReadoutConfig.kind,
) -> "Iterator[tuple[Bench, SimulatedStation]]":
    """Open the shipped drivers on simulated devices, each behind a serial line of its own.

    Args:
        time_factor: simulated seconds per real second at most; None runs as fast as the computer can. A driver that
            reads in a thread of its own makes simulated time pass in real time at most.
        other_units: further units under the same stage, each on its own channel.

    Returns:
        The bench, and the simulated station with its fault switches.
    """
    # The simulator is an extra: a real rig does without it.
    from softcal.core.twin.simulate import Twin  # noqa: PLC0415
    from softcal.station.bench.simulated_station import SimulatedStation  # noqa: PLC0415
    from softcal.station.simulated.world import HOST_SPEED  # noqa: PLC0415

    twin = unit or Twin()
    rng = np.random.default_rng(seed)
    station = SimulatedStation(twin, rng, time_factor, stage_kind, force_kind, other_units, readout_kind)
    with ExitStack() as stack:
        stack.callback(station.close)
        if station.is_threaded:
            stack.enter_context(station.world.in_background(HOST_SPEED))
        yield stack.enter_context(open_bench(simulated_config(station), station.world)), station


def simulated_config(station: "SimulatedStation") -> StationConfig:
    """Return the station file that belongs to a simulated station."""
    fixture = FixtureConfig()
    return StationConfig(
        station.stage_config,
        station.readout_config,
        replace(station.force_config, latency_s=0.0),
        SafetyConfig(stiffest_N_mm=60.0),
        replace(
            fixture, approach_mm=station.free_mm, contact_output=fixture.contact_output * abs(station.reading_per_V)
        ),
        name=SIMULATED_NAME,
    )


@contextmanager
def open_force(config: ForceConfig, clock: Clock) -> Iterator[ForceReader]:
    """Open the load cell alone; raise `DeviceError` if it is missing."""
    with closing(_open(config, Opening(clock))) as reader:
        yield reader


def open_readout(config: ReadoutConfig, clock: Clock) -> Readout:
    """Open the readout alone, which the caller must close; raise `DeviceError` if it is missing."""
    readout: Readout = _open(config, Opening(clock))
    return readout


def _open(config: DeviceConfig, opening: Opening) -> Any:
    return driver_of(config.role, config.kind).open(with_driver_keys(config), opening)
