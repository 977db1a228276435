"""Read and write the station file: each section with the keys of its driver."""

import inspect
import tomllib
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import tomlkit

from softcal.core.errors import InputError, reason_of
from softcal.core.messages.reason import Reason, reason
from softcal.station.bench.catalogue import driver_of
from softcal.station.devices.config import (
    DEVICES,
    DeviceConfig,
    FixtureConfig,
    SafetyConfig,
    StationConfig,
    fill_section,
)
from softcal.station.wire.transport import wire_of

_SECTIONS: dict[str, type[Any]] = {**DEVICES, "safety": SafetyConfig, "fixture": FixtureConfig}


def read_station_file(path: Path) -> StationConfig:
    """Return the station a TOML file describes.

    Raises:
        InputError: the file cannot be read, a key is unknown or missing, a value has the wrong type.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(reason("station_file.unreadable", path=str(path), error=reason_of(error))) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(reason("station_file.no_toml", path=str(path), error=reason_of(error))) from error
    try:
        return station_from_table(content)
    except InputError as error:
        raise InputError(reason("station_file.at", path=str(path), why=reason_of(error))) from error


def station_from_table(content: dict[str, Any]) -> StationConfig:
    """Return the station of nested tables; raise `InputError` for an unknown key, with the valid keys."""
    unknown = set(content) - set(_SECTIONS) - {"name"}
    if unknown:
        raise InputError(reason("station_file.unknown_top", key=repr(min(unknown)), known=", ".join(_SECTIONS)))
    for needed in ("stage", "readout"):
        if needed not in content:
            raise InputError(reason("station_file.no_section", section=needed))
    sections: dict[str, Any] = {}
    for name, kind in _SECTIONS.items():
        if name in content and not isinstance(content[name], dict):
            raise InputError(reason("station_file.no_table", name=name))
        if name in content:
            make = device_section if name in DEVICES else partial(fill_section, kind=kind)
            sections[name] = make(name, table=content[name])
    config = StationConfig(name=str(content.get("name", "station")), **sections)
    if config.force is None and not config.safety.without_cell:
        raise InputError(Reason("station_file.no_force"))
    return config


def station_toml(config: StationConfig, choices: str = "") -> str:
    """Return the station file of a configuration, with a comment for every key."""
    document = tomlkit.document()
    document["name"] = config.name
    for name in _SECTIONS:
        section = getattr(config, name)
        if isinstance(section, DeviceConfig):
            section = with_driver_keys(section)
        if section is None:
            continue
        table = tomlkit.table()
        for line in meanings(type(section)):
            table.add(tomlkit.comment(line.strip()))
        for f in fields(section):
            table[f.name] = getattr(section, f.name)
        if isinstance(section, DeviceConfig) and not section.port:
            table["port"].comment(f"CHOOSE one: {choices}")
        document[name] = table
    return tomlkit.dumps(document)


def meanings(kind: type[Any]) -> list[str]:
    """Return the documentation of the keys of a section: the common keys, then those of the driver."""
    lines = []
    for each in reversed(kind.__mro__):
        text = inspect.cleandoc(each.__doc__ or "") if is_dataclass(each) else ""
        _, _, keys = text.partition("Args:")
        lines += [line for line in keys.partition("Raises:")[0].splitlines() if line.strip()]
    return lines


def with_driver_keys(config: DeviceConfig) -> DeviceConfig:
    """Return the section of a device with all keys of its driver, at their defaults if not given."""
    kind: type[DeviceConfig] = driver_of(config.role, config.kind).config
    return config if isinstance(config, kind) else kind(**vars(config))


def device_section(name: str, table: dict[str, Any]) -> DeviceConfig:
    """Return the section of one device as the configuration class of its driver.

    Args:
        table: its keys; a kind that is not given is that of the section.

    Raises:
        InputError: an unknown kind or key, a value of the wrong type, or a port its driver cannot open.
    """
    common = DEVICES[name]
    kind = table.get("kind", common.kind)
    driver = driver_of(common.role, str(kind))
    config: DeviceConfig = fill_section(name, driver.config, {**table, "kind": kind})
    if "library" in driver.wires:
        return config
    if not config.port:
        raise InputError(reason("station_file.no_port", section=name))
    if (wire := wire_of(config.port)) not in driver.wires:
        about = {"port": repr(config.port), "kind": repr(kind), "wires": ", ".join(driver.wires)}
        raise InputError(reason("station_file.wrong_wire", section=name, wire=wire, **about))
    return config
