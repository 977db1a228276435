"""Simulated end of a line: delays and bursts of bytes, and faults of a connection."""

import math
import os
import socket
from collections import deque
from typing import TypeAlias

import numpy as np

from softcal.station.wire.transport import BLE

BYTE_S = 10 / 115200
"""Time of one byte at 115200 8N1."""


class PtyEnd:
    """A serial line: a pseudo terminal (Linux and macOS). What the host does not read is lost, as on a real port."""

    def __init__(self) -> None:
        import pty  # Not on Windows.  # noqa: PLC0415
        import tty  # noqa: PLC0415

        self.descriptor, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self.descriptor, False)
        self.port = os.ttyname(slave)
        # Kept open until the host opens it: a pty without a slave reports an error to its master.
        self._slave = slave

    def read(self) -> bytes:
        content = b""
        try:
            # One read may give less than was written; what comes a step later would be another simulation.
            while True:
                content += os.read(self.descriptor, 65536)
        except BlockingIOError:
            return content

    def write(self, content: bytes) -> None:
        try:
            os.write(self.descriptor, content)
        except BlockingIOError:
            return

    def hang_up(self) -> None:
        os.close(self._slave)
        os.close(self.descriptor)


class SocketEnd:
    """An instrument on the network: a TCP server that talks to one host at a time."""

    descriptor: int | None = None
    """Both the server and its host may have something."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        self._host: socket.socket | None = None
        self.port = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"

    def read(self) -> bytes:
        content, host = b"", self._connected()
        if host is None:
            return content
        try:
            while piece := host.recv(65536):
                content += piece
        except BlockingIOError:
            return content
        except OSError:
            pass
        self._forget()
        return content

    def write(self, content: bytes) -> None:
        host = self._connected()
        if host is None:
            return
        try:
            host.send(content)
        except BlockingIOError:
            pass
        except OSError:
            self._forget()

    def hang_up(self) -> None:
        self._forget()
        self._server.close()

    def _connected(self) -> socket.socket | None:
        try:
            newest, _ = self._server.accept()
        except BlockingIOError:
            return self._host
        self._forget()
        newest.setblocking(False)
        newest.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._host = newest
        return newest

    def _forget(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None


Medium: TypeAlias = PtyEnd | SocketEnd
"""The device's end of a byte stream that the host opens by its `port`."""


def serial_line() -> Medium:
    """Return a serial line: a pty, or a socket without pseudo-terminals."""
    return PtyEnd() if os.name == "posix" else SocketEnd()


class BleEnd(SocketEnd):
    """A board with Bluetooth, which sends packets; the host connects to its `port`."""

    def __init__(self) -> None:
        super().__init__()
        self.port = BLE + self.port.removeprefix("tcp://")


class Wire:
    """The device's side of a line.

    Faults are switches: `is_silent` (nothing leaves), `unplug()`, the delays below, and shares of lines: `garbage`
    comes as noise, `torn` loses its second half with the line end, `flipped` has one wrong bit, `swapped` comes after
    the next one, `repeat` comes twice, `loss` never.

    `delay_s` is the least time from device to host, `jitter_s` the mean of a random delay on top. Now and then the host
    gets nothing for `stall_s` and then all at once.
    """

    def __init__(self, rng: np.random.Generator, medium: Medium | None = None) -> None:
        self._rng, self.delay_s, self.jitter_s, self.stall_s = rng, 0.001, 0.002, 0.1
        self._medium = medium or serial_line()
        self.port, self.descriptor = self._medium.port, self._medium.descriptor
        self._outbox: deque[tuple[float, bytes]] = deque()
        self.next_arrival_s = math.inf
        """When the next bytes reach the host; infinity when none are on the way."""
        self._open_at_s = 0.0
        self.is_plugged = True
        self.is_silent = False
        self.garbage = self.repeat = self.loss = self.torn = self.flipped = self.swapped = 0.0
        self._delayed: list[bytes] = []

    def receive(self) -> bytes:
        return self._medium.read() if self.is_plugged else b""

    def send(self, content: bytes, now_s: float) -> None:
        """Send bytes to the line; the host receives them in order, after the delays of the line."""
        if self.is_silent or not self.is_plugged:
            return
        for copy in self._with_faults(content):
            arrival_s = now_s + self.delay_s + len(copy) * BYTE_S + self._rng.exponential(self.jitter_s)
            if self.stall_s and self._rng.random() < 0.005:
                self._open_at_s = now_s + self._rng.uniform(0.2, 1.0) * self.stall_s
            arrival_s = max(arrival_s, self._open_at_s, self._outbox[-1][0] if self._outbox else 0.0)
            self._outbox.append((arrival_s, copy))
        self._note_next()

    def deliver(self, now_s: float) -> None:
        while self.next_arrival_s <= now_s:
            content = self._outbox.popleft()[1]
            self._note_next()
            if self.is_plugged:
                self._medium.write(content)

    def unplug(self) -> None:
        """Pull the cable: the host's port is dead for good."""
        if self.is_plugged:
            self.is_plugged = False
            self._outbox.clear()
            self._note_next()
            self._medium.hang_up()

    close = unplug

    def _note_next(self) -> None:
        self.next_arrival_s = self._outbox[0][0] if self._outbox else math.inf

    def _with_faults(self, content: bytes) -> list[bytes]:
        shares = self.loss, self.garbage, self.torn, self.flipped, self.swapped, self.repeat
        if not any(shares) and not self._delayed:
            return [content]
        if self._draw(self.loss):
            return []
        if self._draw(self.garbage):
            return [self._rng.integers(0, 256, len(content), dtype=np.uint8).tobytes()]
        if self._draw(self.torn):
            return [content[: len(content) // 2]]
        if self._draw(self.flipped):
            damaged = bytearray(content)
            damaged[int(self._rng.integers(len(content)))] ^= 1 << int(self._rng.integers(7))
            return [bytes(damaged)]
        if not self._delayed and self._draw(self.swapped):
            self._delayed.append(content)
            return []
        before, self._delayed = self._delayed, []
        return [content, content] if self._draw(self.repeat) else [content, *before]

    def _draw(self, share: float) -> bool:
        return bool(share and self._rng.random() < share)
