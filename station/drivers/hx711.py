"""A load cell behind an HX711 whose Arduino prints raw 24-bit counts (Avia Semiconductor, HX711 data sheet)."""

from dataclasses import dataclass

from softcal.core.errors import BadReply, InputError
from softcal.core.words.reason import Reason, reason
from softcal.station.devices.config import ForceConfig
from softcal.station.devices.driver import Driver, Opening, Simulated, Surroundings
from softcal.station.drivers.text_stream import TextStream
from softcal.station.interfaces import Sample
from softcal.station.named import named
from softcal.station.wire.link import Link, link_for_driver
from softcal.station.wire.transport import WireKind

RAILS = (-(2**23), 2**23 - 1)
"""Counts of a saturated converter: overload, or a bridge that is not connected."""


@dataclass(frozen=True)
class Hx711Config(ForceConfig):
    """A bare load cell behind an HX711.

    Args:
        baud_rate: of its port.
        counts_per_N, zero_counts: from `softcal station calibrate-cell`.

    Raises:
        InputError: a scale of 0.
    """

    kind: str = "hx711"
    baud_rate: int = 115200
    counts_per_N: float = 10000.0
    zero_counts: float = 0.0

    def __post_init__(self) -> None:
        if self.counts_per_N == 0:
            raise InputError(Reason("station_file.no_scale"))


class Hx711Cell:
    """Counts as N: (count − zero) / counts_per_N.

    Args:
        link: its port.
        counts_per_N: from the calibration with dead weights; its sign makes compression positive.
        zero_counts: count of the unloaded cell.
        capacity_N: rated load.
        rate_Hz: 10 or 80 samples per second.
    """

    unit = "N"
    name = "load cell"

    def __init__(
        self, link: Link, counts_per_N: float, zero_counts: float, capacity_N: float, rate_Hz: float = 80.0
    ) -> None:
        self.counts_per_N, self.zero_counts = counts_per_N, zero_counts
        self.capacity_N, self.rate_Hz = capacity_N, rate_Hz
        self.stream = TextStream(self.name, link, 1, rate_Hz)

    def start(self) -> None:
        self.stream.start()

    def poll(self) -> list[Sample]:
        """Return the samples that arrived since the last call, in N.

        Raises:
            BadReply: the converter is at its rail; the force is not known.
        """
        return [self._in_N(sample) for sample in self.stream.poll()]

    def close(self) -> None:
        self.stream.close()

    def _in_N(self, sample: Sample) -> Sample:
        count = sample.values[0]
        if not RAILS[0] < count < RAILS[1]:
            raise BadReply(reason("hx711.saturated", device=named(self.name), count=count))
        return Sample(sample.host_s, sample.device_s, ((count - self.zero_counts) / self.counts_per_N,))


def _open(config: Hx711Config, opening: Opening) -> Hx711Cell:
    with link_for_driver(config.port, opening.clock, config.baud_rate, Hx711Cell.name) as link:
        return Hx711Cell(link, config.counts_per_N, config.zero_counts, config.capacity_N, config.rate_Hz)


def _simulate(around: Surroundings) -> Simulated[Hx711Config]:
    from softcal.station.simulated.text_stream import CELL_COUNTS_PER_N, CELL_ZERO_COUNTS, SimulatedTextStream

    config = Hx711Config(around.wire.port, counts_per_N=CELL_COUNTS_PER_N, zero_counts=CELL_ZERO_COUNTS)

    def counts(now_s: float) -> tuple[int, ...]:
        count = round(config.zero_counts + config.counts_per_N * around.force_N(now_s))
        return (min(max(count, RAILS[0]), RAILS[1]),)

    drift = float(around.rng.normal(0, 1e-3))
    banner = b"softcal load cell 1\r\n"
    return Simulated(config, SimulatedTextStream(around.wire, counts, config.rate_Hz, drift, banner=banner))


_WIRES: tuple[WireKind, ...] = ("serial", "tcp", "ble")
DRIVERS = (Driver("hx711", "text lines `ms,counts` of an HX711", Hx711Config, _open, _simulate, _WIRES),)
