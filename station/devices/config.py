"""Configuration of a station from a TOML file: ports, dialects, safety bounds; nothing that belongs to one run."""

import math
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, field, fields
from difflib import get_close_matches
from itertools import combinations
from typing import Any, ClassVar, Literal, TypeAlias, TypeVar, get_type_hints

from softcal.core.errors import InputError
from softcal.core.messages.reason import reason

Role: TypeAlias = Literal["stage", "cell", "readout"]


MAX_LIMIT_SHARE = 0.8
"""A force limit above this share of the load cell's capacity leaves no room to stop in."""

UNKNOWN_S, LATEST_S = -1.0, 0.5
"""A latency that is not stated, and the largest that is reckoned with."""


@dataclass(frozen=True)
class DeviceConfig:
    """Keys of a device's section in the station file; a driver adds keys in a derived class.

    Args:
        port: a serial port, tcp://host:port or a VISA resource.
        kind: kind of its driver (`softcal station drivers` lists the kinds).
    """

    port: str
    kind: str = ""

    role: ClassVar[Role]
    shares_port: ClassVar[bool] = False
    """Whether another device of the same kind may stand behind the same port."""


@dataclass(frozen=True)
class StageConfig(DeviceConfig):
    """The stage."""

    kind: str = "grbl"

    role = "stage"


@dataclass(frozen=True)
class ForceConfig(DeviceConfig):
    """The load cell.

    Args:
        serial: of the cell, as on its certificate.
        capacity_N: rated load.
        rate_Hz: readings per second.
        latency_s: delay of its readings against the stage; −1: unknown, the stage then approaches very slowly
            and every run reports the measured latency.
    """

    kind: str = "hx711"
    serial: str = ""
    capacity_N: float = 20.0
    rate_Hz: float = 80.0
    latency_s: float = -1.0

    role = "cell"

    @property
    def is_latency_declared(self) -> bool:
        return self.latency_s != UNKNOWN_S


@dataclass(frozen=True)
class ReadoutConfig(DeviceConfig):
    """The sensor's electronics.

    Args:
        rate_Hz: readings per second.
        channels: sensors read at once.
    """

    kind: str = "arduino"
    rate_Hz: float = 50.0
    channels: int = 1

    role = "readout"


@dataclass(frozen=True)
class SafetyConfig:
    """Limits at which the rig is stopped.

    Args:
        force_N: more than this stops the stage.
        deepest_mm: stage position that is never exceeded, from the homing switch.
        speed_mm_s: fastest move that is allowed.
        silence_s: a device that says nothing for so long stops the run.
        zero_N: largest reading of the unloaded load cell before a run.
        zero_return_N: largest change of that reading over a run.
        stiffest_N_mm: stiffness of the stiffest possible object; before contact the stage moves so slowly that a stop
            on such a thing ends below 0.9 of the load cell's capacity.
        without_cell: true where no [force] is there and a person answers for it that the stage can hurt nothing.
    """

    force_N: float = 12.0
    deepest_mm: float = 12.0
    speed_mm_s: float = 10.0
    silence_s: float = 0.25
    zero_N: float = 1.0
    zero_return_N: float = 0.2
    stiffest_N_mm: float = 1000.0
    without_cell: bool = False


@dataclass(frozen=True)
class FixtureConfig:
    """Geometry of the fixture and parameters of the search for contact.

    Args:
        approach_mm: stage position that is free of any unit; reached at full speed.
        search_mm_s: speed of the search for contact below it.
        contact_N: change of force that is contact.
        touch_N: force at which the search ends; the contact is where the force began to rise towards it.
        contact_output: change of output that is contact, where no load cell reads.
        clearance_mm: a profile starts this far above the contact; it is position 0 of every recording.
    """

    approach_mm: float = 4.0
    search_mm_s: float = 0.5
    contact_N: float = 0.08
    touch_N: float = 0.3
    contact_output: float = 0.03
    clearance_mm: float = 0.3


