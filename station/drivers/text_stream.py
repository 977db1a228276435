"""Driver of an Arduino-like device that prints `ms,value` by its own clock."""

from softcal.core.errors import BadReply, reason_of
from softcal.core.words.reason import reason
from softcal.station.clock import unwrap_ms
from softcal.station.interfaces import Sample
from softcal.station.named import named
from softcal.station.wire.frames.text_stream import parse
from softcal.station.wire.link import Link

BAD_IN_A_ROW = 10
"""So many unreadable lines one after the other are no longer noise."""

LONGEST_STEP_MS = 5000
"""The device clock may jump this far over lost lines; further is a damaged line or a restart."""


class TextStream:
    """Lines of one device as samples in whole counts.

    Repeated lines are dropped, lost ones leave a step in the device clock, unreadable ones are counted.

    Args:
        name: how messages call the device.
        link: its port.
        channels: numbers per line.
        rate_Hz: lines per second the device is meant to send.
    """

    def __init__(self, name: str, link: Link, channels: int, rate_Hz: float) -> None:
        self.name, self.channels, self.rate_Hz = name, channels, rate_Hz
        self._link = link
        self._last_ms: int | None = None
        self._is_synchronised = False
        self._bad_in_a_row = 0
        self.unreadable = 0

    def start(self) -> None:
        self._link.discard()
        self._last_ms, self._is_synchronised = None, False
        self.unreadable = self._bad_in_a_row = 0

    def poll(self) -> list[Sample]:
        """Return the samples that arrived since the last call, oldest first, in counts.

        Raises:
            NoReply: the port is gone.
            BadReply: nothing but noise, another number of channels, or the device started again.
        """
        samples = []
        for line in self._link.read_lines():
            if not self._is_synchronised:
                self._is_synchronised = True  # The first line after a start is cut more often than not.
                continue
            sample = self._sample(line.text, line.host_s)
            if sample:
                samples.append(sample)
        return samples

    def close(self) -> None:
        self._link.close()

    def _sample(self, text: bytes, host_s: float) -> Sample | None:
        try:
            line = parse(text)
        except BadReply as error:
            self._count_unreadable(error)
            return None
        if len(line.counts) != self.channels:
            self._count_unreadable(BadReply(reason("rig.channels", count=len(line.counts), expected=self.channels)))
            return None
        last_ms = self._last_ms
        device_ms = line.device_ms if last_ms is None else unwrap_ms(last_ms, line.device_ms)
        if last_ms is not None and device_ms == last_ms:
            return None
        if last_ms is not None and not 0 < device_ms - last_ms <= LONGEST_STEP_MS:
            raise BadReply(reason("rig.clock.back", device=named(self.name), before_ms=last_ms, after_ms=device_ms))
        self._last_ms, self._bad_in_a_row = device_ms, 0
        return Sample(host_s, device_ms / 1000.0, tuple(map(float, line.counts)))

    def _count_unreadable(self, error: BadReply) -> None:
        self.unreadable += 1
        self._bad_in_a_row += 1
        if self._bad_in_a_row >= BAD_IN_A_ROW:
            raise BadReply(
                reason("rig.unreadable", device=named(self.name), count=BAD_IN_A_ROW, why=reason_of(error))
            ) from error
