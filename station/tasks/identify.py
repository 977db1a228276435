"""Identification of the device at a port: listen first, query only then, and never move."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from softcal.core.errors import BadReply, NoReply
from softcal.core.messages.reason import Reason, reason
from softcal.station.clock import estimate_rate_Hz
from softcal.station.drivers import loadstar
from softcal.station.drivers.indicator import OVERLOADED, parse_N
from softcal.station.interfaces import Clock
from softcal.station.motion.monitored_bench import BOOT_S
from softcal.station.wire.frames import esm, gcl2, grbl, zaber
from softcal.station.wire.frames.text_stream import parse as parse_stream
from softcal.station.wire.link import POLL_S, Line, Link

T = TypeVar("T")

LISTEN_S, FEW_LINES = 1.0, 5
ANSWER_S = 2.5
"""An Arduino that was reset by opening its port is in its boot loader for about 1.5 s."""

QUICK_ANSWER_S = 0.5

CONVERTER_COUNTS, CELL_RATES_HZ = 4095, (10.0, 80.0)
"""Largest count of a 12-bit converter; the rates of an HX711."""


@dataclass(frozen=True)
class DeviceIdentity:
    """The device that answers at a port.

    Args:
        role: stage, force, readout; "" when it is nothing softcal knows, or could be either of two.
        kind: the dialect, as in the station file.
        says: its greeting and the recognised device, or the reason why it is unknown.
        rate_Hz: of a stream, by its own clock.
        channels: of a stream; of a stand 1 if a gauge answers.
    """

    port: str
    role: str
    kind: str
    says: Reason
    rate_Hz: float = 0.0
    channels: int = 0


def identify(port: str, clock: Clock) -> DeviceIdentity:
    """Return the device at a port; raise `NoReply` if the port is missing or owned by another process."""
    link = Link(port, clock)
    try:
        for probe in (_stream, _esm, _grbl, _zaber, _mark10, _loadstar):
            if (identity := probe(link)) is not None:
                return identity
        return DeviceIdentity(port, "", "", Reason("port.unknown"))
    finally:
        link.close()


def _stream(link: Link) -> DeviceIdentity | None:
    banner, lines, received = "", [], list[Line]()
    end_s = link.clock.now_s() + BOOT_S
    while len(received) < FEW_LINES and link.clock.now_s() < end_s:
        link.clock.sleep_s(POLL_S)
        received += link.read_lines()
    if not received:
        return None
    link.clock.sleep_s(LISTEN_S)
    after = link.read_lines()
    received, rate_Hz = [*received, *after], len(after) / LISTEN_S
    if any(_is_indicator(line.text) for line in received[1:3]):
        sentence = reason("port.said", said=received[1].text.decode())
        return DeviceIdentity(link.port, "force", "indicator", sentence, rate_Hz, 1)
    for line in received:
        if line.text.startswith(b"softcal "):
            banner = line.text.decode("ascii", "replace")
        with suppress(BadReply):
            lines.append(parse_stream(line.text))
    if len(lines) < FEW_LINES:
        return None
    rate_Hz = estimate_rate_Hz(np.array([line.device_ms for line in lines]) / 1000.0)
    counts = [count for line in lines for count in line.counts]
    role, kind, cause = _classify_stream(banner, max(map(abs, counts)), min(counts), rate_Hz)
    return DeviceIdentity(link.port, role, kind, cause, rate_Hz, len(lines[0].counts))


def _is_indicator(line: bytes) -> bool:
    try:
        parse_N(line)
    except BadReply as error:
        return error.reason == OVERLOADED
    return True


def _classify_stream(banner: str, largest: int, smallest: int, rate_Hz: float) -> tuple[str, str, Reason]:
    """Return role, dialect and why: a banner decides, else what only one kind of device sends."""
    if "load cell" in banner:
        return "force", "hx711", reason("port.said", said=banner)
    if banner:
        return "readout", "arduino", reason("port.said", said=banner)
    if largest >= 2**16 or smallest < 0:
        return "force", "hx711", reason("port.bridge", smallest=smallest, largest=largest)
    if largest <= CONVERTER_COUNTS and not any(abs(rate_Hz - usual_Hz) < 1.5 for usual_Hz in CELL_RATES_HZ):
        return "readout", "arduino", reason("port.converter", largest=largest)
    return "", "", reason("port.either", largest=largest, rate_Hz=rate_Hz)


def _answer(
    link: Link,
    question: bytes,
    parse: Callable[[bytes], T | None],
    within_s: float = QUICK_ANSWER_S,
    is_first: bool = False,
) -> T | None:
    """Return the first answer that reads; or the first at all, where none can be another dialect's."""
    link.discard()
    link.write(question)
    end_s = link.clock.now_s() + within_s
    while link.clock.now_s() < end_s:
        try:
            answer = parse(link.next_line(end_s - link.clock.now_s()).text)
        except BadReply:
            answer = None
        except NoReply:
            return None
        if answer is not None or is_first:
            return answer
    return None


def _esm(link: Link) -> DeviceIdentity | None:
    # Asked before all others: the slash of a Zaber command would open the stand's channel to its gauge.
    if _answer(link, esm.STATUS, esm.parse_status, is_first=True) is None:
        return None
    settings = _answer(link, esm.to_gauge("LIST"), gcl2.parse_settings, is_first=True)
    if settings is None:
        return DeviceIdentity(link.port, "stage", "esm", Reason("port.esm"))
    return DeviceIdentity(link.port, "stage", "esm", reason("port.esm.gauge", unit=settings.unit), 50.0, 1)


def _grbl(link: Link) -> DeviceIdentity | None:
    def parse(line: bytes) -> Reason | None:
        reply = grbl.parse(line)
        if isinstance(reply, grbl.Greeting):
            return reason("port.said", said=reply.text)
        return reason("port.grbl", state=reply.state) if isinstance(reply, grbl.GrblStatus) else None

    answer = _answer(link, b"\r\n" + grbl.STATUS, parse, ANSWER_S)
    return DeviceIdentity(link.port, "stage", "grbl", answer) if answer else None


def _zaber(link: Link) -> DeviceIdentity | None:
    question = b"\n" + zaber.format_command(zaber.Command(1, 0, 1, "get deviceid"))  # the line of before is ended
    reply = _answer(link, question, zaber.parse_reply, is_first=True)
    return DeviceIdentity(link.port, "stage", "zaber", reason("port.zaber", device=reply.data)) if reply else None


def _mark10(link: Link) -> DeviceIdentity | None:
    settings = _answer(link, gcl2.END + gcl2.LIST, gcl2.parse_settings)
    answer = reason("port.mark10", unit=settings.unit) if settings else None
    return DeviceIdentity(link.port, "force", "mark10", answer, 50.0, 1) if answer else None


def _loadstar(link: Link) -> DeviceIdentity | None:
    def parse(line: bytes) -> str | None:
        return (
            line.decode("ascii", "replace")
            if any(supported in line for supported in loadstar.SUPPORTED_MODELS)
            else None
        )

    model = _answer(link, loadstar.PING + loadstar.MODEL, parse)
    answer = reason("port.loadstar", model=model) if model else None
    return DeviceIdentity(link.port, "force", "loadstar", answer, 80.0, 1) if answer else None
