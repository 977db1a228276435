"""What load cells on a serial line share: the keys of their section, and readings that come line by line."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from softcal.core.errors import BadReply
from softcal.core.words.reason import Reason
from softcal.station.devices.config import ForceConfig
from softcal.station.devices.driver import Opening
from softcal.station.drivers.text_stream import BAD_IN_A_ROW
from softcal.station.interfaces import Sample
from softcal.station.wire.link import Link, link_for_driver

Cell = TypeVar("Cell")


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


def opens(cell: Callable[[Link, float, float, float], Cell]) -> Callable[[SerialCellConfig, Opening], Cell]:
    """Return what opens a cell that is made of its port, capacity, sign and rate."""

    def opened(config: SerialCellConfig, opening: Opening) -> Cell:
        with link_for_driver(config.port, opening.clock, config.baud_rate, LineCell.name) as link:
            return cell(link, config.capacity_N, config.sign, config.rate_Hz)

    return opened


class LineCell(ABC):
    """A cell that sends a reading a line by itself; each kind says by `_force_N` what a line reads.

    The lines carry no time: where cell and unit meet within some milliseconds matters, use a cell with a clock.

    Args:
        link: its port.
        capacity_N: rated load.
        sign: 1 where compression reads positive, −1 otherwise.
        rate_Hz: lines per second it sends.
    """

    name = "load cell"
    unit = "N"
    fatal: Reason | None = None
    """What ends the readings at the first line that says so; other lines may be noise."""

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 50.0) -> None:
        self._link, self.capacity_N, self._sign, self.rate_Hz = link, capacity_N, sign, rate_Hz
        self._is_synchronised = False
        self._bad_in_a_row = 0

    def start(self) -> None:
        self._link.discard()
        self._is_synchronised, self._bad_in_a_row = False, 0

    def poll(self) -> list[Sample]:
        """Return the readings that arrived, in N.

        Raises:
            NoReply: the port is gone.
            BadReply: overload, or nothing but noise or errors.
        """
        samples = []
        for line in self._link.read_lines():
            if not self._is_synchronised:
                self._is_synchronised = True  # The first line is cut more often than not.
                continue
            try:
                samples.append(Sample(line.host_s, None, (self._sign * self._force_N(line.text),)))
                self._bad_in_a_row = 0
            except BadReply as error:
                self._bad_in_a_row += 1
                if error.reason == self.fatal or self._bad_in_a_row >= BAD_IN_A_ROW:
                    raise
        return samples

    def close(self) -> None:
        self._link.close()

    @abstractmethod
    def _force_N(self, text: bytes) -> float:
        """Return the force a line reads, its sign as the device sends it."""
