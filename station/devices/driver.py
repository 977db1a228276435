"""The declaration of a driver, by which station file, bench and simulated rig use it without its name."""

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar, get_type_hints

import numpy as np

from softcal.core.messages.reason import add_messages
from softcal.station.devices.config import DEVICES, DeviceConfig, Role
from softcal.station.interfaces import Clock, ForceReader, Readout, Stage
from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.wire import Wire
from softcal.station.wire.link import Link, link_for_driver
from softcal.station.wire.transport import WireKind

if TYPE_CHECKING:  # The simulator is an extra: a real rig does without it.
    from softcal.core.twin.parameters import ReadoutMetadata

C = TypeVar("C", bound=DeviceConfig)
D = TypeVar("D", bound=Stage | ForceReader | Readout)


@dataclass(frozen=True)
class Opening:
    """The arguments with which a driver opens its device.

    Args:
        stage: the station's stage where it is open already, for a cell or readout behind the same port.
    """

    clock: Clock
    stage: Stage | None = None


@dataclass(frozen=True)
class Surroundings:
    """The arguments with which a driver builds its simulated device.

    Args:
        wire: the device's end of its line; the host opens its `port`.
        axis: the drive of the simulated stage, its position counts in the pressing direction, mm.
        force_N: (simulated time in s) -> what presses on the load cell, N.
        outputs_V: (simulated time in s) -> output of each sensor, V.
        electronics: rate and range of the sensor's readout.
        stage_port: of the stage, for a device behind it.
    """

    wire: Wire
    axis: Axis
    force_N: Callable[[float], float]
    outputs_V: Callable[[float], tuple[float, ...]]
    electronics: "ReadoutMetadata"
    rng: np.random.Generator
    stage_port: str = ""


@dataclass(frozen=True)
class Simulated(Generic[C]):
    """A simulated device, and the section of the station file that opens it.

    Args:
        config: with `port` as the host opens it.
        far_end: the device at the other end of the wire; None if another device answers for it.
        reading_per_V: what a readout of another unit than V shows for 1 V of output.
    """

    config: C
    far_end: FarEnd | None
    reading_per_V: float = 1.0


@dataclass(frozen=True)
class Driver(Generic[C, D]):
    """Declaration of one kind of device.

    Args:
        config: a frozen dataclass of its keys, derived from `StageConfig`, `ForceConfig` or `ReadoutConfig`; it checks
            its values by raising `InputError`.
        open: opens the device or raises `DeviceError`, with everything it opened given back.
        simulate: makes the device for the simulated station and for the test kit.
        wires: connections that `port` may name, first the connection of the simulated device.
        is_threaded: whether it reads in a separate thread; simulated time then passes in real time at most.
        messages: its messages in English: code → sentence with values in braces, for `reason(code, **values)`.
    """

    kind: str
    what: str
    config: type[C]
    open: Callable[[C, Opening], D]
    simulate: Callable[[Surroundings], Simulated[C]]
    wires: tuple[WireKind, ...] = ("serial", "tcp")
    is_threaded: bool = False
    messages: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (is_dataclass(self.config) and issubclass(self.config, tuple(DEVICES.values()))):
            bases = ", ".join(base.__name__ for base in DEVICES.values())
            raise ValueError(f"driver {self.kind!r}: config must be a frozen dataclass derived from one of {bases}")
        if not self.wires:
            raise ValueError(f"driver {self.kind!r}: wires is empty; say what its port may name")
        add_messages(self.messages)

    @property
    def role(self) -> Role:
        return self.config.role

    @property
    def keys(self) -> dict[str, object]:
        """Keys in the station file with their defaults; None for a required key."""
        return {f.name: None if f.default is MISSING else f.default for f in fields(self.config)}

    @property
    def described_keys(self) -> list[tuple[str, str, str, str]]:
        """Keys in the station file as (name, type, default, unit), with "needed" for a required key."""
        types = get_type_hints(self.config)
        names = {float: "number", int: "whole number", str: "text", bool: "true/false"}
        defaults = {f.name: "needed" if f.default is MISSING else json.dumps(f.default) for f in fields(self.config)}
        return [(key, names.get(types[key], str(types[key])), value, unit_of(key)) for key, value in defaults.items()]


def make_opener(name: str, make: Callable[[Link, Any], D]) -> Callable[[Any, Opening], D]:
    """Return what opens a device on a port; the port is given back when another device is there."""

    def open_device(config: Any, opening: Opening) -> D:
        with link_for_driver(config.port, opening.clock, config.baud_rate, name) as link:
            return make(link, config)

    return open_device


UNITS = {
    "_per_N": "1/N", "_N_mm": "N/mm", "_mm_s2": "mm/s²", "_mm_s": "mm/s", "_mm": "mm", "_N": "N", "_Hz": "Hz",
    "_ohm": "ohm", "_V": "V", "_s": "s", "baud_rate": "baud", "_bits": "bit", "_counts": "counts",
}  # fmt: skip
"""Units by how a key ends, the longest first."""


def unit_of(key: str) -> str:
    """Return the unit a key of the station file carries in its name, "" for none."""
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


AnyDriver: TypeAlias = Driver[Any, Any]
