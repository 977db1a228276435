"""Driver of a weighing indicator that prints its reading by itself."""

from dataclasses import dataclass

from softcal.core.errors import BadReply
from softcal.station.config import ForceConfig
from softcal.station.driver import Driver, Opening, Simulated, Surroundings
from softcal.station.drivers.text_stream import BAD_IN_A_ROW
from softcal.station.frames.indicator import OVERLOADED, parse_N
from softcal.station.interfaces import Sample
from softcal.station.link import Link, link_for_driver


@dataclass(frozen=True)
class IndicatorConfig(ForceConfig):
    """Weighing indicators that print `ST,GS,+  4.876kg`.

    Args:
        baud_rate: of its port.
        sign: 1 where compression reads positive, −1 otherwise.
    """

    kind: str = "indicator"
    baud_rate: int = 115200
    rate_Hz: float = 50.0
    sign: float = 1.0


class IndicatorCell:
    """Lines `ST,GS,+  4.876kg` as N.

    The lines carry no time: where indicator and unit meet within some milliseconds matters, use a cell with a clock.

    Args:
        link: its port.
        capacity_N: rated load.
        sign: 1 where compression reads positive, −1 otherwise.
        rate_Hz: lines per second it is set to.
    """

    name = "load cell"
    unit = "N"

    def __init__(self, link: Link, capacity_N: float, sign: float = 1.0, rate_Hz: float = 50.0) -> None:
        self._link, self.capacity_N, self._sign, self.rate_Hz = link, capacity_N, sign, rate_Hz
        self._is_synchronised = False
        self._bad_in_a_row = 0

    def start(self) -> None:
        self._link.discard()
        self._is_synchronised, self._bad_in_a_row = False, 0

    def poll(self) -> list[Sample]:
        """Return the readings that arrived, in N.

        Raises:
            NoReply: the port is gone.
            BadReply: overload, or nothing but noise.
        """
        samples = []
        for line in self._link.read_lines():
            if not self._is_synchronised:
                self._is_synchronised = True  # The first line is cut more often than not.
                continue
            try:
                samples.append(Sample(line.host_s, None, (self._sign * parse_N(line.text),)))
                self._bad_in_a_row = 0
            except BadReply as error:
                self._bad_in_a_row += 1
                if error.reason == OVERLOADED or self._bad_in_a_row >= BAD_IN_A_ROW:
                    raise
        return samples

    def close(self) -> None:
        self._link.close()


def _open(config: IndicatorConfig, opening: Opening) -> IndicatorCell:
    with link_for_driver(config.port, opening.clock, config.baud_rate, IndicatorCell.name) as link:
        return IndicatorCell(link, config.capacity_N, config.sign, config.rate_Hz)


def _simulate(around: Surroundings) -> Simulated[IndicatorConfig]:
    from softcal.station.simulated.force_gauge import SimulatedIndicator

    return Simulated(IndicatorConfig(around.wire.port), SimulatedIndicator(around.wire, around.force_N))


DRIVERS = (Driver("indicator", "weighing indicators that print `ST,GS,+  4.876kg`", IndicatorConfig, _open, _simulate),)
