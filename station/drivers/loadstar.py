"""Loadstar DI-100 and DI-1000 load cell interfaces ("DI-100U / DI-1000U Command Set", loadstarsensors.com)."""

from contextlib import suppress
from dataclasses import dataclass

from softcal.core.errors import BadReply, NoReply
from softcal.core.messages.reason import reason
from softcal.station.drivers.serial_cell import LineCell, SerialCellConfig, cell_driver
from softcal.station.simulated.force_gauge import SimulatedLoadstar
from softcal.station.wire.frames.force_unit import in_newtons
from softcal.station.wire.link import Link

ANSWER_S = 1.0
PING, MODEL, UNITS, STREAM = b"\r", b"MODEL\r", b"UNITS\r", b"WC\r"
READY = b"A"
"""The answer to an empty command, which ends a stream as well."""

SUPPORTED_MODELS = (b"DI-100", b"DI-1000")


def parse_N(line: bytes, unit: str) -> float:
    """Return a streamed value such as `-0.000456` in N; `BadReply`: cut, noise, or `E` for error."""
    try:
        return in_newtons(float(line.decode("ascii").strip()), unit)
    except ValueError as error:
        raise BadReply(reason("loadstar.line", line=repr(line[:40]))) from error


def parse_unit(line: bytes) -> str:
    """Return the unit that `UNITS` reports; raise `BadReply` if it is no unit of force."""
    unit = line.decode("ascii", "replace").strip()
    in_newtons(1.0, unit)
    return unit


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
        link.write(PING)
        link.clock.sleep_s(0.2)
        link.discard()
        link.write(PING)
        answer = link.next_line(ANSWER_S).text
        if answer != READY:
            raise NoReply(reason("loadstar.answer", answer=repr(answer[:40])))
        self.model = self._ask(MODEL)
        if not any(supported in self.model.encode() for supported in SUPPORTED_MODELS):
            raise NoReply(reason("loadstar.model", model=repr(self.model[:40])))
        self.native_unit = parse_unit(self._ask(UNITS).encode())

    def start(self) -> None:
        super().start()
        self._link.write(STREAM)

    def close(self) -> None:
        with suppress(NoReply):  # It is gone, and its stream with it.
            self._link.write(PING)
        super().close()

    def force_of(self, text: bytes) -> float:
        return parse_N(text, self.native_unit)

    def _ask(self, question: bytes) -> str:
        self._link.write(question)
        return self._link.next_line(ANSWER_S).text.decode("ascii", "replace").strip()


DRIVERS = (cell_driver("Loadstar DI-100 and DI-1000", LoadstarConfig, LoadstarCell, SimulatedLoadstar),)
