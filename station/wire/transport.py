"""Transport of a link: a serial port, a TCP socket, a VISA resource or a Bluetooth UART, chosen by the name."""

import importlib
import os
import re
import select
import socket
import sys
import threading
from collections import deque
from contextlib import suppress
from queue import Queue
from typing import Any, Literal, Protocol, TypeAlias

import serial

WireKind: TypeAlias = Literal["serial", "tcp", "visa", "ble", "library"]
"""`library`: the driver speaks through a vendor's library and gives `port` a meaning of its own."""

_VISA = re.compile(r"(TCPIP|USB|GPIB|VXI|PXI|ASRL)\d*::.+", re.IGNORECASE)
_TCP_ADDRESS = re.compile(r"tcp://(?P<host>\[[^\]]+\]|[^:/]+):(?P<port>\d{1,5})")

BLE = "ble://"

CONNECT_S = 3.0
VISA_ANSWER_S = 2.0
"""A question that is open for so long is given up; whoever asked has given up before."""


class Transport(Protocol):
    """Bytes to and from a device; no method waits for an answer."""

    def write(self, content: bytes) -> None:
        """Send bytes; raise `OSError` when the device is gone."""

    def read(self) -> bytes:
        """Return what has arrived, b"" for nothing; raise `OSError` when the device is gone."""

    def close(self) -> None:
        """Close the transport; closing twice has no effect."""


class ReceiveBuffer:
    """Bytes that a thread has received from a device, and the error that ended it."""

    def __init__(self) -> None:
        self._received: deque[bytes] = deque()
        self._fault: Exception | None = None

    def read(self) -> bytes:
        """Return all received bytes; without any, raise the error that ended the thread."""
        content = b""
        while self._received:
            content += self._received.popleft()
        if not content:
            self._raise_fault()
        return content

    def _raise_fault(self) -> None:
        if self._fault is not None:
            raise OSError(str(self._fault)) from self._fault


def wire_of(port: str) -> WireKind:
    """Return the connection that a port names: `tcp://host:5025`, `ble://AA:BB:…`, `USB0::…`, or a serial port."""
    if port.startswith("tcp://"):
        return "tcp"
    if port.startswith(BLE):
        return "ble"
    return "visa" if _VISA.fullmatch(port) else "serial"


class SerialTransport:
    """A serial port, 8N1, of which this process is the only owner."""

    def __init__(self, port: str, baud_rate: int) -> None:
        self._serial = serial.Serial(port, baud_rate, timeout=0, write_timeout=1.0, exclusive=True)
        self._poller: select.poll | None = None
        if sys.platform != "win32":
            self._poller = select.poll()
            self._poller.register(self._serial.fileno(), select.POLLIN)

    def write(self, content: bytes) -> None:
        self._serial.write(content)

    def read(self) -> bytes:
        if not self._serial.is_open:
            raise OSError("the port is closed")
        content = b""
        if self._poller is None:
            return bytes(self._serial.read(65536))
        # pyserial asks the system for the same, five times as slowly, and nearly always nothing has arrived. One read
        # may give less than has arrived (a tty hands over what its line discipline has taken so far).
        while self._poller.poll(0):
            try:
                piece = os.read(self._serial.fileno(), 65536)
            except BlockingIOError:
                break
            if not piece:
                raise OSError("the device is gone")
            content += piece
        return content

    def close(self) -> None:
        with suppress(serial.SerialException, OSError):
            self._serial.close()


class TcpTransport:
    """A TCP socket, `tcp://host:port`: an instrument, a serial server, a controller."""

    def __init__(self, address: str) -> None:
        match = _TCP_ADDRESS.fullmatch(address)
        if match is None or not 0 < int(match["port"]) < 65536:
            raise ValueError("an address as tcp://192.168.0.7:5025 was expected")
        self._socket = socket.create_connection((match["host"].strip("[]"), int(match["port"])), CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(1.0)

    def write(self, content: bytes) -> None:
        """Send bytes at once, without waiting for more to fill a packet."""
        self._socket.settimeout(1.0)
        self._socket.sendall(content)

    def read(self) -> bytes:
        content = b""
        self._socket.settimeout(0.0)
        try:
            while piece := self._socket.recv(65536):
                content += piece
        except (BlockingIOError, InterruptedError):
            return content
        if content:
            return content  # The end of the connection is told by the next call.
        raise ConnectionResetError("the device closed the connection")

    def close(self) -> None:
        self._socket.close()


class VisaTransport(ReceiveBuffer):
    """A VISA resource through PyVISA: USB-TMC, GPIB, LXI.

    Such a device answers queries, and a query blocks: a separate thread sends it. A message with a `?` is a
    question and takes one answer. What is written waits behind a question that is still open, so no stage may be moved
    over it.

    Args:
        resource: its VISA name; $PYVISA_LIBRARY chooses the VISA library, PyVISA-py where there is no other.

    Raises:
        OSError: PyVISA is not installed, or there is no such resource.
    """

    def __init__(self, resource: str) -> None:
        super().__init__()
        try:
            pyvisa: Any = importlib.import_module("pyvisa")
        except ImportError as error:
            raise OSError("a VISA address needs PyVISA: pip install 'softcal[visa]'") from error
        self._errors = (pyvisa.errors.Error, OSError, ValueError)
        self._timed_out: int = pyvisa.constants.StatusCode.error_timeout
        try:
            self._manager = pyvisa.ResourceManager()
            self._session = self._manager.open_resource(resource, timeout=int(1000 * VISA_ANSWER_S))
            self._session.read_termination = "\n"  # noqa: V101
        except self._errors as error:
            raise OSError(str(error)) from error
        self._to_send: Queue[bytes | None] = Queue()
        self._thread = threading.Thread(target=self._exchange, name=f"VISA {resource}", daemon=True)
        self._thread.start()

    def write(self, content: bytes) -> None:
        self._raise_fault()
        self._to_send.put(content)

    def close(self) -> None:
        """Close the session after an open query, so that a later query gets its own answer."""
        if not self._thread.is_alive() and self._session is None:
            return
        self._to_send.put(None)
        self._thread.join(VISA_ANSWER_S + 1.0)
        with suppress(*self._errors):  # It is gone already.
            self._session.close()
            self._manager.close()
        self._session = None

    def _exchange(self) -> None:
        # Its own name for the session: `close` gives it up while a slow device still keeps this thread waiting.
        session = self._session
        while (content := self._to_send.get()) is not None:
            try:
                session.write_raw(content)
                if b"?" in content:
                    self._received.append(session.read_raw().rstrip(b"\r\n") + b"\n")
            except self._errors as error:
                if getattr(error, "error_code", None) == self._timed_out and self._is_cleared(session):
                    continue  # Not answered: whoever asked sees that nothing comes.
                self._fault = error
                return

    def _is_cleared(self, session: Any) -> bool:
        """Whether the device took a clear: a late answer must not be taken for the next one."""
        try:
            session.clear()
        except (*self._errors, TypeError):  # pyvisa-py reads a socket that `close` has taken away meanwhile.
            return False
        return True
