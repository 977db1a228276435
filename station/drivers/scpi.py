"""Bench instruments as the sensor's readout: multimeters and LCR meters that speak SCPI, over LAN, USB or RS-232.

Commands: Keysight Truevolt Series Operating and Service Guide (34460A ... 34470A); Keysight E4980A/AL User's Guide,
remote control. Both measure on demand, so that every answer is a fresh reading.
"""

from dataclasses import dataclass

from softcal.core.errors import BadReply, CommandRefused, InputError, NoReply
from softcal.core.messages.reason import Reason, reason
from softcal.station.device_names import READOUT, device_label
from softcal.station.devices.config import ReadoutConfig, check_choice, check_positive, check_within
from softcal.station.devices.driver import Driver, Simulated, Surroundings, make_opener
from softcal.station.messages import PAGES
from softcal.station.simulated.scpi import SimulatedDmm, SimulatedLcr
from softcal.station.wire.link import Link
from softcal.station.wire.query_reader import QueryReader
from softcal.station.wire.transport import WireKind

ANSWER_S = 3.0
OVERLOAD = 9.9e37
"""What SCPI instruments send for a value beyond the range."""

MAINS_HZ = 50.0
"""Integration is counted in cycles of the mains; at 60 Hz it is shorter."""

DMM_MODELS = ("34410A", "34411A", "34460A", "34461A", "34465A", "34470A")
LCR_MODELS = ("E4980A", "E4980AL")

DMM_QUANTITIES = {"voltage": ("VOLT:DC", "V"), "resistance": ("RES", "ohm"), "resistance_4w": ("FRES", "ohm")}
LCR_QUANTITIES = {"capacitance": ("CPD", "pF", 1e12), "resistance": ("RX", "ohm", 1.0)}
LCR_STATUS = {
    1: Reason("scpi.overloaded"),
    3: Reason("scpi.source"),
    4: Reason("scpi.level"),
    -1: Reason("scpi.no_data"),
}


@dataclass(frozen=True)
class DmmConfig(ReadoutConfig):
    """A multimeter.

    Args:
        baud_rate: of a serial port.
        quantity: voltage, resistance or resistance_4w.
        full_scale: of the fixed range, V or ohm; the instrument takes the range that holds it.
        cycles: mains cycles each reading is integrated over: 0.02, 0.2, 1, 10 or 100.
    """

    kind: str = "scpi_dmm"
    baud_rate: int = 115200
    quantity: str = "resistance"
    full_scale: float = 10_000.0
    cycles: float = 0.2

    def __post_init__(self) -> None:
        check_choice("readout.quantity", self.quantity, DMM_QUANTITIES)
        _check_one_channel(self)
        check_choice("readout.cycles", self.cycles, (0.02, 0.2, 1.0, 10.0, 100.0))
        if self.rate_Hz * self.cycles / MAINS_HZ > 0.8:
            max_rate_Hz = 0.8 * MAINS_HZ / self.cycles
            raise InputError(
                reason("station_file.dmm_rate", rate_Hz=self.rate_Hz, cycles=self.cycles, most_Hz=max_rate_Hz)
            )
        check_positive("readout.full_scale", self.full_scale)


@dataclass(frozen=True)
class LcrConfig(ReadoutConfig):
    """An LCR meter; a capacitance is recorded in pF.

    Args:
        baud_rate: of a serial port.
        quantity: capacitance (parallel) or resistance (series).
        full_scale: largest value, pF or ohm; beyond it the recording is refused.
        frequency_Hz, level_V: of the measuring signal.
        impedance_ohm: fixed measuring range of the instrument, ohm; 0 lets it choose, which costs time.
    """

    kind: str = "scpi_lcr"
    baud_rate: int = 115200
    quantity: str = "capacitance"
    full_scale: float = 1000.0
    frequency_Hz: float = 100_000.0
    level_V: float = 1.0
    impedance_ohm: float = 0.0

    def __post_init__(self) -> None:
        check_choice("readout.quantity", self.quantity, LCR_QUANTITIES)
        _check_one_channel(self)
        check_within("readout.frequency_Hz", self.frequency_Hz, 20, 2e6)
        if not 0.0 < self.level_V <= 20.0:
            raise InputError(reason("station_file.level", level_V=self.level_V))
        check_positive("readout.full_scale", self.full_scale)


def _check_one_channel(config: ReadoutConfig) -> None:
    if config.channels != 1:
        raise InputError(reason("station_file.one_channel", channels=config.channels, kind=str(config.kind)))


