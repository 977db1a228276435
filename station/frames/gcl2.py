"""Mark-10 Gauge Control Language 2: readings, settings, errors of a force gauge (GCL2 manual). No I/O here."""

import re
from dataclasses import dataclass

from softcal.core.errors import BadReply
from softcal.station.frames.force_unit import in_newtons

CURRENT, LIST = b"?C\r", b"LIST\r"
END = b"\r"

ERRORS = {
    "*10": "illegal command",
    "*11": "not applicable in this state",
    "*12": "invalid specifier",
    "*22": "value too large",
}

_READING = re.compile(r"([+-]?\d+(?:\.\d+)?)(?: ([A-Za-z]+))?")


@dataclass(frozen=True)
class GaugeSettings:
    """What `LIST` reports.

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
    """Return a reading in N, compression positive as the gauge shows it.

    Raises:
        BadReply: an error code, a reading without its unit, or noise.
    """
    text = _text(line)
    if text in ERRORS:
        raise BadReply(f"gauge: {text} ({ERRORS[text]}); check its settings")
    reading = _READING.fullmatch(text)
    if not reading:
        raise BadReply(f"gauge answered {line[:40]!r}; a reading such as `-18.78 lbF` was expected")
    if not reading[2]:
        raise BadReply("gauge: readings come without their unit; switch off 'Numeric only' in its menu")
    return in_newtons(float(reading[1]), reading[2])


def parse_settings(line: bytes) -> GaugeSettings:
    """Return the answer to `LIST`.

    Raises:
        BadReply: not such an answer.
    """
    fields = _text(line).split(";")
    modes = [field for field in fields if field in ("CUR", "PT", "PC")]
    if len(fields) < 4 or not fields[0].startswith("V") or not modes:
        raise BadReply(f"gauge answered {line[:60]!r} to LIST; `V1.00;LBF;CUR;...` was expected")
    return GaugeSettings(fields[1], modes[0], "NUM" not in fields, "NOPOL" not in fields)


def _text(line: bytes) -> str:
    try:
        return line.decode("ascii").strip()
    except UnicodeDecodeError as error:
        raise BadReply(f"gauge answered {line[:40]!r}, which is noise") from error
