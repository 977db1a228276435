"""Checks of every driver: declaration, opening, refusal, closing."""

import socket
import threading
from collections.abc import Callable
from dataclasses import fields

from softcal.core.errors import DeviceError, InputError
from softcal.station.bench.catalogue import SECTIONS
from softcal.station.bench.station_file import meanings
from softcal.station.devices.config import fill_section
from softcal.station.testing.rig import DriverRig, require

OPENING_S = 60.0
"""Opening may reset a controller and wait for it, but not for ever."""


def _declares_its_keys(rig: DriverRig) -> None:
    config = rig.driver.config
    require(config.kind == rig.driver.kind, f"{config.__name__}.kind must default to {rig.driver.kind!r}")
    explained = " ".join(meanings(config)).replace(",", " ").replace(":", " ").split()
    silent = [f.name for f in fields(config) if f.name not in explained]
    require(not silent, f"the docstring of {config.__name__} must explain {', '.join(silent)} under Args:")
    try:
        fill_section(SECTIONS[rig.driver.role], config, {"port": rig.config.port, "no_such_key": 1})
    except InputError as error:
        missing = [f.name for f in fields(config) if f.name not in str(error)]
        require(not missing, f"an unknown key must list the known ones; {error} lacks {', '.join(missing)}")
        return
    require(False, "an unknown key in the station file was taken")


def _opens_again(rig: DriverRig) -> None:
    before = set(threading.enumerate())
    for _ in range(2):
        device = rig.open()
        device.close()
        device.close()
    leftover = [thread.name for thread in threading.enumerate() if thread not in before]
    require(not leftover, f"closed, it leaves threads running: {', '.join(leftover)}")


def _names_a_missing_port(rig: DriverRig) -> None:
    wires = rig.driver.wires
    if "serial" not in wires and "tcp" not in wires:
        return  # What a vendor's library calls a port is its own affair.
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    port = "/dev/softcal-no-such-port" if "serial" in wires else f"tcp://127.0.0.1:{free}"
    try:
        rig.open(port=port)
    except DeviceError as error:
        require(port in str(error), f"the message must name the port {port}: {error}")
        return
    require(False, f"it opened {port}, which is not there")


def _delivers_nothing(switch: str, value: object, fault: str) -> Callable[[DriverRig], None]:
    """A device on a faulty connection, which must be refused on opening, or deliver no reading."""

    def examine(rig: DriverRig) -> None:
        setattr(rig.wire, switch, value)
        began_s = rig.clock.now_s()
        try:
            device = rig.open()
        except DeviceError as error:
            require(str(error), f"{fault}: its error says nothing")
            took_s = rig.clock.now_s() - began_s
            require(took_s < OPENING_S, f"{fault}: opening took {took_s:.0f} s")
            return
        require(rig.driver.role != "stage", f"{fault}: a stage was opened that never answered")
        device.start()
        samples, _ = rig.fault_within(2.0, device.poll)
        require(not samples, f"{fault}: it delivered {len(samples)} samples, the first {samples[:1]}")

    return examine


def _survives_a_dead_port(rig: DriverRig) -> None:
    device = rig.open()
    rig.wire.unplug()
    device.close()
    device.close()


COMMON: dict[str, Callable[[DriverRig], None]] = {
    "its keys have one kind, an explanation each, and an unknown one lists them": _declares_its_keys,
    "it opens, closes twice, opens again, and leaves no thread": _opens_again,
    "a port that is not there is named": _names_a_missing_port,
    "a silent device is refused, or delivers nothing": _delivers_nothing(
        "is_silent", True, "a device that says nothing"
    ),
    "noise is refused, or delivers nothing": _delivers_nothing("garbage", 1.0, "a device that sends noise"),
    "it closes although its device is gone": _survives_a_dead_port,
}
"""Sentence -> what looks at it."""