def _readout(
    link: Link,
    config: ReadoutConfig,
    models: tuple[str, ...],
    setup: tuple[str, ...],
    question: bytes,
    unit: str,
    per_unit: float,
    full_scale: float,
) -> QueryReader:
    """Return what asks a bench instrument of these models for one quantity, at a steady rate."""
    link.discard()
    identity = _answer(link, "*IDN?").strip()
    fields = [field.strip() for field in identity.split(",")]
    if len(fields) < 2 or fields[1] not in models:
        raise NoReply(
            reason("scpi.other", device=device_label(READOUT), identity=repr(identity[:60]), models=", ".join(models))
        )
    # One command a line: over USB-TMC each line is a message of its own.
    for command in ("*RST", "*CLS", *setup):
        link.write(command.encode() + b"\n")
    error = _answer(link, "SYST:ERR?")
    if parse_int(error.split(",")[0]) != 0:
        raise CommandRefused(reason("scpi.settings", device=device_label(READOUT), error=error[:80]))

    def parse(line: bytes) -> tuple[float, ...]:
        return (per_unit * parse_reading(line),)

    return QueryReader(READOUT, unit, config.rate_Hz, link, question, parse, limits=(-full_scale, full_scale))


def _answer(link: Link, question: str) -> str:
    link.write(question.encode() + b"\n")
    return link.next_line(ANSWER_S).text.decode("ascii", "replace")


def parse_reading(line: bytes) -> float:
    """Return the first number of an answer; `BadReply` by the third, an LCR meter's status."""
    fields = line.split(b",")
    try:
        value = float(fields[0])
    except ValueError as error:
        raise BadReply(reason("scpi.reading", device=device_label(READOUT), line=repr(line[:40]))) from error
    status = parse_int(fields[2].decode("ascii", "replace")) if len(fields) > 2 else 0
    if status:
        cause = LCR_STATUS.get(status) or reason("scpi.status.other", status=status)
        raise BadReply(reason("scpi.status", device=device_label(READOUT), why=cause))
    if not abs(value) < OVERLOAD:
        raise BadReply(reason("scpi.overload", device=device_label(READOUT)))
    return value


def parse_int(text: str) -> int:
    """Return an integer in SCPI notation; raise `BadReply` for any other text."""
    try:
        return int(float(text))
    except (ValueError, OverflowError) as error:
        raise BadReply(reason("scpi.whole", device=device_label(READOUT), text=repr(text[:40]))) from error


def dmm_setup(config: DmmConfig) -> tuple[str, ...]:
    """Return the commands for one reading a question, at a fixed range."""
    function, _ = DMM_QUANTITIES[config.quantity]
    # Four wires have no autozero to switch off.
    zero = () if function == "FRES" else (f"{function}:ZERO:AUTO OFF",)
    commands = (f"CONF:{function} {config.full_scale:g}", f"{function}:NPLC {config.cycles:g}", *zero)
    return (*commands, "TRIG:SOUR IMM", "TRIG:DEL 0", "SAMP:COUN 1")


def lcr_setup(config: LcrConfig) -> tuple[str, ...]:
    """Return the commands for one measurement a trigger."""
    function, _, _ = LCR_QUANTITIES[config.quantity]
    auto = config.impedance_ohm == 0
    ranges = "FUNC:IMP:RANG:AUTO ON" if auto else f"FUNC:IMP:RANG {config.impedance_ohm:g}"
    signal = (f"FREQ {config.frequency_Hz:g}", f"VOLT {config.level_V:g}")
    return ("FORM ASC", f"FUNC:IMP {function}", ranges, *signal, "APER SHOR,1", "TRIG:SOUR BUS", "INIT:CONT ON")


def _dmm(link: Link, config: DmmConfig) -> QueryReader:
    unit, max_reading = DMM_QUANTITIES[config.quantity][1], 1.2 * config.full_scale
    return _readout(link, config, DMM_MODELS, dmm_setup(config), b"READ?\n", unit, 1.0, max_reading)


def _lcr(link: Link, config: LcrConfig) -> QueryReader:
    _, unit, per_unit = LCR_QUANTITIES[config.quantity]
    question = b"TRIG:IMM;:FETC?\n"
    return _readout(link, config, LCR_MODELS, lcr_setup(config), question, unit, per_unit, config.full_scale)


def _simulate_dmm(around: Surroundings) -> Simulated[DmmConfig]:
    config = DmmConfig(around.wire.port, rate_Hz=around.electronics.sample_rate_Hz)
    return Simulated(config, SimulatedDmm(around.wire, lambda now_s: 1000.0 * around.outputs_V(now_s)[0]), 1000.0)


def _simulate_lcr(around: Surroundings) -> Simulated[LcrConfig]:
    config = LcrConfig(around.wire.port, rate_Hz=around.electronics.sample_rate_Hz)
    return Simulated(config, SimulatedLcr(around.wire, lambda now_s: 100e-12 * around.outputs_V(now_s)[0]), 100.0)


_DMM, _LCR = "SCPI multimeters: Keysight 34461A and its family", "SCPI LCR meters: Keysight E4980A, E4980AL"
_WIRES: tuple[WireKind, ...] = ("tcp", "visa", "serial")
DRIVERS = (
    Driver("scpi_dmm", _DMM, DmmConfig, make_opener(READOUT, _dmm), _simulate_dmm, _WIRES, messages=PAGES["scpi"]),
    Driver("scpi_lcr", _LCR, LcrConfig, make_opener(READOUT, _lcr), _simulate_lcr, _WIRES, messages=PAGES["scpi"]),
)
