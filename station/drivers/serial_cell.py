"""What load cells on a serial line share: their keys, and readings line by line."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from softcal.core.errors import BadReply
from softcal.core.words.reason import Reason
from softcal.station.devices.config import ForceConfig
from softcal.station.devices.driver import Opening, Simulated, Surroundings, opens
from softcal.station.drivers.text_stream import LineReader
from softcal.station.interfaces import ForceReader, Sample
from softcal.station.simulated.force_gauge import SimulatedGauge
from softcal.station.wire.link import Line, Link

NAME = "load cell"


@dataclass(frozen=True)
class SerialCellConfig(ForceConfig):
    """A load cell that sends numbers in a unit of force or mass.

    Args:
        baud_rate: of its port.
        sign: 1 where compression reads positive, −1 otherwise.
    """

    baud_rate: int = 115200
    rate_Hz: float = 50.0
    sign: float = 1.0


def opens_cell(
    cell: Callable[[Link, float, float, float], ForceReader],
) -> Callable[[SerialCellConfig, Opening], ForceReader]:
    """Return what opens a cell that is made of its port, capacity, sign and rate."""
    return opens(NAME, lambda link, config: cell(link, config.capacity_N, config.sign, config.rate_Hz))


def simulates(config: type[SerialCellConfig], gauge: type[SimulatedGauge]) -> Callable[[Surroundings], Simulated[Any]]:
    """Return what makes the simulated cell."""
    return lambda around: Simulated(config(around.wire.port), gauge(around.wire, around.force_N))


class LineCell(LineReader):
    """A cell that sends a reading a line by itself; each kind says by `_force_N` what a line reads.

    The lines carry no time: where cell and unit meet within some milliseconds matters, use a cell with a clock.

    Args:
        sign: 1 where compression reads positive, −1 otherwise.
    """

    name = NAME
    unit = "N"
    fatal: Reason | None = None
    """What ends the readings at the first line that says so; other lines may be noise."""

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 50.0) -> None:
        super().__init__(link, rate_Hz)
        self.capacity_N, self._sign = capacity_N, sign

    def _sample(self, line: Line) -> Sample | None:
        try:
            return Sample(line.host_s, None, (self._sign * self._force_N(line.text),))
        except BadReply as error:
            if self._is_noise() and error.reason != self.fatal:
                return None
            raise

    @abstractmethod
    def _force_N(self, text: bytes) -> float:
        """Return the force a line reads, its sign as the device sends it."""
