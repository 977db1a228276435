"""A load cell behind an HX711 whose Arduino prints raw 24-bit counts (Avia Semiconductor, HX711 data sheet)."""

from softcal.core.errors import BadReply
from softcal.station.drivers.text_stream import TextStream
from softcal.station.interfaces import Sample
from softcal.station.link import Link

RAILS = (-(2**23), 2**23 - 1)
"""Counts of a saturated converter: overload, or a bridge that is not connected."""


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
        """Throw away what lies in the buffers and begin to count."""
        self.stream.start()

    def poll(self) -> list[Sample]:
        """Return the samples that arrived since the last call, in N.

        Raises:
            BadReply: the converter is at its rail; the force is not known.
        """
        return [self._in_N(sample) for sample in self.stream.poll()]

    def close(self) -> None:
        """Give the port back."""
        self.stream.close()

    def _in_N(self, sample: Sample) -> Sample:
        count = sample.values[0]
        if not RAILS[0] < count < RAILS[1]:
            raise BadReply(
                f"{self.name}: converter saturated at {count:.0f} counts; the cell is overloaded or its bridge is not "
                "connected, check cable and load, then zero it"
            )
        return Sample(sample.host_s, sample.device_s, ((count - self.zero_counts) / self.counts_per_N,))
