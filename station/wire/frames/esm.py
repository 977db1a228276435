"""Mark-10 ESM301 and ESM303 test stands under PC control (ESM303 User's Guide, section 6.2). No I/O here.

Commands are single letters without a line end; a command that is no question gets no answer.
"""

import re
from dataclasses import dataclass

from softcal.core.errors import BadReply
from softcal.core.messages.reason import reason

UP, DOWN, STOP = b"u", b"d", b"s"
TRAVEL, STATUS, GAUGE_READING = b"x", b"p", b"?"
ZERO_TRAVEL, MILLIMETRES, MANUAL_MODE, LIMIT_MODE, PROGRAMMED_SPEED = b"z", b"i", b"m", b"l", b"o"

SPEED_MM_MIN = (0.5, 1100.0)
"""Slowest and fastest crosshead speed."""

LIMIT_MM = 999.99
"""The largest travel limit that the command's format can hold."""

MM_PER_INCH = 25.4

_STATUS = re.compile(r"([UDS])\W*([CLM])\W*(UL|DL)?")
_TRAVEL = re.compile(r"([+-]?\d+(?:\.\d+)?) ?(mm|in)?")


@dataclass(frozen=True)
class StandStatus:
    """Status of the stand, from the answer to `p`.

    Args:
        motion: U moving up, D moving down, S stopped.
        mode: C cycle, L limit, M manual.
        limit: UL at the upper limit, DL at the lower one, "" at none.
    """

    motion: str
    mode: str
    limit: str


def speed(mm_s: float) -> bytes:
    """Return the command that programs a speed: `e0200.3` is 200.3 mm/min."""
    return b"e%06.1f" % (60.0 * mm_s)


def lower_limit(travel_mm: float) -> bytes:
    """Return the command that sets the lower travel limit: `g-007.52` is −7.52 mm."""
    return b"g" + _limit(travel_mm)


def upper_limit(travel_mm: float) -> bytes:
    """Return the command that sets the upper travel limit: `h010.70` is 10.7 mm."""
    return b"h" + _limit(travel_mm)


def to_gauge(command: str) -> bytes:
    r"""Return a command passed through to the gauge: `/LIST\`."""
    return b"/" + command.encode() + b"\\"


def parse_status(line: bytes) -> StandStatus:
    """Return the answer to `p`; raise `BadReply` for any other text."""
    match = _STATUS.fullmatch(line.decode("ascii", "replace").strip())
    if not match:
        raise BadReply(reason("esm.status", line=repr(line[:40])))
    return StandStatus(match[1], match[2], match[3] or "")


def parse_travel_mm(line: bytes) -> float:
    """Return the answer to `x` in mm, upward positive; raise `BadReply` for any other text."""
    match = _TRAVEL.fullmatch(line.decode("ascii", "replace").strip())
    if not match:
        raise BadReply(reason("esm.travel_line", line=repr(line[:40])))
    return float(match[1]) * (MM_PER_INCH if match[2] == "in" else 1.0)


def _limit(travel_mm: float) -> bytes:
    sign = b"-" if travel_mm < 0 else b""
    return sign + b"%06.2f" % abs(travel_mm)
