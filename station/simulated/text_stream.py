"""Simulated Arduino: a readout or an amplifier that prints `ms,value` by its own clock."""

from collections.abc import Callable

from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.wire import Wire
from softcal.station.wire.frames.text_stream import StreamLine, format_line

CELL_COUNTS_PER_N, CELL_ZERO_COUNTS = 9870.0, 84_210.0
"""Of the simulated load cell behind its HX711."""


class SimulatedTextStream(FarEnd):
    """A device that samples by its own clock and prints every sample.

    Faults are switches: `is_frozen` (the last value for ever), `rate_factor` (0.5 = half rate), `has_checksum`,
    `device_ms` (its clock, as `millis()` shows it; near 2**32 it soon wraps), `restart()`, and everything the wire can
    do.

    Args:
        sample: (true time) -> counts per channel.
        drift: relative error of the crystal; +1e-3 gains a millisecond a second.
    """

    def __init__(
        self,
        wire: Wire,
        sample: Callable[[float], tuple[int, ...]],
        rate_Hz: float,
        drift: float = 0.0,
        banner: bytes = b"softcal readout 1\r\n",
    ) -> None:
        super().__init__(wire)
        self._sample = sample
        self.rate_Hz, self._drift, self._banner, self.has_checksum = rate_Hz, drift, banner, True
        self.rate_factor = 1.0
        self.is_frozen = False
        self.device_ms = 731.0
        self.due_s = 0.004
        self._last: tuple[int, ...] = ()
        self._is_first = True
        wire.send(banner, 0.0)

    def do_due(self) -> None:
        if not (self.is_frozen and self._last):
            self._last = self._sample(self.due_s)
        line = format_line(StreamLine(int(self.device_ms) % 2**32, self._last), self.has_checksum)
        # Whoever opens a port in mid-stream sees the end of a line first.
        self.wire.send(line[3:] if self._is_first else line, self.due_s)
        self._is_first = False
        period_s = 1.0 / (self.rate_Hz * self.rate_factor)
        self.device_ms += 1000 * period_s
        self.period_s = period_s / (1.0 + self._drift)
        super().do_due()

    def restart(self) -> None:
        """The supply drops for a moment: the firmware starts again."""
        self.device_ms = 12.0
        self.wire.send(self._banner, self.due_s)
