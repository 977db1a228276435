"""Driver of a weighing indicator that prints its reading by itself."""

from dataclasses import dataclass

from softcal.station.devices.driver import Driver, Simulated, Surroundings
from softcal.station.drivers.serial_cell import LineCell, SerialCellConfig, opens
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


def _simulate(around: Surroundings) -> Simulated[IndicatorConfig]:
    from softcal.station.simulated.force_gauge import SimulatedIndicator

    return Simulated(IndicatorConfig(around.wire.port), SimulatedIndicator(around.wire, around.force_N))


DRIVERS = (
    Driver(
        "indicator",
        "weighing indicators that print `ST,GS,+  4.876kg`",
        IndicatorConfig,
        opens(IndicatorCell),
        _simulate,
    ),
)
