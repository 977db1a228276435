"""Driver of a Mark-10 force gauge, asked reading by reading (Mark-10 GCL2 manual)."""

from dataclasses import dataclass

from softcal.station.device_names import CELL
from softcal.station.drivers.serial_cell import SerialCellConfig, cell_driver
from softcal.station.simulated.force_gauge import SimulatedMark10
from softcal.station.wire.frames import gcl2
from softcal.station.wire.link import Link
from softcal.station.wire.query_reader import QueryReader

ANSWER_S = 1.0


@dataclass(frozen=True)
class Mark10Config(SerialCellConfig):
    """Mark-10 gauges, GCL2."""

    kind: str = "mark10"


class Mark10Gauge(QueryReader):
    """A gauge that answers `?C` with a reading and its unit.

    It has no clock: the time of a reading is the midpoint between query and answer. A successful
    command gets no answer at all, so every setting is read back.

    Args:
        sign: 1 where compression reads positive, as delivered; −1 where the polarity is inverted.
    """

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 50.0) -> None:
        def parse(line: bytes) -> tuple[float, ...]:
            return (sign * gcl2.parse_reading_N(line),)

        super().__init__(CELL, "N", rate_Hz, link, gcl2.CURRENT, parse)
        self.capacity_N = capacity_N
        link.discard()
        for command in (b"CUR" + gcl2.END, b"N" + gcl2.END, gcl2.LIST):
            link.write(command)
        gcl2.check_settings(link.next_line(ANSWER_S).text)


DRIVERS = (cell_driver("Mark-10 gauges, GCL2", Mark10Config, Mark10Gauge, SimulatedMark10),)
