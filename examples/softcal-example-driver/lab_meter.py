"""A capacitance meter of our laboratory: it answers `C?` with `+12.345 pF`."""

from dataclasses import dataclass

from softcal.core.errors import BadReply, CommandRefused, InputError
from softcal.core.messages.reason import reason
from softcal.station.devices.config import ReadoutConfig
from softcal.station.devices.driver import Driver, Opening, Simulated, Surroundings
from softcal.station.simulated.far_end import SimulatedAnswers
from softcal.station.wire.link import link_for_driver
from softcal.station.wire.query_reader import QueryReader


@dataclass(frozen=True)
class MeterConfig(ReadoutConfig):
    """Its section of the station file.

    Args:
        baud_rate: of its port.
        averages: readings it averages, 1 to 16.
    """

    kind: str = "lab_meter"
    baud_rate: int = 9600
    averages: int = 4

    def __post_init__(self) -> None:
        if not 1 <= self.averages <= 16:
            raise InputError(f"readout.averages is {self.averages}; a number in [1, 16] was expected")


def parse_pF(line: bytes) -> tuple[float, ...]:
    number, _, unit = line.partition(b" ")
    if unit != b"pF" or not number.lstrip(b"+-").replace(b".", b"", 1).isdigit():
        raise BadReply(reason("lab_meter.reading", line=repr(line[:40])))
    return (float(number),)


def open_meter(config: MeterConfig, opening: Opening) -> QueryReader:
    with link_for_driver(config.port, opening.clock, config.baud_rate, "lab meter") as link:
        link.write(f"AVG {config.averages}\nAVG?\n".encode())
        if link.next_line(1.0).text != str(config.averages).encode():
            raise CommandRefused(reason("lab_meter.other", port=config.port))
        return QueryReader("lab meter", "pF", config.rate_Hz, link, b"C?\n", parse_pF, limits=(-10.0, 2000.0))


def simulate(around: Surroundings) -> Simulated[MeterConfig]:
    averages = ["1"]

    def answer(query: str, now_s: float) -> str:
        if query.startswith("AVG "):
            averages[0] = query.removeprefix("AVG ")
        return {"C?": f"{100 * around.outputs_V(now_s)[0]:+.3f} pF", "AVG?": averages[0]}.get(query, "")

    return Simulated(MeterConfig(around.wire.port), SimulatedAnswers(around.wire, answer), reading_per_V=100.0)


MESSAGES = {
    "lab_meter.reading": "lab meter: it sent {line}; a reading as b'+12.345 pF' was expected",
    "lab_meter.other": "lab meter ({port}): it does not take AVG; is it the meter?",
}
WHAT = "the capacitance meter of our laboratory"
DRIVER = Driver("lab_meter", WHAT, MeterConfig, open_meter, simulate, messages=MESSAGES)
