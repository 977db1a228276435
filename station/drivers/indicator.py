"""Weighing indicators that print `ST,GS,+  4.876kg` by themselves (A&D, OHAUS and many others)."""

import re
from dataclasses import dataclass

from softcal.core.errors import BadReply
from softcal.core.messages.reason import Reason, reason
from softcal.station.drivers.serial_cell import LineCell, SerialCellConfig, cell_driver
from softcal.station.simulated.force_gauge import SimulatedIndicator
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


@dataclass(frozen=True)
class IndicatorConfig(SerialCellConfig):
    """Weighing indicators that print `ST,GS,+  4.876kg`."""

    kind: str = "indicator"


class IndicatorCell(LineCell):
    """Lines `ST,GS,+  4.876kg` as N."""

    fatal = OVERLOADED

    def force_of(self, text: bytes) -> float:
        return parse_N(text)


_DESCRIPTION = "weighing indicators that print `ST,GS,+  4.876kg`"
DRIVERS = (cell_driver(_DESCRIPTION, IndicatorConfig, IndicatorCell, SimulatedIndicator),)
