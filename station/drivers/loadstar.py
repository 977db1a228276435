"""Driver of a Loadstar DI-100 or DI-1000 interface that streams its readings (frames/loadstar.py has the source)."""

from dataclasses import dataclass

from softcal.core.errors import BadReply, NoReply
from softcal.core.words.reason import reason
from softcal.station.config import ForceConfig
from softcal.station.driver import Driver, Opening, Simulated, Surroundings
from softcal.station.drivers.text_stream import BAD_IN_A_ROW
from softcal.station.frames import loadstar
from softcal.station.interfaces import Sample
from softcal.station.link import Link, link_for_driver

ANSWER_S = 1.0


@dataclass(frozen=True)
class LoadstarConfig(ForceConfig):
    """Loadstar DI-100 and DI-1000.

    Args:
        baud_rate: of its port.
        sign: 1 where compression reads positive, −1 otherwise.
    """

    kind: str = "loadstar"
    baud_rate: int = 115200
    rate_Hz: float = 80.0
    sign: float = 1.0


class LoadstarCell:
    """Streamed readings as N, in whatever unit the interface is calibrated.

    The lines carry no time: where cell and unit meet within some milliseconds matters, use a cell with a clock.

    Args:
        link: its port; 9600 baud, 230400 in the high-speed model.
        capacity_N: rated load.
        sign: 1 where compression reads positive, −1 otherwise.
        rate_Hz: lines per second it sends.

    Raises:
        NoReply: no such interface answers.
        BadReply: it is calibrated in a unit that is none of force.
    """

    name = "load cell"
    unit = "N"

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 80.0) -> None:
        self._link, self.capacity_N, self._sign, self.rate_Hz = link, capacity_N, sign, rate_Hz
        self._is_synchronised = False
        self._bad_in_a_row = 0
        self._stop_stream()
        self.model = self._ask(loadstar.MODEL)
        if not any(known in self.model.encode() for known in loadstar.KNOWN_MODELS):
            raise NoReply(reason("loadstar.model", model=repr(self.model[:40])))
        self.native_unit = loadstar.parse_unit(self._ask(loadstar.UNITS).encode())

    def start(self) -> None:
        self._link.discard()
        self._is_synchronised, self._bad_in_a_row = False, 0
        self._link.write(loadstar.STREAM)

    def poll(self) -> list[Sample]:
        """Return the readings that arrived, in N.

        Raises:
            NoReply: the port is gone.
            BadReply: nothing but noise or errors.
        """
        samples = []
        for line in self._link.read_lines():
            if not self._is_synchronised:
                self._is_synchronised = True  # The end of a line of before.
                continue
            try:
                force_N = self._sign * loadstar.parse_N(line.text, self.native_unit)
            except BadReply:
                self._bad_in_a_row += 1
                if self._bad_in_a_row >= BAD_IN_A_ROW:
                    raise
                continue
            samples.append(Sample(line.host_s, None, (force_N,)))
            self._bad_in_a_row = 0
        return samples

    def close(self) -> None:
        try:
            self._link.write(loadstar.PING)
        except NoReply:
            pass  # It is gone, and its stream with it.
        self._link.close()

    def _stop_stream(self) -> None:
        """The first carriage return ends a stream or a line of before; the second must be answered."""
        self._link.write(loadstar.PING)
        self._link.clock.sleep_s(0.2)
        self._link.discard()
        self._link.write(loadstar.PING)
        answer = self._link.next_line(ANSWER_S).text
        if answer != loadstar.READY:
            raise NoReply(reason("loadstar.answer", answer=repr(answer[:40])))

    def _ask(self, question: bytes) -> str:
        self._link.write(question)
        return self._link.next_line(ANSWER_S).text.decode("ascii", "replace").strip()


def _open(config: LoadstarConfig, opening: Opening) -> LoadstarCell:
    with link_for_driver(config.port, opening.clock, config.baud_rate, LoadstarCell.name) as link:
        return LoadstarCell(link, config.capacity_N, config.sign, config.rate_Hz)


def _simulate(around: Surroundings) -> Simulated[LoadstarConfig]:
    from softcal.station.simulated.force_gauge import SimulatedLoadstar

    return Simulated(LoadstarConfig(around.wire.port), SimulatedLoadstar(around.wire, around.force_N))


DRIVERS = (Driver("loadstar", "Loadstar DI-100 and DI-1000", LoadstarConfig, _open, _simulate),)
