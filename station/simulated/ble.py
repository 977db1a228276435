"""A board behind Bluetooth: packets as they come over the air, and what stands in the place of Bleak for them."""

import asyncio
from collections.abc import Callable
from typing import Any

from softcal.station.simulated.medium import SocketEnd
from softcal.station.transport import BLE


class BleEnd(SocketEnd):
    """The board's end; a host finds it by its `port` where `SimulatedBleak` stands in the place of Bleak."""

    def __init__(self) -> None:
        super().__init__()
        self.port = BLE + self.port.removeprefix("tcp://")


class SimulatedBleak:
    """What softcal uses of the module `bleak`, as of Bleak 1 to 3."""

    class BleakClient:
        """A connection to one board.

        Args:
            address_or_ble_device: of the board.
            disconnected_callback: called with this client when the board is gone.
            timeout: of connecting, s.
        """

        def __init__(
            self,
            address_or_ble_device: str,
            disconnected_callback: Callable[[Any], None] | None = None,
            *,
            timeout: float = 10.0,
        ) -> None:
            self._address, self._timeout = address_or_ble_device, timeout
            self._on_gone = disconnected_callback
            self._listening: asyncio.Task[None] | None = None

        async def connect(self) -> None:
            """Connect; an `OSError` where nothing is there."""
            host, _, port = self._address.rpartition(":")
            opening = asyncio.open_connection(host, int(port))
            self._reader, self._writer = await asyncio.wait_for(opening, self._timeout)

        async def start_notify(self, char_specifier: str, callback: Callable[[Any, bytearray], None]) -> None:
            """Hand over what comes, in packets."""
            self._listening = asyncio.get_running_loop().create_task(self._listen(callback))

        async def write_gatt_char(self, char_specifier: str, data: bytes, response: bool | None = None) -> None:
            """Send one packet."""
            self._writer.write(data)
            await self._writer.drain()

        async def disconnect(self) -> None:
            """End the connection."""
            if self._listening is not None:
                self._listening.cancel()
            self._writer.close()

        async def _listen(self, callback: Callable[[Any, bytearray], None]) -> None:
            try:
                while packet := await self._reader.read(20):  # Lines are cut wherever a packet ends.
                    callback(None, bytearray(packet))
            except OSError:
                pass
            if self._on_gone is not None:
                self._on_gone(self)
