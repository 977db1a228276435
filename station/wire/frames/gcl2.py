"""Mark-10 Gauge Control Language 2: readings, settings, errors (GCL2 manual). No I/O here."""

import re
from dataclasses import dataclass

from softcal.core.errors import BadReply, CommandRefused, NoReply
from softcal.core.messages.reason import Reason, reason
from softcal.station.wire.frames.force_unit import in_newtons

CURRENT, LIST = b"?C\r", b"LIST\r"
END = b"\r"

ERRORS = {f"*{code}": Reason(f"gcl2.error.{code}") for code in (10, 11, 12, 22)}

_READING = re.compile(r"([+-]?\d+(?:\.\d+)?)(?: ([A-Za-z]+))?")


@dataclass(frozen=True)
class GaugeSettings:
    """Settings of a gauge, as `LIST` reports them.

    Args:
        unit: LBF, OZF, KGF, GF, N, MN, KN.
        mode: CUR, PT (peak tension), PC (peak compression).
        has_units: whether readings carry their unit (FULL) or not (NUM).
        has_sign: whether readings carry their sign (POL).
    """

    unit: str
    mode: str
    has_units: bool
    has_sign: bool


def parse_reading_N(line: bytes) -> float:
    """Return a reading in N; raise `BadReply` for an error code, a missing unit, or noise."""
    text = _text(line)
    if text in ERRORS:
        raise BadReply(reason("gcl2.error", code=text, why=ERRORS[text]))
    reading = _READING.fullmatch(text)
    if not reading:
        raise BadReply(reason("gcl2.reading", line=repr(line[:40])))
    if not reading[2]:
        raise BadReply(Reason("gcl2.no_unit"))
    return in_newtons(float(reading[1]), reading[2])


def parse_settings(line: bytes) -> GaugeSettings:
    """Return the answer to `LIST`; raise `BadReply` for any other text."""
    fields = _text(line).split(";")
    modes = [field for field in fields if field in ("CUR", "PT", "PC")]
    if len(fields) < 4 or not fields[0].startswith("V") or not modes:
        raise BadReply(reason("gcl2.list", line=repr(line[:60])))
    return GaugeSettings(fields[1], modes[0], "NUM" not in fields, "NOPOL" not in fields)


def check_settings(line: bytes) -> None:
    """Refuse a gauge whose settings in `LIST` are not signed readings in N."""
    settings = parse_settings(line)
    if (settings.mode, settings.unit) != ("CUR", "N"):
        raise NoReply(reason("gauge.mode", mode=settings.mode, unit=settings.unit))
    if not settings.has_units or not settings.has_sign:
        raise CommandRefused(Reason("gauge.settings"))


def _text(line: bytes) -> str:
    try:
        return line.decode("ascii").strip()
    except UnicodeDecodeError as error:
        raise BadReply(reason("gcl2.noise", line=repr(line[:40]))) from error
