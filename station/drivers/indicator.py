"""Driver of a weighing indicator that prints its reading by itself."""

from dataclasses import dataclass

from softcal.station.devices.driver import Driver
from softcal.station.drivers.serial_cell import LineCell, SerialCellConfig, opens_cell, simulates
from softcal.station.simulated.force_gauge import SimulatedIndicator
from softcal.station.wire.frames.indicator import OVERLOADED, parse_N


@dataclass(frozen=True)
class IndicatorConfig(SerialCellConfig):
    """Weighing indicators that print `ST,GS,+  4.876kg`."""

    kind: str = "indicator"


class IndicatorCell(LineCell):
    """Lines `ST,GS,+  4.876kg` as N."""

    fatal = OVERLOADED

    def _force_N(self, text: bytes) -> float:
        return parse_N(text)


_WHAT = "weighing indicators that print `ST,GS,+  4.876kg`"
_SIMULATE = simulates(IndicatorConfig, SimulatedIndicator)
DRIVERS = (Driver("indicator", _WHAT, IndicatorConfig, opens_cell(IndicatorCell), _SIMULATE),)
