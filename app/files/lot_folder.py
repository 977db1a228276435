"""A lot folder: lot.toml, source/, units/, audit/ into core values. One unreadable unit never stops the others."""

import hashlib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import Any

import tomlkit

from softcal.app.files.atomic import write_text
from softcal.app.files.recording_file import CSV, PARQUET, naming, read_labelled, read_recording
from softcal.app.files.regular import read_regular
from softcal.core.errors import InputError
from softcal.core.lot import Lot, check_serial
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.budget import DAYS, NUMBERS, SIMULATED, Reference
from softcal.core.unit.line_spread import LineSpread

KNOWN_KEYS = {
    "": {"sample_rate_Hz", "source"},
    "lot": {"id", "sensor_model", "sample_rate_Hz", "source", "simulated"},
    "reference": {"quantity", "unit", "cell", "certificate", "laboratory", *DAYS, *NUMBERS},
    "output": {"unit", "sample_rate_Hz", "source"},
    "limit": {"rmse"},
    "line": {"load_spread", "day_spread"},
}
"""Keys of lot.toml by table. The two bare keys may also stand in [lot] or [output], where TOML puts what follows."""


@dataclass(frozen=True)
class LotFolder:
    """Where the recordings of a lot lie. Nothing but `lot.toml` is read before it is asked for.

    Args:
        root: the folder; nothing outside it is read as a recording of a unit.
        lot: the facts of `lot.toml`.
        source_path: the source's labelled recording.
        unit_paths: recording of each target unit by serial.
        audit_paths: labelled recordings that only score, by serial.
        remarks: what in the folder was not understood, in words.
        line: how differently the line presses units, where `lot.toml` states it.
        reference: what the source was compared with; None where `lot.toml` does not say.
    """

    root: Path
    lot: Lot
    source_path: Path
    unit_paths: Mapping[str, Path]
    audit_paths: Mapping[str, Path]
    remarks: tuple[str, ...] = ()
    line: LineSpread | None = None
    reference: Reference | None = None

    def read_source(self) -> LabelledRecording:
        """Read the source unit's labelled recording."""
        return self._labelled(self.source_path, self.lot.source)

    def read_unit(self, serial: str) -> OutputRecording:
        """Read a target unit's output; a reference column in its file is never looked at."""
        return read_recording(self.unit_paths[serial], serial, self.lot.sample_rate_Hz, self.lot.output_unit)

    def read_audit(self, serial: str) -> LabelledRecording | None:
        """Read a unit's audit recording, or None where it has none."""
        path = self.audit_paths.get(serial)
        return None if path is None else self._labelled(path, serial)

    def _labelled(self, path: Path, serial: str) -> LabelledRecording:
        units = self.lot.output_unit, self.lot.reference_unit
        return read_labelled(path, serial, self.lot.sample_rate_Hz, units)


