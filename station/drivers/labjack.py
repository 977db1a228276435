"""Analog inputs of a LabJack T4, T7 or T8 as the sensor's readout, through LabJack's own LJM library.

Registers: LabJack T-Series Datasheet, 14 Analog Inputs. Every reading is asked for and answered, none is old.
"""

import importlib
import math
from dataclasses import dataclass
from functools import partial
from typing import Any

from softcal.core.errors import BadReply, CommandRefused, NoReply
from softcal.core.messages.reason import reason
from softcal.station.device_names import READOUT, device_label
from softcal.station.devices.config import ReadoutConfig, check_choice, check_within
from softcal.station.devices.driver import Driver, Opening, Simulated, Surroundings
from softcal.station.messages import PAGES
from softcal.station.simulated.labjack import SimulatedLabjack, SimulatedLjm
from softcal.station.wire.threaded_reader import Reading, ThreadedReader

RANGES_V = (10.0, 1.0, 0.1, 0.01)
"""Ranges of a T7; others take those they have and refuse the rest."""


@dataclass(frozen=True)
class LabjackConfig(ReadoutConfig):
    """Analog inputs of a LabJack; the port is its serial number, its IP address, or ANY.

    Args:
        device: T4, T7, T8 or ANY.
        first_input: number of the first analog input; further channels are the next ones.
        full_scale_V: range of the inputs: 10, 1, 0.1 or 0.01.
        resolution: resolution index of the converter; 0 is the device's own choice.
    """

    kind: str = "labjack"
    device: str = "ANY"
    first_input: int = 0
    full_scale_V: float = 10.0
    resolution: int = 0

    def __post_init__(self) -> None:
        check_choice("readout.full_scale_V", self.full_scale_V, RANGES_V)
        check_within("readout.first_input", self.first_input, 0, 254)
        check_within("readout.resolution", self.resolution, 0, 12)

    @property
    def inputs(self) -> list[str]:
        return [f"AIN{self.first_input + channel}" for channel in range(self.channels)]

    def library(self) -> Any:
        """Return LabJack's module; raise `NoReply` if the module or the LJM library is not installed."""
        try:
            return importlib.import_module("labjack.ljm")
        except Exception as error:  # It raises a kind of its own where LJM itself is missing.
            raise NoReply(
                reason("labjack.missing", device=device_label(READOUT, self.port), error=str(error))
            ) from error


def open_labjack(config: LabjackConfig, opening: Opening) -> ThreadedReader:
    """Open the inputs a station file describes, and set their range."""
    ljm = config.library()
    try:
        handle = ljm.openS(config.device, "ANY", config.port)
    except ljm.LJMError as error:
        raise NoReply(reason("labjack.none", device=device_label(READOUT, config.port), error=str(error))) from error
    try:
        for name in config.inputs:
            _set(ljm, handle, f"{name}_RANGE", config.full_scale_V, config.port)
            _set(ljm, handle, f"{name}_RESOLUTION_INDEX", config.resolution, config.port)
    except BaseException:
        ljm.close(handle)
        raise

    def read() -> Reading:
        values = tuple(ljm.eReadNames(handle, config.channels, config.inputs))
        if not all(math.isfinite(value) for value in values):
            raise BadReply(reason("labjack.reading", device=device_label(READOUT), values=str(values)))
        return Reading(values)

    # The converter reads a little beyond its range: at the range itself the sensor is at the rail.
    reader = partial(ThreadedReader, channels=config.channels, limits=(-config.full_scale_V, config.full_scale_V))
    return reader(READOUT, "V", config.rate_Hz, opening.clock, read, lambda: ljm.close(handle))


def _set(ljm: Any, handle: int, name: str, value: float, port: str) -> None:
    try:
        ljm.eWriteName(handle, name, value)
        actual = float(ljm.eReadName(handle, name))
    except ljm.LJMError as error:
        raise CommandRefused(
            reason("labjack.refused", device=device_label(READOUT, port), name=name, value=value, error=str(error))
        ) from error
    if value and abs(actual - value) > 0.1 * value:  # 0 lets the device choose.
        raise CommandRefused(
            reason("labjack.other", device=device_label(READOUT, port), name=name, value=value, found=actual)
        )


@dataclass(frozen=True)
class _SimulatedLabjackConfig(LabjackConfig):
    """Section of the station file for a LabJack on the simulated library.

    Args:
        device, first_input, full_scale_V, resolution: as of `LabjackConfig`.
    """

    def library(self) -> Any:
        return SimulatedLjm()


def _simulate(around: Surroundings) -> Simulated[LabjackConfig]:
    rate_Hz, channels = around.electronics.sample_rate_Hz, len(around.outputs_V(0.0))
    config = _SimulatedLabjackConfig(around.wire.port, rate_Hz=rate_Hz, channels=channels)
    return Simulated(config, SimulatedLabjack(around.wire, around.outputs_V))


_DESCRIPTION = "LabJack T4, T7, T8: analog inputs"
DRIVERS = (
    Driver("labjack", _DESCRIPTION, LabjackConfig, open_labjack, _simulate, ("library",), True, PAGES["labjack"]),
)
