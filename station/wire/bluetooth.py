"""A UART over Bluetooth Low Energy: the Nordic UART Service of most boards, through Bleak."""

import asyncio
import importlib
import threading
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

from softcal.station.wire.transport import ReceiveBuffer

NOTIFY_UUID = "6e400003-b5a3-f393-e0a9-e50e24dcca9e"
WRITE_UUID = "6e400002-b5a3-f393-e0a9-e50e24dcca9e"
"""Characteristics of the Nordic UART Service (Nordic Semiconductor, nRF Connect SDK, NUS): from and to the board."""

PACKET_BYTES = 20
"""What fits into one packet at the smallest MTU there is."""

CONNECT_S, ANSWER_S = 15.0, 1.0


class BleTransport(ReceiveBuffer):
    """Bytes to and from one Bluetooth board; a thread keeps the connection.

    Raises:
        OSError: Bleak is not installed, there is no Bluetooth, or the board does not answer.
    """

    def __init__(self, address: str) -> None:
        super().__init__()
        try:
            bleak: Any = importlib.import_module("bleak")
        except ImportError as error:
            raise OSError("a Bluetooth address needs Bleak: pip install 'softcal[ble]'") from error
        self._is_closed = False
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=f"Bluetooth {address}", daemon=True)
        self._thread.start()
        self._client = bleak.BleakClient(address, disconnected_callback=self._on_disconnect, timeout=CONNECT_S)
        try:
            self._wait(self._connect(), CONNECT_S + ANSWER_S)
        except Exception as error:  # Bleak raises its own kinds and those of the system below it.
            self.close()
            raise OSError(f"{type(error).__name__}: {error}".rstrip(": ")) from error

    def write(self, content: bytes) -> None:
        """Send bytes, in packets that every board takes."""
        self._raise_fault()
        try:
            self._wait(self._send(content), ANSWER_S)
        except Exception as error:  # As above.
            raise OSError(f"{type(error).__name__}: {error}".rstrip(": ")) from error

    def close(self) -> None:
        if self._is_closed:
            return
        self._is_closed = True
        self._on_disconnect(self._client)
        with suppress(Exception):  # It is gone already.
            self._wait(self._client.disconnect(), ANSWER_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(ANSWER_S)
        if not self._thread.is_alive():
            self._loop.close()

    async def _connect(self) -> None:
        await self._client.connect()
        await self._client.start_notify(NOTIFY_UUID, self._on_notify)

    async def _send(self, content: bytes) -> None:
        for begin in range(0, len(content), PACKET_BYTES):
            await self._client.write_gatt_char(WRITE_UUID, content[begin : begin + PACKET_BYTES], response=False)

    def _on_notify(self, characteristic: object, packet: bytearray) -> None:  # noqa: V107
        self._received.append(bytes(packet))

    def _on_disconnect(self, client: object) -> None:
        self._fault = ConnectionResetError("the board ended the connection")

    def _wait(self, work: Coroutine[Any, Any, None], within_s: float) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(within_s)
