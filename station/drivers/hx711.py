"""A load cell behind an HX711 or ADS1232: its Arduino prints 24-bit counts (data sheets of Avia and TI)."""

from dataclasses import dataclass

from softcal.core.errors import BadReply, InputError
from softcal.core.messages.reason import Reason, reason
from softcal.station.device_names import CELL, device_label
from softcal.station.devices.config import ForceConfig
from softcal.station.devices.driver import Driver, Simulated, Surroundings, make_opener
from softcal.station.drivers.text_stream import WIRES, TextStream
from softcal.station.messages import PAGES
from softcal.station.simulated.text_stream import CELL_COUNTS_PER_N, CELL_ZERO_COUNTS, SimulatedTextStream
from softcal.station.wire.link import Link

RAILS = (-(2**23), 2**23 - 1)
"""Counts of a saturated converter: overload, or a bridge that is not connected."""


@dataclass(frozen=True)
class Hx711Config(ForceConfig):
    """A bare load cell behind an HX711.

    Args:
        baud_rate: of its port.
        counts_per_N, zero_counts: from `softcal station calibrate-cell`.
    """

    kind: str = "hx711"
    baud_rate: int = 115200
    counts_per_N: float = 10000.0
    zero_counts: float = 0.0

    def __post_init__(self) -> None:
        if self.counts_per_N == 0:
            raise InputError(Reason("station_file.no_scale"))


class Hx711Cell(TextStream):
    """Counts as N: (count − zero) / counts_per_N.

    Args:
        counts_per_N: from the calibration with dead weights; its sign makes compression positive.
        rate_Hz: 10 or 80 samples per second.
    """

    unit = "N"

    def __init__(
        self, link: Link, counts_per_N: float, zero_counts: float, capacity_N: float, rate_Hz: float = 80.0
    ) -> None:
        super().__init__(CELL, link, 1, rate_Hz)
        self.counts_per_N, self.zero_counts, self.capacity_N = counts_per_N, zero_counts, capacity_N

    def values_of(self, counts: tuple[int, ...]) -> tuple[float, ...]:
        """Return the force; raise `BadReply` if the converter is at its rail."""
        if not RAILS[0] < counts[0] < RAILS[1]:
            raise BadReply(reason("hx711.saturated", device=device_label(self.name), count=float(counts[0])))
        return ((counts[0] - self.zero_counts) / self.counts_per_N,)


def _simulate(around: Surroundings) -> Simulated[Hx711Config]:
    config = Hx711Config(around.wire.port, counts_per_N=CELL_COUNTS_PER_N, zero_counts=CELL_ZERO_COUNTS)

    def counts(now_s: float) -> tuple[int, ...]:
        count = round(config.zero_counts + config.counts_per_N * around.force_N(now_s))
        return (min(max(count, RAILS[0]), RAILS[1]),)

    drift = float(around.rng.normal(0, 1e-3))
    banner = b"softcal load cell 1\r\n"
    return Simulated(config, SimulatedTextStream(around.wire, counts, config.rate_Hz, drift, banner=banner))


_OPEN = make_opener(
    CELL,
    lambda link, config: Hx711Cell(link, config.counts_per_N, config.zero_counts, config.capacity_N, config.rate_Hz),
)
_DESCRIPTION = "text lines `ms,counts` of an HX711 or ADS1232"
_MESSAGES = {**PAGES["text_stream"], **PAGES["hx711"]}
DRIVERS = (Driver("hx711", _DESCRIPTION, Hx711Config, _OPEN, _simulate, WIRES, messages=_MESSAGES),)
