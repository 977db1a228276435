"""Weighing indicators that print `ST,GS,+  4.876kg` (A&D, OHAUS and many others). No I/O here."""

import re

from softcal.core.errors import BadReply
from softcal.core.words.reason import Reason, reason
from softcal.station.wire.frames.force_unit import in_newtons

_LINE = re.compile(r"(ST|US|OL),(GS|NT),([+-])\s*(\d+(?:\.\d+)?)\s*([A-Za-z]+)")


OVERLOADED = Reason("indicator.overloaded")


def parse_N(line: bytes) -> float:
    """Return a reading in N, stable or not: presses never are; `BadReply`: overload, cut, noise."""
    try:
        fields = _LINE.fullmatch(line.decode("ascii").strip())
    except UnicodeDecodeError as error:
        raise BadReply(reason("indicator.noise", line=repr(line[:40]))) from error
    if not fields:
        raise BadReply(reason("indicator.line", line=repr(line[:40])))
    state, _, sign, number, unit = fields.groups()
    if state == "OL":
        raise BadReply(OVERLOADED)
    return in_newtons(float(sign + number), unit)
