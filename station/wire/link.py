"""A line to a device: write, read whole lines and when they came, whatever wire is below."""

import os
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from serial.tools import list_ports

from softcal.core.errors import NoReply, reason_of
from softcal.core.messages.reason import Reason, reason
from softcal.station.device_names import device_label
from softcal.station.interfaces import Clock
from softcal.station.wire.transport import BLE, SerialTransport, TcpTransport, Transport, VisaTransport, wire_of

POLL_S = 0.002
"""How long one wait for bytes lasts; bounds how late an answer is seen."""

PSEUDO_TERMINALS = "/dev/pts/"

MAX_LINE_BYTES = 4096
"""More bytes than this without a line end is not a text device."""


class Line(NamedTuple):
    """One line without its end, and the host time of its last byte."""

    text: bytes
    host_s: float


class Link:
    """One open port.

    Args:
        port: a serial port (/dev/ttyACM0, COM5), a socket (tcp://192.168.0.7:5025), a VISA resource or a Bluetooth
            board (ble://AA:BB:CC:DD:EE:FF).
        baud_rate: of a serial port, symbols per second, 8N1.
        name: how messages call the device.

    Raises:
        NoReply: the port does not exist, may not be opened, or belongs to another process.
    """

    def __init__(self, port: str, clock: Clock, baud_rate: int = 115200, name: str = "") -> None:
        self.port, self.clock = port, clock
        self._label = device_label(name, port)
        self._rest = b""
        self._lines: deque[Line] = deque()
        if is_device(port) and (owner := _owner(port)):
            # A program that takes no lock would share the port: each of the two would get half of the bytes.
            raise NoReply(reason("rig.port", device=self._label, why=reason("port.taken", owner=owner)))
        try:
            self._transport = open_transport(port, baud_rate)
        except (OSError, ValueError) as error:
            raise NoReply(reason("rig.port", device=self._label, why=_find_open_failure(port, error))) from error

    def write(self, content: bytes) -> None:
        """Write bytes; they go out before this returns. `NoReply` where the port is gone."""
        try:
            self._transport.write(content)
        except OSError as error:
            raise self._close_lost_port() from error

    def read_lines(self) -> list[Line]:
        """Return the whole lines that came; `NoReply`: the port is gone, or there are no line ends."""
        self._receive()
        if not self._lines:
            return []
        lines = list(self._lines)
        self._lines.clear()
        return lines

    def next_line(self, within_s: float) -> Line:
        """Wait for the next line; `NoReply`: the port is gone, or nothing came in time."""
        end_s = self.clock.now_s() + within_s
        while True:
            self._receive()
            if self._lines:
                return self._lines.popleft()
            if self.clock.now_s() >= end_s:
                raise NoReply(reason("rig.no_answer", device=self._label, within_s=within_s))
            self.clock.sleep_s(POLL_S)

    def discard(self) -> None:
        self._receive()
        self._lines.clear()
        self._rest = b""

    def close(self) -> None:
        """Close the port; closing twice, or after the device is gone, has no effect."""
        self._transport.close()

    def _receive(self) -> None:
        try:
            content = self._transport.read()
        except OSError as error:
            raise self._close_lost_port() from error
        if not content:
            return
        *complete, self._rest = (self._rest + content).split(b"\n")
        now_s = self.clock.now_s()
        self._lines.extend(Line(text.strip(b"\r"), now_s) for text in complete)
        if len(self._rest) > MAX_LINE_BYTES:
            self._rest = b""
            raise NoReply(reason("rig.no_line_end", device=self._label, count=MAX_LINE_BYTES))

    def _close_lost_port(self) -> NoReply:
        # On Windows a port whose device was pulled stays dead until it is closed.
        self.close()
        return NoReply(reason("rig.gone", device=self._label))


@contextmanager
def link_for_driver(port: str, clock: Clock, baud_rate: int, name: str) -> Iterator[Link]:
    """Open a port for a driver under construction; close it again if another device answers."""
    link = Link(port, clock, baud_rate, name)
    try:
        yield link
    except BaseException:
        link.close()
        raise


def is_device(port: str) -> bool:
    """Return whether a port is hardware: a pty is held open by the program at its other end."""
    return wire_of(port) == "serial" and not os.path.realpath(port).startswith(PSEUDO_TERMINALS)


def available_ports() -> list[str]:
    """Return the serial ports of USB devices of this machine, in the system's order."""
    return [port.device for port in list_ports.comports() if port.vid is not None]


def _find_open_failure(port: str, error: Exception) -> Reason:
    match wire_of(port):
        case "tcp" | "ble":
            return reason("port.unreached", error=reason_of(error))
        case "visa":
            return reason("port.visa", error=reason_of(error))
    if not Path(port).exists() and os.name == "posix":
        return Reason("port.none")
    owner = _owner(port)
    if owner:
        return reason("port.taken", owner=owner)
    return reason("port.closed", error=reason_of(error))


def _owner(port: str) -> Reason | None:
    """Return the name of another process that has the port open, if the system shows it."""
    target = os.path.realpath(port)
    for descriptor in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.readlink(descriptor) == target and int(descriptor.parts[2]) != os.getpid():
                name = Path("/proc", descriptor.parts[2], "comm").read_text().strip()
                return reason("port.owner", name=name, process=descriptor.parts[2])
        except (OSError, ValueError):
            continue
    return None


def open_transport(port: str, baud_rate: int) -> Transport:
    """Open the transport of a port; raise `OSError` if it cannot be opened, `ValueError` for an invalid name."""
    match wire_of(port):
        case "tcp":
            return TcpTransport(port)
        case "visa":
            return VisaTransport(port)
        case "ble":
            from softcal.station.wire.bluetooth import BleTransport  # noqa: PLC0415

            return BleTransport(port.removeprefix(BLE))
        case _:
            return SerialTransport(port, baud_rate)