@dataclass(frozen=True)
class StationConfig:
    """Configuration of one station, as in its TOML file.

    Raises:
        InputError: two devices that cannot share a port, or a number outside its physical range.
    """

    stage: StageConfig
    readout: ReadoutConfig
    force: ForceConfig | None = None
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    fixture: FixtureConfig = field(default_factory=FixtureConfig)
    name: str = "station"

    def __post_init__(self) -> None:
        devices = {"stage": self.stage, "readout": self.readout} | ({"force": self.force} if self.force else {})
        for (name, device), (other, other_device) in combinations(devices.items(), 2):
            may_share = device.shares_port and other_device.shares_port and device.kind == other_device.kind
            if device.port and device.port == other_device.port and not may_share:
                about = {"port": repr(device.port), "kind": repr(device.kind), "kind2": repr(other_device.kind)}
                raise InputError(reason("station_file.same_port", name=name, other=other, **about))
        if self.force is not None:
            check_within("safety.force_N", self.safety.force_N, 0.0, MAX_LIMIT_SHARE * self.force.capacity_N)
            check_within("fixture.touch_N", self.fixture.touch_N, 0.0, self.safety.force_N)
            if self.force.is_latency_declared:
                check_within("force.latency_s", self.force.latency_s, 0.0, LATEST_S)
        check_within("safety.stiffest_N_mm", self.safety.stiffest_N_mm, 0.1, 1e5)
        check_within("safety.silence_s", self.safety.silence_s, 0.15, 1.0)
        check_within("fixture.approach_mm", self.fixture.approach_mm, 0.0, self.safety.deepest_mm)
        check_within("fixture.search_mm_s", self.fixture.search_mm_s, 0.01, self.safety.speed_mm_s)


_T = TypeVar("_T")
_KINDS: dict[Any, str] = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}
DEVICES: dict[str, type[DeviceConfig]] = {"stage": StageConfig, "force": ForceConfig, "readout": ReadoutConfig}
"""Sections of the station file that are a device's."""


def fill_section(name: str, kind: type[_T], table: dict[str, Any]) -> _T:
    """Return the values of one section, its keys as TOML gives them.

    Raises:
        InputError: an unknown key, with the valid keys; a missing key; a value of the wrong type.
    """
    fields_by_key = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    types = get_type_hints(kind)
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in fields_by_key:
            close = get_close_matches(key, fields_by_key, 1)
            about = {"known": ", ".join(fields_by_key), "similar": f"; did you mean {close[0]}?" if close else ""}
            raise InputError(reason("station_file.unknown_key", section=name, key=repr(key), **about))
        kind_of, is_number = types[key], isinstance(value, int | float) and not isinstance(value, bool)
        if kind_of is float and is_number and math.isfinite(value):
            values[key] = float(value)
        elif kind_of is not float and type(value) is kind_of:
            values[key] = value
        else:
            expected = _KINDS.get(kind_of, str(kind_of))
            about = {"name": f"{name}.{key}", "value": repr(value), "expected": expected}
            raise InputError(reason("station_file.wrong_type", **about))
    for key, field_of_key in fields_by_key.items():
        if key not in values and field_of_key.default is MISSING and field_of_key.default_factory is MISSING:
            raise InputError(reason("station_file.no_key", section=name, key=key))
    return kind(**values)


def check_within(name: str, value: float, low: float, high: float) -> None:
    """Raise `InputError` where the value of a key is outside of [low, high]."""
    if not low <= value <= high:
        raise InputError(reason("station_file.outside", name=name, value=value, low=low, high=high))


def check_positive(name: str, value: float) -> None:
    """Raise `InputError` where the value of a key is not above 0."""
    if not value > 0:
        raise InputError(reason("station_file.positive", name=name, value=value))


def check_choice(name: str, value: str | float, choices: Iterable[str | float]) -> None:
    """Raise `InputError` if the value of a key is not among the allowed values."""
    choices = tuple(choices)
    if value not in choices:
        value_text = repr(value) if isinstance(value, str) else f"{value:g}"
        choices_text = ", ".join(choice if isinstance(choice, str) else f"{choice:g}" for choice in choices)
        raise InputError(reason("station_file.known", name=name, value=value_text, known=choices_text))
