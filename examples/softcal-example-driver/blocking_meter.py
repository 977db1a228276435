"""The same meter through a library of its maker that blocks until there is a reading."""

import socket
from dataclasses import dataclass

from lab_meter import MeterConfig, simulate

from softcal.core.errors import NoReply
from softcal.station.devices.driver import Driver, Opening
from softcal.station.wire.threaded_reader import Reading, ThreadedReader


class MakersLibrary:
    """Stands for the maker's library: `read_pF` blocks."""

    def __init__(self, address: str) -> None:
        host, port = address.removeprefix("tcp://").split(":")
        self._socket = socket.create_connection((host, int(port)), 3.0)
        self._socket.settimeout(None)
        self._lines = self._socket.makefile("rb")

    def read_pF(self) -> float:
        self._socket.sendall(b"C?\n")
        return float(self._lines.readline().removesuffix(b" pF\n"))

    def close(self) -> None:
        with self._socket, self._lines:
            self._socket.shutdown(socket.SHUT_RDWR)


@dataclass(frozen=True)
class BlockingConfig(MeterConfig):
    """Its section of the station file."""

    kind: str = "blocking_meter"


def open_meter(config: BlockingConfig, opening: Opening) -> ThreadedReader:
    try:
        library = MakersLibrary(config.port)
    except OSError as error:
        raise NoReply(f"lab meter ({config.port}): {error}; check its address and its power") from error

    def read() -> Reading:
        return Reading((library.read_pF(),))

    return ThreadedReader("lab meter", "pF", config.rate_Hz, opening.clock, read, library.close, limits=(-10.0, 2000.0))


DRIVER = Driver(
    "blocking_meter", "our meter, its maker's library", BlockingConfig, open_meter, simulate, ("tcp",), is_threaded=True
)
