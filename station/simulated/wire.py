"""The far end of one serial line: a pty, lines that arrive late and in bursts, and the faults a wire can have."""

import os
import pty
import tty
from collections import deque

import numpy as np

BYTE_S = 10 / 115200
"""Time of one byte at 115200 8N1."""


class Wire:
    """The device's side of a serial line.

    Faults are switches: `is_silent` (nothing leaves), `garbage` (this share of lines comes as noise), `repeat` and
    `loss` (share of lines sent twice or never), `unplug()`, and the delays below.

    Args:
        rng: draws delays and faults.
        delay_s: least time from device to host.
        jitter_s: mean of a random delay on top.
        stall_s: now and then the host gets nothing for this long and then all at once.
    """

    def __init__(
        self, rng: np.random.Generator, delay_s: float = 0.001, jitter_s: float = 0.002, stall_s: float = 0.1
    ) -> None:
        self._rng, self.delay_s, self.jitter_s, self.stall_s = rng, delay_s, jitter_s, stall_s
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(slave)
        # Kept open until the host opens it: a pty without a slave reports an error to its master.
        self._slave = slave
        self._outbox: deque[tuple[float, bytes]] = deque()
        self._open_at_s = 0.0
        self.is_plugged = True
        self.is_silent = False
        self.garbage = self.repeat = self.loss = 0.0

    def receive(self) -> bytes:
        """Return what the host has written since the last call."""
        content = b""
        if not self.is_plugged:
            return content
        try:
            # One read may give less than was written; what comes a step later would be another simulation.
            while True:
                content += os.read(self._master, 65536)
        except BlockingIOError:
            return content

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
        """Let everything that is due reach the host."""
        while self._outbox and self._outbox[0][0] <= now_s:
            content = self._outbox.popleft()[1]
            if self.is_plugged:
                self._write(content)

    def unplug(self) -> None:
        """Pull the cable: the host's port is dead for good."""
        if self.is_plugged:
            self.is_plugged = False
            self._outbox.clear()
            os.close(self._slave)
            os.close(self._master)

    close = unplug

    def _write(self, content: bytes) -> None:
        try:
            os.write(self._master, content)
        except BlockingIOError:
            pass  # A host that does not read loses bytes, as on a real port.

    def _with_faults(self, content: bytes) -> list[bytes]:
        if self.loss and self._rng.random() < self.loss:
            return []
        if self.garbage and self._rng.random() < self.garbage:
            return [self._rng.integers(0, 256, len(content), dtype=np.uint8).tobytes()]
        if self.repeat and self._rng.random() < self.repeat:
            return [content, content]
        return [content]
