"""One device, its simulated counterpart on a real connection, and the true values."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from softcal.core.errors import DeviceError
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.station.bench.catalogue import driver_of
from softcal.station.bench.simulated_station import wire_for
from softcal.station.devices.config import DeviceConfig
from softcal.station.devices.driver import AnyDriver, Opening, Simulated, Surroundings
from softcal.station.interfaces import Clock, Reader, Sample, Stage, StagePosition
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import HOST_SPEED, World

T = TypeVar("T")

TICK_S = 0.005
"""How often the acquisition reads its devices."""


class Nonconformity(AssertionError):
    """A driver does something else than a station needs."""


def require(condition: object, message: str) -> None:
    """Raise `Nonconformity` unless the condition holds."""
    if not condition:
        raise Nonconformity(message)


class DriverRig:
    """The device of one driver; a context manager that closes everything.

    `level` is the truth of a reader: N on a load cell, V at the input of a readout. A function of the simulated time
    may replace it. `wire` has the fault switches of the line, `axis` the true motion of a stage.
    """

    def __init__(self, driver: AnyDriver, seed: int = 1) -> None:
        self.driver = driver
        self.level: float | Callable[[float], float] = 0.5
        self.world = World()
        self._rng = np.random.default_rng(seed)
        self.axis = Axis(200.0)
        self.axis.position_mm = 2.3  # Where somebody left it.
        self.truth: list[tuple[float, float]] = []
        self._stack = ExitStack()
        self.shared_stage: AnyDriver | None = None
        self._stage: Stage | None = None
        if driver.config.shares_port and driver.role != "stage":
            self.shared_stage = driver_of("stage", driver.kind)
        self.wire: Wire = wire_for(self.shared_stage or driver, self._rng)
        self._stack.callback(self.wire.close)
        if self.shared_stage is not None:
            self._shared_stage_config: DeviceConfig = self._live(self.shared_stage).config
        self.simulated = self._live(driver)
        self.clock: Clock = self.world

    def __enter__(self) -> "DriverRig":
        if self.driver.is_threaded:
            self._stack.enter_context(self.world.in_background(HOST_SPEED))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def config(self) -> Any:
        """The section with which the driver opens its simulated device."""
        return self.simulated.config

    def open(self, **changed: object) -> Any:
        """Open the device, which is closed with the rig."""
        if self.shared_stage is not None and self._stage is None:
            self._stage = self.shared_stage.open(self._shared_stage_config, Opening(self.clock))
            self._stack.callback(self._stage.close)
        device = self.driver.open(replace(self.config, **changed), Opening(self.clock, self._stage))
        self._stack.callback(device.close)
        return device

    def reader(self) -> Reader:
        """Open a load cell or readout and let it settle."""
        reader: Reader = self.open()
        reader.start()
        self.collect(reader, 0.5)
        return reader

    def homed(self) -> Stage:
        stage: Stage = self.open()
        stage.home()
        return stage

    def collect(self, reader: Reader, seconds: float) -> list[Sample]:
        """Return the samples of a reader over a time, read like the acquisition."""
        samples, error = self.fault_within(seconds, reader.poll)
        if error is not None:
            raise error
        return samples

    def poll_stage(
        self, stage: Stage, seconds: float, is_over: Callable[[], bool] = lambda: False
    ) -> list[StagePosition]:
        """Return the reports of a stage over a time, with its true positions."""
        polls: list[StagePosition] = []
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s and not is_over():
            self.clock.sleep_s(TICK_S)
            polls += stage.poll()
            self.truth.append((self.clock.now_s(), self.position_mm()))
        return polls

    def fault_within(self, seconds: float, read: Callable[[], Sequence[T]]) -> tuple[list[T], DeviceError | None]:
        """Return the samples until a `DeviceError`, and the error, or None."""
        items: list[T] = []
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self.clock.sleep_s(TICK_S)
            try:
                items += read()
            except DeviceError as error:
                return items, error
        return items, None

    def position_mm(self) -> float:
        self.axis.advance(self.world.now_s())
        return self.axis.position_mm

    def comes_to_rest(self, within_s: float) -> bool:
        """Return whether the stage comes to rest within a time, and stays there."""
        self.clock.sleep_s(within_s)
        before_mm = self.position_mm()
        self.clock.sleep_s(1.0)
        return abs(self.position_mm() - before_mm) < 1e-6

    def _live(self, driver: AnyDriver) -> Simulated[Any]:
        wire, electronics = self.wire, ReadoutMetadata()
        around = Surroundings(wire, self.axis, self._value, self._outputs_V, electronics, self._rng, wire.port)
        simulated: Simulated[Any] = driver.simulate(around)
        if simulated.far_end is not None:
            self.world.add(simulated.far_end)
        return simulated

    def _value(self, now_s: float) -> float:
        return self.level(now_s) if callable(self.level) else self.level

    def _outputs_V(self, now_s: float) -> tuple[float, ...]:
        return (self._value(now_s),)
