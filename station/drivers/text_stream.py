"""Streams of readings, line by line: the base class, and the format `ms,value` with the device's clock."""

from abc import ABC, abstractmethod

from softcal.core.errors import BadReply, reason_of
from softcal.core.messages.reason import reason
from softcal.station.clock import unwrap_ms
from softcal.station.device_names import device_label
from softcal.station.interfaces import Sample
from softcal.station.wire.frames.text_stream import parse
from softcal.station.wire.link import Line, Link
from softcal.station.wire.transport import WireKind

WIRES: tuple[WireKind, ...] = ("serial", "tcp", "ble")
"""What such a device may stand behind."""

MAX_BAD_LINES = 10
"""So many unreadable lines one after the other are no longer noise."""

LONGEST_STEP_MS = 5000
"""The device clock may jump this far over lost lines; further is a damaged line or a restart."""


class LineReader(ABC):
    """A device that sends a reading a line by itself; the first one after a start is often cut."""

    name: str
    unit: str

    def __init__(self, link: Link, rate_Hz: float) -> None:
        self._link, self.rate_Hz = link, rate_Hz
        self._is_synchronised, self._bad_in_a_row = False, 0

    def start(self) -> None:
        self._link.discard()
        self._is_synchronised, self._bad_in_a_row = False, 0

    def poll(self) -> list[Sample]:
        """Return the samples that came, oldest first; `BadReply` where that is nothing but noise."""
        samples = []
        for line in self._link.read_lines():
            if not self._is_synchronised:
                self._is_synchronised = True
            elif sample := self.sample_of(line):
                samples.append(sample)
                self._bad_in_a_row = 0
        return samples

    def close(self) -> None:
        self._link.close()

    @abstractmethod
    def sample_of(self, line: Line) -> Sample | None:
        """Return the sample of a line, or None for a line to skip; `BadReply` ends the stream."""

    def is_noise(self) -> bool:
        """Count an unreadable line, and return whether it may still be noise."""
        self._bad_in_a_row += 1
        return self._bad_in_a_row < MAX_BAD_LINES


class TextStream(LineReader):
    """Lines of one device as samples in whole counts, or in the unit that a derived reader makes of them.

    Repeated lines are dropped, lost ones leave a step in the device clock, unreadable ones are counted.
    """

    unit = "counts"

    def __init__(self, name: str, link: Link, channels: int, rate_Hz: float) -> None:
        super().__init__(link, rate_Hz)
        self.name, self.channels = name, channels
        self._last_ms: int | None = None
        self.unreadable = 0

    def start(self) -> None:
        super().start()
        self._last_ms, self.unreadable = None, 0

    def values_of(self, counts: tuple[int, ...]) -> tuple[float, ...]:
        """Return counts in the unit of the reader."""
        return tuple(map(float, counts))

    def sample_of(self, line: Line) -> Sample | None:
        try:
            stream_line = parse(line.text)
            if len(stream_line.counts) != self.channels:
                raise BadReply(reason("rig.channels", count=len(stream_line.counts), expected=self.channels))
        except BadReply as error:
            self.unreadable += 1
            if self.is_noise():
                return None
            cause = reason("rig.unreadable", device=device_label(self.name), count=MAX_BAD_LINES, why=reason_of(error))
            raise BadReply(cause) from error
        last_ms = self._last_ms
        device_ms = stream_line.device_ms if last_ms is None else unwrap_ms(last_ms, stream_line.device_ms)
        if device_ms == last_ms:
            return None
        if last_ms is not None and not 0 < device_ms - last_ms <= LONGEST_STEP_MS:
            raise BadReply(
                reason("rig.clock.back", device=device_label(self.name), before_ms=last_ms, after_ms=device_ms)
            )
        self._last_ms = device_ms
        return Sample(line.host_s, device_ms / 1000.0, self.values_of(stream_line.counts))
