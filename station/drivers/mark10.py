"""Driver of a Mark-10 force gauge, asked reading by reading (Mark-10 GCL2 manual)."""

from dataclasses import dataclass

from softcal.station.devices.driver import Driver, Simulated, Surroundings
from softcal.station.drivers.serial_cell import SerialCellConfig, opens
from softcal.station.interfaces import Sample
from softcal.station.wire.asked import AskedReader
from softcal.station.wire.frames import gcl2
from softcal.station.wire.link import Link

ANSWER_S = 1.0


@dataclass(frozen=True)
class Mark10Config(SerialCellConfig):
    """Mark-10 gauges, GCL2."""

    kind: str = "mark10"


class Mark10Gauge:
    """A gauge that answers `?C` with a reading and its unit.

    It has no clock of its own: a reading is taken to be from the middle between question and answer. A successful
    command gets no answer at all, so every setting is read back.

    Args:
        link: its port.
        capacity_N: rated load.
        sign: 1 where compression reads positive, as delivered; −1 where the polarity is inverted.
        rate_Hz: questions per second.

    Raises:
        NoReply: no gauge answers.
        CommandRefused: peak mode, or readings without unit or sign, which its menu must change.
    """

    name = "load cell"
    unit = "N"

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 50.0) -> None:
        self._link, self.capacity_N, self._sign, self.rate_Hz = link, capacity_N, sign, rate_Hz
        self._reader = AskedReader(self.name, self.unit, rate_Hz, link, gcl2.CURRENT, self._parse)
        self._set("CUR", "N")

    def start(self) -> None:
        self._reader.start()

    def poll(self) -> list[Sample]:
        """Return the readings that arrived, in N, and ask for the next one when it is time.

        Raises:
            NoReply: the port is gone.
            BadReply: the gauge answers with an error code, or without its unit.
        """
        return self._reader.poll()

    def close(self) -> None:
        self._link.close()

    def _parse(self, line: bytes) -> tuple[float, ...]:
        return (self._sign * gcl2.parse_reading_N(line),)

    def _set(self, *commands: str) -> None:
        self._link.discard()
        for command in commands:
            self._link.write(command.encode() + gcl2.END)
        self._link.write(gcl2.LIST)
        gcl2.check_settings(self._link.next_line(ANSWER_S).text)


def _simulate(around: Surroundings) -> Simulated[Mark10Config]:
    from softcal.station.simulated.force_gauge import SimulatedMark10

    return Simulated(Mark10Config(around.wire.port), SimulatedMark10(around.wire, around.force_N))


DRIVERS = (Driver("mark10", "Mark-10 gauges, GCL2", Mark10Config, opens(Mark10Gauge), _simulate),)
