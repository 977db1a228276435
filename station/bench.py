"""The devices of one station, opened together: real ones, or simulated ones behind the same drivers."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from softcal.core.errors import DeviceError, NoReply
from softcal.core.twin.simulate import Twin
from softcal.station.clock import HostClock
from softcal.station.config import (
    FixtureConfig,
    ForceConfig,
    ReadoutConfig,
    SafetyConfig,
    StageConfig,
    StationConfig,
)
from softcal.station.drivers.arduino import ArduinoReadout
from softcal.station.drivers.esm import EsmStage
from softcal.station.drivers.grbl import GrblStage
from softcal.station.drivers.hx711 import Hx711Cell
from softcal.station.drivers.indicator import IndicatorCell
from softcal.station.drivers.loadstar import LoadstarCell
from softcal.station.drivers.mark10 import Mark10Gauge
from softcal.station.drivers.zaber import ZaberStage
from softcal.station.interfaces import Clock, ForceReader, Readout, Stage
from softcal.station.link import Link
from softcal.station.simulated.station import SimulatedStation


@dataclass(frozen=True)
class Bench:
    """Open devices and the clock they live in."""

    config: StationConfig
    clock: Clock
    stage: Stage
    readout: Readout
    force: ForceReader | None


class _Device(Protocol):
    def close(self) -> None: ...


_D = TypeVar("_D", bound=_Device)


@contextmanager
def open_bench(config: StationConfig, clock: Clock | None = None) -> Iterator[Bench]:
    """Open every device of a station and give all ports back at the end.

    Raises:
        DeviceError: names all devices that are missing, not only the first.
    """
    clock = clock or HostClock()
    with ExitStack() as stack:
        missing: list[str] = []

        def opened(make: Callable[[], _D]) -> _D | None:
            try:
                device = make()
            except DeviceError as error:
                missing.append(str(error))
                return None
            stack.callback(device.close)
            return device

        readout = opened(lambda: _open_readout(config.readout, clock))
        force_config = config.force
        stage: Stage | None = None
        force: ForceReader | None = None
        if config.stage.kind == "esm":
            stage, force = _open_stand(config, clock, opened)
        else:
            stage = opened(lambda: _open_stage(config.stage, clock))
        if force_config is not None and force_config.kind != "esm":
            force = opened(lambda: _open_force(force_config, clock))
        if missing or stage is None or readout is None:
            raise NoReply("; ".join(missing))
        yield Bench(config, clock, stage, readout, force)


@contextmanager
def open_simulated_bench(
    unit: Twin | None = None,
    seed: int = 0,
    time_factor: float | None = None,
    stage_kind: str = "grbl",
    force_kind: str = "hx711",
    beside: Sequence[Twin] = (),
) -> Iterator[tuple[Bench, SimulatedStation]]:
    """Open the same drivers on simulated far ends, each behind its own serial line.

    Args:
        unit: the unit under the stage; None for a nominal one. `SimulatedStation.mount` changes it.
        seed: of noise, delays and mounting.
        time_factor: simulated seconds per real second at most; None runs as fast as the computer can.
        stage_kind, force_kind: dialects, as in a station file.
        beside: more units under the same stage, each on a channel of its own.

    Returns:
        The bench, and the simulated station with its fault switches.
    """
    station = SimulatedStation(unit or Twin(), np.random.default_rng(seed), time_factor, stage_kind, force_kind, beside)
    try:
        with open_bench(simulated_config(station), station.world) as bench:
            yield bench, station
    finally:
        station.close()


def simulated_config(station: SimulatedStation) -> StationConfig:
    """Return the station file that belongs to a simulated station."""
    electronics = station.metadata
    return StationConfig(
        StageConfig(station.stage_wire.port, station.stage_kind),
        ReadoutConfig(
            station.readout_wire.port,
            vref_V=electronics.vref_V,
            adc_bits=electronics.adc_bits,
            r_series_ohm=electronics.r_series_ohm,
            rate_Hz=electronics.sample_rate_Hz,
            channels=station.channels,
        ),
        ForceConfig(
            station.stage_wire.port if station.force_kind == "esm" else station.force_wire.port,
            station.force_kind,
            counts_per_N=station.counts_per_N,
            zero_counts=station.zero_counts,
            latency_s=0.0,
        ),
        SafetyConfig(stiffest_N_mm=60.0),
        replace(FixtureConfig(), approach_mm=station.free_mm),
        name="simulated",
    )


@contextmanager
def open_force(config: ForceConfig, clock: Clock) -> Iterator[ForceReader]:
    """Open the load cell alone.

    Raises:
        DeviceError: it is missing.
    """
    reader = _open_force(config, clock)
    try:
        yield reader
    finally:
        reader.close()


def _open_stage(config: StageConfig, clock: Clock) -> Stage:
    with _link(config, clock, "stage") as link:
        if config.kind == "zaber":
            return ZaberStage(link, config.microstep_mm)
        return GrblStage(link, config.axis, config.is_reversed)


def _open_stand(
    config: StationConfig, clock: Clock, opened: Callable[[Callable[[], Any]], Any]
) -> tuple[Stage | None, ForceReader | None]:
    """Open a stand, and the gauge behind its port where the station has one there."""

    def open_stage() -> EsmStage:
        with _link(config.stage, clock, "stage") as link:
            return EsmStage(link, config.stage.travel_mm, config.stage.acceleration_mm_s2)

    stand, force = opened(open_stage), config.force
    if stand is None or force is None or force.kind != "esm":
        return stand, None
    return stand, opened(lambda: stand.gauge(force.capacity_N, force.sign, force.rate_Hz))


def _open_readout(config: ReadoutConfig, clock: Clock) -> Readout:
    with _link(config, clock, "sensor readout") as link:
        return ArduinoReadout(link, config.vref_V, config.adc_bits, config.rate_Hz, config.channels)


def _open_force(config: ForceConfig, clock: Clock) -> ForceReader:
    with _link(config, clock, "load cell") as link:
        if config.kind == "mark10":
            return Mark10Gauge(link, config.capacity_N, config.sign, config.rate_Hz)
        if config.kind == "indicator":
            return IndicatorCell(link, config.capacity_N, config.sign, config.rate_Hz)
        if config.kind == "loadstar":
            return LoadstarCell(link, config.capacity_N, config.sign, config.rate_Hz)
        return Hx711Cell(link, config.counts_per_N, config.zero_counts, config.capacity_N, config.rate_Hz)


@contextmanager
def _link(config: StageConfig | ReadoutConfig | ForceConfig, clock: Clock, name: str) -> Iterator[Link]:
    """Open a port for a driver; give it back when the device behind it is not what was expected."""
    link = Link(config.port, clock, config.baud_rate, name)
    try:
        yield link
    except DeviceError:
        link.close()
        raise
