"""Boards behind Bluetooth: the text-stream drivers pass their kit over the air, and what fails is one sentence."""

import asyncio
import inspect
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from softcal.core.errors import DeviceError, NoReply
from softcal.station.bench.catalogue import driver_of
from softcal.station.clock import HostClock
from softcal.station.testing import DriverRig, checks
from softcal.station.wire.bluetooth import NOTIFY_UUID, WRITE_UUID, BleTransport
from softcal.station.wire.link import Link
from softcal.station.wire.transport import wire_of

ADDRESS = "ble://AA:BB:CC:DD:EE:FF"


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


@pytest.fixture
def bleak(monkeypatch):
    monkeypatch.setitem(sys.modules, "bleak", SimulatedBleak)


def over_the_air(role, kind):
    return replace(driver_of(role, kind), wires=("ble",), is_threaded=True)


DRIVERS = [over_the_air("readout", "arduino"), over_the_air("cell", "hx711")]


@pytest.mark.long
@pytest.mark.parametrize("check", [check for driver in DRIVERS for check in checks(driver)], ids=str)
def test_a_driver_over_the_air(bleak, check):
    check()


def test_a_bluetooth_port_is_written_as_an_address():
    assert wire_of(ADDRESS) == "ble"
    assert "ble" in driver_of("readout", "arduino").wires


def test_without_bleak_the_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "bleak", None)
    with pytest.raises(NoReply, match=r"AA:BB:CC:DD:EE:FF.*pip install 'softcal\[ble\]'"):
        Link(ADDRESS, HostClock(), name="load cell")


def test_a_board_that_is_not_there_is_one_sentence_and_leaves_no_thread(bleak):
    with pytest.raises(NoReply, match="ble://127.0.0.1:1") as caught:
        Link("ble://127.0.0.1:1", HostClock(), name="load cell")
    assert "\n" not in str(caught.value)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("Bluetooth")]


def test_what_is_written_arrives_whole_and_in_order(bleak):
    rig = DriverRig(DRIVERS[0])
    # Nobody else reads what the host writes. Once the rig runs, its thread may be in the middle of reading.
    rig.simulated.far_end.receive = lambda now_s: None
    with rig:
        board = BleTransport(rig.wire.port.removeprefix("ble://"))
        received, end_s = b"", rig.clock.now_s() + 5.0
        board.write(bytes(range(100)))
        while len(received) < 100 and rig.clock.now_s() < end_s:
            rig.clock.sleep_s(0.01)
            received += rig.wire.receive()
        board.close()
    assert received == bytes(range(100))


def test_a_board_that_goes_out_of_reach_ends_the_readings(bleak):
    with DriverRig(DRIVERS[0]) as rig:
        reader = rig.reader()
        rig.wire.unplug()
        assert isinstance(rig.fault_within(1.0, reader.poll)[1], DeviceError)


def test_softcal_calls_bleak_as_bleak_is():
    bleak = pytest.importorskip("bleak")
    for name in ("__init__", "connect", "start_notify", "write_gatt_char", "disconnect"):
        simulated_parameters = inspect.signature(getattr(SimulatedBleak.BleakClient, name)).parameters
        real = inspect.signature(getattr(bleak.BleakClient, name)).parameters
        assert [key for key in simulated_parameters if key not in real] == [], name
    from bleak.uuids import uuidstr_to_str

    assert (uuidstr_to_str(NOTIFY_UUID), uuidstr_to_str(WRITE_UUID)) == ("Nordic UART TX", "Nordic UART RX")


def test_a_machine_without_bluetooth_says_so_in_one_sentence():
    pytest.importorskip("bleak")
    with pytest.raises(NoReply, match="AA:BB:CC:DD:EE:FF") as caught:
        Link(ADDRESS, HostClock(), name="load cell")
    assert "\n" not in str(caught.value)
