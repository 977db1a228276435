"""Driver of a Loadstar DI-100 or DI-1000 interface that streams its readings (frames/loadstar.py has the source)."""

from contextlib import suppress
from dataclasses import dataclass

from softcal.core.errors import NoReply
from softcal.core.words.reason import reason
from softcal.station.devices.driver import Driver
from softcal.station.drivers.serial_cell import LineCell, SerialCellConfig, opens_cell, simulates
from softcal.station.simulated.force_gauge import SimulatedLoadstar
from softcal.station.wire.frames import loadstar
from softcal.station.wire.link import Link

ANSWER_S = 1.0


@dataclass(frozen=True)
class LoadstarConfig(SerialCellConfig):
    """Loadstar DI-100 and DI-1000."""

    kind: str = "loadstar"
    rate_Hz: float = 80.0


class LoadstarCell(LineCell):
    """Streamed readings as N, whatever their unit; 9600 baud, 230400 in the high-speed model."""

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 80.0) -> None:
        super().__init__(link, capacity_N, sign, rate_Hz)
        # The first carriage return ends what was before; the second must be answered.
        link.write(loadstar.PING)
        link.clock.sleep_s(0.2)
        link.discard()
        link.write(loadstar.PING)
        answer = link.next_line(ANSWER_S).text
        if answer != loadstar.READY:
            raise NoReply(reason("loadstar.answer", answer=repr(answer[:40])))
        self.model = self._ask(loadstar.MODEL)
        if not any(known in self.model.encode() for known in loadstar.KNOWN_MODELS):
            raise NoReply(reason("loadstar.model", model=repr(self.model[:40])))
        self.native_unit = loadstar.parse_unit(self._ask(loadstar.UNITS).encode())

    def start(self) -> None:
        super().start()
        self._link.write(loadstar.STREAM)

    def close(self) -> None:
        with suppress(NoReply):  # It is gone, and its stream with it.
            self._link.write(loadstar.PING)
        super().close()

    def _force_N(self, text: bytes) -> float:
        return loadstar.parse_N(text, self.native_unit)

    def _ask(self, question: bytes) -> str:
        self._link.write(question)
        return self._link.next_line(ANSWER_S).text.decode("ascii", "replace").strip()


_SIMULATE = simulates(LoadstarConfig, SimulatedLoadstar)
DRIVERS = (Driver("loadstar", "Loadstar DI-100 and DI-1000", LoadstarConfig, opens_cell(LoadstarCell), _SIMULATE),)