def open_lot_folder(folder: Path) -> LotFolder:
    """Read `lot.toml` and list the recordings.

    Raises:
        InputError: no such folder, no or a wrong `lot.toml`, no source recording, or a serial given twice.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such lot folder; make one with `softcal import`")
    lot, line, reference, remarks = _read_lot_toml(folder / "lot.toml")
    sources = _recordings(folder / "source")
    if lot.source not in sources:
        seen = ", ".join(sources) or "nothing"
        raise InputError(f"{folder / 'source'}: no recording of the source unit {lot.source!r}; found {seen}")
    units, audits = _recordings(folder / "units"), _recordings(folder / "audit")
    strangers = sorted(set(audits) - set(units) - {lot.source})
    if strangers:
        remarks = (*remarks, f"audit/ holds {', '.join(strangers[:5])}, which units/ does not; not used")
    remarks = (*remarks, *_same_files(units, folder))
    return LotFolder(folder, lot, sources[lot.source], units, audits, remarks, line, reference)


def _same_files(units: Mapping[str, Path], root: Path) -> Iterator[str]:
    """Say which units have one and the same file: one of the serials is wrong, or a file was copied.

    Whatever is no file, or cannot be read, is told as that unit's result later.
    """
    by_size: dict[int, list[str]] = {}
    for serial, path in units.items():
        if path.is_file():
            by_size.setdefault(path.stat().st_size, []).append(serial)
    for alike in by_size.values():
        if len(alike) > 1:
            yield from _same_content({serial: units[serial] for serial in alike}, root)


def _same_content(units: Mapping[str, Path], root: Path) -> Iterator[str]:
    by_hash: dict[str, list[str]] = {}
    for serial, path in units.items():
        # What cannot be read is the result of its unit and of no other.
        with suppress(InputError):
            content = read_regular(path, root)
            by_hash.setdefault(hashlib.sha256(content).hexdigest(), []).append(serial)
    for serials in by_hash.values():
        if len(serials) > 1:
            yield same_recording(serials)


def same_recording(serials: Sequence[str]) -> str:
    """Return the remark on serials that have one and the same recording."""
    return f"units {', '.join(serials)} have one and the same recording; check which serial it belongs to"


def _recordings(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    if not folder.is_dir():
        return found
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix.lower() not in CSV | PARQUET:
            continue
        with naming(path):
            serial = check_serial(path.stem)
        if serial in found:
            raise InputError(f"{path}: serial {serial!r} is given twice, also by {found[serial].name}; keep one")
        found[serial] = path
    return found


def _read_lot_toml(path: Path) -> tuple[Lot, LineSpread | None, Reference | None, tuple[str, ...]]:
    if not path.is_file():
        raise InputError(f"{path}: there is no lot.toml; `softcal import` writes one")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    with naming(path):
        tables = {name: content.get(name, {}) for name in ("lot", "reference", "output", "limit", "line")}
        for name, table in tables.items():
            if not isinstance(table, dict):
                raise InputError(f"[{name}] must be a table")
        line, reference = _line(tables["line"]), _reference(tables)
        return _lot(content, tables), line, reference, tuple(_unknown_keys(path, content))


def _reference(tables: Mapping[str, Mapping[str, object]]) -> Reference | None:
    is_simulated = tables["lot"].get("simulated", False)
    if not isinstance(is_simulated, bool):
        raise InputError(f"[lot] simulated is {is_simulated!r}; true or false was expected")
    if is_simulated:
        return SIMULATED
    stated = {key: value for key, value in tables["reference"].items() if key not in ("quantity", "unit")}
    facts: dict[str, Any] = {}
    for key, value in stated.items():
        if key in DAYS:
            facts[key] = _day(value, f"[reference] {key}")
        elif key in NUMBERS:
            facts[key] = _number(value, f"[reference] {key}")
        elif key in KNOWN_KEYS["reference"]:
            facts[key] = _text(tables["reference"], key, f"[reference] {key}")
    return Reference(**facts) if facts else None


def _day(value: object, shown: str) -> date:
    if not isinstance(value, date) or isinstance(value, datetime):
        raise InputError(f"{shown} is {value!r}; a date such as 2026-01-31 was expected")
    return value


def _line(table: Mapping[str, object]) -> LineSpread | None:
    if not table:
        return None
    load, day = (_number(table.get(name, 0.0), f"[line] {name}") for name in ("load_spread", "day_spread"))
    return LineSpread(load, day)


def _lot(content: Mapping[str, object], tables: Mapping[str, Mapping[str, object]]) -> Lot:
    places = (content, tables["lot"], tables["output"])
    limit = tables["limit"].get("rmse")
    return Lot(
        id=_text(tables["lot"], "id", "[lot] id"),
        source=_text(_only(places, "source"), "source", "source"),
        sample_rate_Hz=_number(_only(places, "sample_rate_Hz").get("sample_rate_Hz"), "sample_rate_Hz"),
        sensor_model=str(tables["lot"].get("sensor_model", "")),
        reference_quantity=str(tables["reference"].get("quantity", "force")),
        reference_unit=str(tables["reference"].get("unit", "N")),
        output_unit=str(tables["output"].get("unit", "V")),
        limit_rmse=None if limit is None else _number(limit, "[limit] rmse"),
    )


def _only(places: tuple[Mapping[str, object], ...], key: str) -> Mapping[str, object]:
    holders = [place for place in places if key in place]
    if len({str(place[key]) for place in holders}) > 1:
        raise InputError(f"{key} is given more than once, with different values")
    if not holders:
        raise InputError(f"{key} is missing")
    return holders[0]


def _text(table: Mapping[str, object], key: str, shown: str) -> str:
    value = table.get(key)
    if not isinstance(value, str) or not value:
        raise InputError(f"{shown} is {value!r}; a text was expected")
    return value


def _number(value: object, shown: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{shown} is {value!r}; a number was expected")
    return float(value)


def _unknown_keys(path: Path, content: Mapping[str, object]) -> Iterator[str]:
    for key, value in content.items():
        if key in KNOWN_KEYS and isinstance(value, dict):
            unknown = sorted(set(value) - KNOWN_KEYS[key])
            if unknown:
                yield f"{path}: [{key}] {', '.join(unknown)} not used; known: {', '.join(sorted(KNOWN_KEYS[key]))}"
        elif key not in KNOWN_KEYS[""]:
            yield f"{path}: {key} not used; known: {', '.join(sorted(set(KNOWN_KEYS) - {''}))}, sample_rate_Hz, source"


def write_lot_toml(folder: Path, lot: Lot, reference: Reference | None = None) -> None:
    """Write `lot.toml` for a lot folder, with what its source was compared with."""
    document = tomlkit.document()
    document["sample_rate_Hz"] = lot.sample_rate_Hz
    document["source"] = lot.source
    simulated = {"simulated": True} if reference is not None and reference.is_simulated else {}
    document["lot"] = {"id": lot.id, "sensor_model": lot.sensor_model, **simulated}
    document["reference"] = {"quantity": lot.reference_quantity, "unit": lot.reference_unit, **_stated(reference)}
    document["output"] = {"unit": lot.output_unit}
    if lot.limit_rmse is not None:
        document["limit"] = {"rmse": lot.limit_rmse}
    write_text(folder / "lot.toml", tomlkit.dumps(document))


def _stated(reference: Reference | None) -> dict[str, object]:
    if reference is None or reference.is_simulated:
        return {}
    default = vars(Reference())
    return {name: value for name, value in vars(reference).items() if value != default[name]}
