"""What a simulated line runs over, a pseudo terminal, a TCP socket or Bluetooth: the host opens it as a device."""

import os
import socket
from contextlib import suppress
from typing import TypeAlias

from softcal.station.wire.transport import BLE


class PtyEnd:
    """A serial line: a pseudo terminal (Linux and macOS). What the host does not read is lost, as on a real port."""

    def __init__(self) -> None:
        import pty  # Not on Windows.
        import tty

        self._master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(slave)
        # Kept open until the host opens it: a pty without a slave reports an error to its master.
        self._slave = slave

    def read(self) -> bytes:
        content = b""
        try:
            # One read may give less than was written; what comes a step later would be another simulation.
            while True:
                content += os.read(self._master, 65536)
        except BlockingIOError:
            return content

    def write(self, content: bytes) -> None:
        with suppress(BlockingIOError):
            os.write(self._master, content)

    def hang_up(self) -> None:
        os.close(self._slave)
        os.close(self._master)


class SocketEnd:
    """An instrument on the network: a TCP server that talks to one host at a time."""

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
    """Return what stands for a serial line: a socket where there are no pseudo terminals."""
    return PtyEnd() if os.name == "posix" else SocketEnd()


class BleEnd(SocketEnd):
    """A board behind Bluetooth, whose packets come over the air; a host finds it by its `port`."""

    def __init__(self) -> None:
        super().__init__()
        self.port = BLE + self.port.removeprefix("tcp://")
