"""What belongs to one station and to no run: ports, dialects, capacities, safety bounds, from one TOML file."""

import inspect
import math
import tomllib
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from softcal.core.errors import InputError

STAGE_KINDS = ("grbl", "zaber", "esm")
FORCE_KINDS = ("hx711", "mark10", "indicator", "loadstar", "esm")
READOUT_KINDS = ("arduino",)


LARGEST_LIMIT = 0.8
"""A force limit above this share of the load cell's capacity leaves no room to stop in."""

UNKNOWN_S, LATEST_S = -1.0, 0.5
"""A latency that is not stated, and the largest that is reckoned with."""


@dataclass(frozen=True)
class StageConfig:
    """The stage.

    Args:
        axis, is_reversed: GRBL: letter of the axis, and whether pressing is the negative machine direction.
        microstep_mm: Zaber: travel per microstep, from the data sheet.
        travel_mm, acceleration_mm_s2: ESM: what may be used below the upper limit switch, and how it accelerates.
    """

    port: str
    kind: str = "grbl"
    baud_rate: int = 115200
    axis: str = "Z"
    is_reversed: bool = True
    microstep_mm: float = 0.0001905
    travel_mm: float = 100.0
    acceleration_mm_s2: float = 200.0


@dataclass(frozen=True)
class ForceConfig:
    """The load cell.

    Args:
        serial: of the cell, as on its certificate.
        counts_per_N, zero_counts: HX711: from `softcal station calibrate-cell`.
        sign: Mark-10, indicators, Loadstar: 1 where compression reads positive, −1 otherwise.
        latency_s: how late its readings are against the stage; −1: not known, the stage then feels its way very slowly
            and every run says what it found.
    """

    port: str
    kind: str = "hx711"
    baud_rate: int = 115200
    counts_per_N: float = 10000.0
    zero_counts: float = 0.0
    sign: float = 1.0
    serial: str = ""
    capacity_N: float = 20.0
    rate_Hz: float = 80.0
    latency_s: float = -1.0


@dataclass(frozen=True)
class ReadoutConfig:
    """The sensor's electronics: full scale and resolution of the converter, series resistor of the divider."""

    port: str
    kind: str = "arduino"
    baud_rate: int = 115200
    vref_V: float = 5.0
    adc_bits: int = 10
    r_series_ohm: float = 10.0
    rate_Hz: float = 50.0
    channels: int = 1


@dataclass(frozen=True)
class SafetyConfig:
    """What stops the rig.

    Args:
        force_N: more than this stops the stage.
        deepest_mm: stage position that is never exceeded, from the homing switch.
        speed_mm_s: fastest move that is allowed.
        silence_s: a device that says nothing for so long stops the run.
        zero_N: largest reading of the unloaded load cell before a run.
        zero_return_N: largest change of that reading over a run.
        stiffest_N_mm: the stiffest thing the stage may meet; where nothing was felt yet it goes so slowly that a stop
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
    """Where a unit lies and how its surface is found.

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
    """One station as its TOML file describes it.

    Raises:
        InputError: an unknown dialect, or a number outside its physical range.
    """

    stage: StageConfig
    readout: ReadoutConfig
    force: ForceConfig | None = None
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    fixture: FixtureConfig = field(default_factory=FixtureConfig)
    name: str = "station"

    def __post_init__(self) -> None:
        _known("stage.kind", self.stage.kind, STAGE_KINDS)
        _known("stage.axis", self.stage.axis, ("X", "Y", "Z"))
        _known("readout.kind", self.readout.kind, READOUT_KINDS)
        if self.force is not None:
            _known("force.kind", self.force.kind, FORCE_KINDS)
            if self.force.kind == "esm" and (self.stage.kind != "esm" or self.force.port != self.stage.port):
                raise InputError("station file: force.kind esm is the gauge on an ESM stand: the same port as [stage]")
            if self.force.counts_per_N == 0:
                raise InputError("station file: force.counts_per_N is 0; run `softcal station calibrate-cell`")
            _within("safety.force_N", self.safety.force_N, 0.0, LARGEST_LIMIT * self.force.capacity_N)
            _within("fixture.touch_N", self.fixture.touch_N, 0.0, self.safety.force_N)
            if self.force.latency_s != UNKNOWN_S:
                _within("force.latency_s", self.force.latency_s, 0.0, LATEST_S)
        _within("safety.stiffest_N_mm", self.safety.stiffest_N_mm, 0.1, 1e5)
        _within("safety.silence_s", self.safety.silence_s, 0.15, 1.0)
        _within("fixture.approach_mm", self.fixture.approach_mm, 0.0, self.safety.deepest_mm)
        _within("fixture.search_mm_s", self.fixture.search_mm_s, 0.01, self.safety.speed_mm_s)


