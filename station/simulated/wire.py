"""The far end of one line: bytes that arrive late and in bursts, and the faults a wire can have."""

from collections import deque

import numpy as np

from softcal.station.simulated.medium import Medium, serial_line

BYTE_S = 10 / 115200
"""Time of one byte at 115200 8N1."""


class Wire:
    """The device's side of a line.

    Faults are switches: `is_silent` (nothing leaves), `unplug()`, the delays below, and shares of lines: `garbage`
    comes as noise, `torn` loses its second half with the line end, `flipped` has one wrong bit, `swapped` comes after
    the next one, `repeat` comes twice, `loss` never.

    Args:
        delay_s: least time from device to host.
        jitter_s: mean of a random delay on top.
        stall_s: now and then the host gets nothing for this long and then all at once.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        delay_s: float = 0.001,
        jitter_s: float = 0.002,
        stall_s: float = 0.1,
        medium: Medium | None = None,
    ) -> None:
        self._rng, self.delay_s, self.jitter_s, self.stall_s = rng, delay_s, jitter_s, stall_s
        self._medium = medium or serial_line()
        self.port = self._medium.port
        self._outbox: deque[tuple[float, bytes]] = deque()
        self._open_at_s = 0.0
        self.is_plugged = True
        self.is_silent = False
        self.garbage = self.repeat = self.loss = self.torn = self.flipped = self.swapped = 0.0
        self._held_back: list[bytes] = []

    def receive(self) -> bytes:
        return self._medium.read() if self.is_plugged else b""

    def send(self, content: bytes, now_s: float) -> None:
        """Hand bytes to the line; the host sees them after the delays of the line, in order."""
        if self.is_silent or not self.is_plugged:
            return
        for copy in self._with_faults(content):
            arrival_s = now_s + self.delay_s + len(copy) * BYTE_S + self._rng.exponential(self.jitter_s)
            if self.stall_s and self._rng.random() < 0.005:
                self._open_at_s = now_s + self._rng.uniform(0.2, 1.0) * self.stall_s
            arrival_s = max(arrival_s, self._open_at_s, self._outbox[-1][0] if self._outbox else 0.0)
            self._outbox.append((arrival_s, copy))

    def next_arrival_s(self) -> float:
        """Return when the next bytes reach the host; infinity when none are on the way."""
        return self._outbox[0][0] if self._outbox else float("inf")

    def deliver(self, now_s: float) -> None:
        while self._outbox and self._outbox[0][0] <= now_s:
            content = self._outbox.popleft()[1]
            if self.is_plugged:
                self._medium.write(content)

    def unplug(self) -> None:
        """Pull the cable: the host's port is dead for good."""
        if self.is_plugged:
            self.is_plugged = False
            self._outbox.clear()
            self._medium.hang_up()

    close = unplug

    def _with_faults(self, content: bytes) -> list[bytes]:
        if self._falls(self.loss):
            return []
        if self._falls(self.garbage):
            return [self._rng.integers(0, 256, len(content), dtype=np.uint8).tobytes()]
        if self._falls(self.torn):
            return [content[: len(content) // 2]]
        if self._falls(self.flipped):
            wrong = bytearray(content)
            wrong[int(self._rng.integers(len(content)))] ^= 1 << int(self._rng.integers(7))
            return [bytes(wrong)]
        if not self._held_back and self._falls(self.swapped):
            self._held_back.append(content)
            return []
        before, self._held_back = self._held_back, []
        return [content, content] if self._falls(self.repeat) else [content, *before]

    def _falls(self, share: float) -> bool:
        return bool(share and self._rng.random() < share)
