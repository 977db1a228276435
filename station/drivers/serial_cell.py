"""Common parts of load cells on a serial line: keys, and readings line by line."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from softcal.core.errors import BadReply
from softcal.core.messages.reason import Reason
from softcal.station.device_names import CELL
from softcal.station.devices.config import ForceConfig
from softcal.station.devices.driver import AnyDriver, Driver, Simulated, make_opener
from softcal.station.drivers.text_stream import LineReader
from softcal.station.interfaces import ForceReader, Sample
from softcal.station.messages import PAGES
from softcal.station.simulated.force_gauge import SimulatedGauge
from softcal.station.wire.link import Line, Link


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


def cell_driver(
    description: str,
    config: type[SerialCellConfig],
    cell: Callable[[Link, float, float, float], ForceReader],
    gauge: type[SimulatedGauge],
) -> AnyDriver:
    """Return the driver of a cell that is made of its port, capacity, sign and rate; its page has its kind's name."""
    return Driver(
        config.kind,
        description,
        config,
        make_opener(CELL, lambda link, section: cell(link, section.capacity_N, section.sign, section.rate_Hz)),
        lambda around: Simulated(config(around.wire.port), gauge(around.wire, around.force_N)),
        messages=PAGES[config.kind],
    )


class LineCell(LineReader):
    """A cell that streams one reading per line; a subclass parses a line by `force_of`.

    The lines carry no time: where cell and unit meet within some milliseconds matters, use a cell with a clock.

    Args:
        sign: 1 where compression reads positive, −1 otherwise.
    """

    name = CELL
    unit = "N"
    fatal: Reason | None = None
    """What ends the readings at the first line that says so; other lines may be noise."""

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 50.0) -> None:
        super().__init__(link, rate_Hz)
        self.capacity_N, self._sign = capacity_N, sign

    def sample_of(self, line: Line) -> Sample | None:
        try:
            return Sample(line.host_s, None, (self._sign * self.force_of(line.text),))
        except BadReply as error:
            if self.is_noise() and error.reason != self.fatal:
                return None
            raise

    @abstractmethod
    def force_of(self, text: bytes) -> float:
        """Return the force of a line, with the sign of the device."""