_T = TypeVar("_T")
_SECTIONS: dict[str, type[Any]] = {
    "stage": StageConfig,
    "force": ForceConfig,
    "readout": ReadoutConfig,
    "safety": SafetyConfig,
    "fixture": FixtureConfig,
}


def read_station_file(path: Path) -> StationConfig:
    """Return the station a TOML file describes.

    Raises:
        InputError: the file cannot be read, a key is unknown or missing, a value has the wrong type.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; write one with `softcal station check --write {path}`") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: is no TOML file: {error}") from error
    try:
        return station_from_table(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def station_from_table(content: dict[str, Any]) -> StationConfig:
    """Return the station that nested tables describe; unknown keys are errors that list the known ones."""
    unknown = set(content) - set(_SECTIONS) - {"name"}
    if unknown:
        raise InputError(f"unknown key {min(unknown)!r}; known are name, {', '.join(_SECTIONS)}")
    for needed in ("stage", "readout"):
        if needed not in content:
            raise InputError(f"section [{needed}] is missing")
    sections = {name: _section(name, _SECTIONS[name], content[name]) for name in _SECTIONS if name in content}
    config = StationConfig(name=str(content.get("name", "station")), **sections)
    if config.force is None and not config.safety.without_cell:
        raise InputError(
            "section [force] is missing, so nothing limits the force; add the load cell, or state without_cell = true "
            "in [safety] where the stage can hurt nothing"
        )
    return config


def station_toml(config: StationConfig) -> str:
    """Return the station file of a configuration, every key in it and what it means, to be read and edited."""
    lines = [f"name = {_toml(config.name)}"]
    for name, kind in _SECTIONS.items():
        section = getattr(config, name)
        if section is not None:
            lines += ["", f"[{name}]", *(f"# {line.strip()}" for line in _meanings(kind))]
            lines += [f"{f.name} = {_toml(getattr(section, f.name))}" for f in fields(section)]
    return "\n".join(lines) + "\n"


def _meanings(kind: type[Any]) -> list[str]:
    """What the keys of a section mean, from where they are documented."""
    first, _, rest = (inspect.getdoc(kind) or "").partition("Args:")
    return [line for line in (rest or first).splitlines() if line.strip()]


def _section(name: str, kind: type[_T], table: object) -> _T:
    if not isinstance(table, dict):
        raise InputError(f"{name} must be a section: write [{name}] and its keys below")
    known = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    values = {}
    for key, value in table.items():
        if key not in known:
            raise InputError(f"[{name}] unknown key {key!r}; known are {', '.join(known)}")
        values[key] = _typed(f"{name}.{key}", value, known[key].type)
    if "port" in known and "port" not in values:
        raise InputError(f"[{name}] port is missing")
    return kind(**values)


def _typed(name: str, value: object, kind: object) -> object:
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    if kind is not float and type(value) is kind:
        return value
    expected = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}.get(kind, str(kind))  # type: ignore[call-overload]
    raise InputError(f"{name} is {value!r}; {expected} was expected")


def _known(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(f"{name} is {value!r}; known are {', '.join(known)}")


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"{name} is {value:g}; a value in [{low:g}, {high:g}] was expected")


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)
