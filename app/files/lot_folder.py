"""A lot folder: lot.toml, source/, units/, audit/, golden/ into core values."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import get_type_hints

import tomlkit

from softcal.app.files.anchors import read_anchors
from softcal.app.files.atomic import write_text
from softcal.app.files.measured_at import parse_instant
from softcal.app.files.not_used import NotUsed
from softcal.app.files.recording_file import (
    PLAIN,
    ColumnNames,
    FileRecording,
    inspect_recording,
    naming,
    read_recording,
)
from softcal.app.files.regular import read_regular
from softcal.app.files.toml_file import read_toml, typed
from softcal.app.files.unused_parts import unused_of_lot
from softcal.app.tables.options import TableOptions
from softcal.app.tables.read import READERS, read_table
from softcal.core.errors import InputError
from softcal.core.lot import Lot, check_serial, row_name, serial_key
from softcal.core.maps.catalogue import check_family
from softcal.core.maps.interface import Anchors
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.budget import DAYS, NUMBERS, SIMULATED, Reference
from softcal.core.unit.line_spread import LineSpread
from softcal.core.words.reason import Reason, reason

STATED = {"cell", "certificate", "laboratory", *DAYS, *NUMBERS}
"""What lot.toml says of the instrument behind the reference."""

COLUMN_KEYS = ("output", "reference", "time", "stage")
"""Keys of [table] that name a column; the others state its layout."""

KNOWN_KEYS = {
    "": {"sample_rate_Hz", "source"},
    "lot": {"id", "sensor_model", "sample_rate_Hz", "source", "more_sources", "simulated"},
    "reference": {"quantity", "unit", *STATED},
    "output": {"unit", "sample_rate_Hz", "source"},
    "limit": {"rmse"},
    "line": {"load_spread", "day_spread"},
    "map": {"family"},
    "audit": set(),
    "table": {"delimiter", "decimal", "encoding", "header_row", "sheet", "time_format", "missing", *COLUMN_KEYS},
}
"""Keys of lot.toml by table; those of [audit] are serials. Two bare keys may stand where TOML puts what follows."""

ANCHOR_FILES = ("anchors.csv", "anchors.parquet")
"""Where a lot folder holds known loads of its units."""

FOLDER_OF = {"source": "source", "unit": "units", "audit": "audit"}
"""Kind of a recording → where it lies in a lot folder."""

GOLDEN = "golden"
"""Where the source's run in the units' sitting lies."""


@dataclass(frozen=True)
class LotFolder:
    """Where the recordings of a lot lie. Nothing but `lot.toml` is read before it is asked for.

    Args:
        root: the folder; nothing outside it is read as a recording of a unit.
        audit_paths: labelled recordings of target units; no map is fitted to them.
        line: how differently the line presses units, where `lot.toml` states it.
        reference: what the source was compared with; None where `lot.toml` does not say.
        golden_path, golden_serial: the source pressed again in the units' sitting, or one of the units under the load
            cell; None without.
        anchors_path: known loads of units (`serial, output, reference`); None without.
        names: columns and layout of the recordings, where `lot.toml` states them.
        family: of every unit's map, or `auto`; None where `lot.toml` states none.
        measured_at: when audits were measured, UTC, where `lot.toml` states it.
        problems: why recordings of `unit_paths` are not used, by their row: no serial, or one that is given twice.
    """

    root: Path
    lot: Lot
    source_path: Path
    unit_paths: Mapping[str, Path]
    audit_paths: Mapping[str, Path]
    remarks: tuple[str, ...] = ()
    not_used: tuple[NotUsed, ...] = ()
    line: LineSpread | None = None
    reference: Reference | None = None
    golden_path: Path | None = None
    golden_serial: str = ""
    anchors_path: Path | None = None
    more_source_paths: Mapping[str, Path] = field(default_factory=dict)
    problems: Mapping[str, Reason] = field(default_factory=dict)
    names: ColumnNames = PLAIN
    family: str | None = None
    measured_at: Mapping[str, datetime] = field(default_factory=dict)

    def read_anchors(self) -> Mapping[str, Anchors]:
        """Read the known loads of the lot's units by serial; empty where there are none.

        Raises:
            InputError: the table cannot be read, or names a unit that the lot does not have.
        """
        return {} if self.anchors_path is None else read_anchors(self.anchors_path, self.unit_paths)

    def read_source(self) -> LabelledRecording:
        return self._labelled(self.source_path, self.lot.source)

    def inspect_sources(self) -> dict[str, FileRecording]:
        """Read and inspect the recordings of the sources, by serial, the lot's own source first."""
        paths = {self.lot.source: self.source_path, **self.more_source_paths}
        return {serial: self._inspect(path, serial) for serial, path in paths.items()}

    def source_remarks(self) -> list[str]:
        """Return what the look at the recordings of the sources shows, one line each with file and line."""
        return [f"{one.table.path.name}: {remark}" for one in self.inspect_sources().values() for remark in one.remarks]

    def check_name(self, row: str) -> None:
        """Raise `InputError` where a unit's file names no serial, or one that another file names, too."""
        if row in self.problems:
            raise InputError(self.problems[row])

    def read_unit(self, serial: str) -> OutputRecording:
        """Read a target unit's output; a reference column in its file is never looked at."""
        self.check_name(serial)
        path = self.unit_paths[serial]
        content = read_regular(path, self.root)
        return read_recording(path, serial, self.lot.sample_rate_Hz, self.lot.output_unit, content, self.names)

    def read_audit(self, serial: str) -> LabelledRecording | None:
        path = self.audit_paths.get(serial)
        return None if path is None else self._labelled(path, serial)

    def readable_audits(self) -> Iterator[LabelledRecording]:
        """Give every audit that can be read; what cannot be is told as its unit's result."""
        for serial, path in self.audit_paths.items():
            with suppress(InputError):
                yield self._labelled(path, serial)

    def read_golden(self) -> OutputRecording | LabelledRecording | None:
        """Read the golden run, with its reference if it has one."""
        path = self.golden_path
        if path is None:
            return None
        content = read_regular(path, self.root)
        if self.names.reference in read_table(path, self.names.table, content=content).names:
            return self._labelled(path, self.golden_serial)
        return read_recording(
            path, self.golden_serial, self.lot.sample_rate_Hz, self.lot.output_unit, content, self.names
        )

    @property
    def _units(self) -> tuple[str, str]:
        return self.lot.output_unit, self.lot.reference_unit

    def _labelled(self, path: Path, serial: str) -> LabelledRecording:
        return self._inspect(path, serial).labelled(self.lot.reference_unit)

    def _inspect(self, path: Path, serial: str) -> FileRecording:
        content, rate_Hz = read_regular(path, self.root), self.lot.sample_rate_Hz
        return inspect_recording(path, serial, rate_Hz, self._units, content, self.names, with_reference=True)


def open_lot_folder(folder: Path) -> LotFolder:
    """Read `lot.toml` and list the recordings.

    Raises:
        InputError: no such folder, no or a wrong `lot.toml`, no source recording, a serial given twice, or a golden run
            that is not of the source or one of the units.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such lot folder; make one with `softcal import`")
    lot, line, reference, more, remarks, names, of_maps, at = _read_lot_toml(folder / "lot.toml")
    listed = {name: _recordings(folder / name) for name in ("source", "units", "audit", GOLDEN)}
    sources = listed["source"].usable
    for serial in (lot.source, *more):
        if problem := listed["source"].problems.get(serial):
            raise InputError(problem)
        if serial not in sources:
            seen = ", ".join(sources) or "nothing"
            raise InputError(f"{folder / 'source'}: no recording of the source unit {serial!r}; found {seen}")
    units, audits, problems = listed["units"].paths, listed["audit"].usable, listed["units"].problems
    remarks = (
        *remarks,
        *(f"lot.toml: [audit] {s}: audit/ has no such recording" for s in sorted(set(at) - set(audits))),
    )
    remarks = (*remarks, *(line for name in ("source", "audit", GOLDEN) for line in listed[name].remarks(name)))
    golden = listed[GOLDEN].usable
    if len(golden) > 1 or set(golden) - {lot.source, *units}:
        raise InputError(
            f"{folder / GOLDEN}: golden run of {', '.join(sorted(golden)[:5])}; one run was expected, of the source "
            f"{lot.source} or of one of the units; nothing was fitted"
        )
    loads = next((path for path in map(folder.joinpath, ANCHOR_FILES) if path.is_file()), None)
    further, source = {serial: sources[serial] for serial in more}, sources[lot.source]
    golden_serial = next(iter(golden), "")
    not_used = unused_of_lot(folder, {lot.source: source, **further}, units)
    return LotFolder(
        folder,
        lot,
        source,
        units,
        audits,
        remarks,
        not_used,
        line,
        reference,
        golden.get(golden_serial),
        golden_serial,
        loads,
        further,
        problems,
        names,
        of_maps,
        at,
    )


@dataclass(frozen=True)
class _Listing:
    """Recordings of one folder by row of a report (their serial where they have one), and why some are not used."""

    paths: Mapping[str, Path]
    problems: Mapping[str, Reason]

    @property
    def usable(self) -> dict[str, Path]:
        return {row: path for row, path in self.paths.items() if row not in self.problems}

    def remarks(self, folder: str) -> tuple[str, ...]:
        return tuple(f"{folder}/{self.paths[row].name}: not used: {why}" for row, why in self.problems.items())


def _recordings(folder: Path) -> _Listing:
    paths: dict[str, Path] = {}
    problems: dict[str, Reason] = {}
    files: dict[str, list[tuple[str, str]]] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.name.startswith(".") or path.suffix.lower() not in READERS:
            continue
        try:
            row = check_serial(path.stem)
            files.setdefault(serial_key(row), []).append((row, path.name))
        except InputError as error:
            row = row_name(path.stem)
            problems[row] = error.reason
        paths[row] = path
    for same in files.values():
        names = ", ".join(row_name(name) for _, name in same)
        if len(same) > 1:
            problems |= {row: reason("name.twice", serial=repr(row), files=names) for row, _ in same}
    return _Listing(paths, problems)


LotToml = tuple[
    Lot,
    LineSpread | None,
    Reference | None,
    tuple[str, ...],
    tuple[str, ...],
    ColumnNames,
    str | None,
    Mapping[str, datetime],
]
"""What lot.toml says: the lot, its line, the source's reference, further sources, remarks, how its tables are read,
the family of its maps, and when audits were measured.
"""


def _read_lot_toml(path: Path) -> LotToml:
    content = read_toml(path, "`softcal import` writes one", path.parent)
    with naming(path):
        tables = {name: content.get(name, {}) for name in KNOWN_KEYS if name}
        for name, table in tables.items():
            if not isinstance(table, dict):
                raise InputError(f"[{name}] must be a table")
        spreads = [typed(f"[line] {key}", float, tables["line"].get(key, 0.0)) for key in ("load_spread", "day_spread")]
        line, reference = LineSpread(*spreads) if tables["line"] else None, None
        is_simulated = tables["lot"].get("simulated", False)
        if not isinstance(is_simulated, bool):
            raise InputError(f"[lot] simulated is {is_simulated!r}; true or false was expected")
        hints, stated = get_type_hints(Reference), tables["reference"].keys() & STATED
        if is_simulated:
            reference = SIMULATED
        elif stated:
            facts = {key: value for key, value in tables["reference"].items() if key in stated}
            reference = Reference(**{key: typed(f"[reference] {key}", hints[key], v) for key, v in facts.items()})
        places, limit = (content, tables["lot"], tables["output"]), tables["limit"].get("rmse")
        lot = Lot(
            id=typed("[lot] id", str, tables["lot"].get("id")),
            source=typed("source", str, _only(places, "source")),
            sample_rate_Hz=typed("sample_rate_Hz", float, _only(places, "sample_rate_Hz")),
            sensor_model=str(tables["lot"].get("sensor_model", "")),
            reference_quantity=str(tables["reference"].get("quantity", "force")),
            reference_unit=str(tables["reference"].get("unit", "N")),
            output_unit=str(tables["output"].get("unit", "V")),
            limit_rmse=None if limit is None else typed("[limit] rmse", float, limit),
        )
        more = tables["lot"].get("more_sources", [])
        if not isinstance(more, list) or not all(isinstance(serial, str) for serial in more):
            raise InputError(f"[lot] more_sources is {more!r}; a list of serials was expected")
        serials = tuple(map(check_serial, more))
        if len({lot.source, *serials}) <= len(serials):
            raise InputError(f"[lot] more_sources is {more!r}; each source once, and {lot.source!r} is the first")
        return (
            lot,
            line,
            reference,
            serials,
            tuple(_unknown_keys(path, content)),
            _column_names(tables["table"], lot.sample_rate_Hz),
            check_family(typed("[map] family", str, tables["map"]["family"])) if "family" in tables["map"] else None,
            {check_serial(s): parse_instant(f"[audit] {s}", str(at)) for s, at in tables["audit"].items()},
        )


def _column_names(stated: Mapping[str, object], rate_Hz: float) -> ColumnNames:
    """Return the columns and the layout that [table] states; the lot's rate makes stamps that such files lack."""
    if not stated:
        return PLAIN
    names = {key: typed(f"[table] {key}", str, stated[key]) for key in COLUMN_KEYS if key in stated}
    layout: dict[str, object] = {}
    for key in ("delimiter", "decimal", "encoding", "sheet", "time_format"):
        if key in stated:
            layout[key] = typed(f"[table] {key}", str, stated[key])
    if "header_row" in stated:
        layout["header_row"] = typed("[table] header_row", int, stated["header_row"])
    if "missing" in stated:
        missing = stated["missing"] if isinstance(stated["missing"], list) else [stated["missing"]]
        layout["missing"] = tuple(str(text) for text in missing)
    return replace(PLAIN, **names, rate_Hz=rate_Hz, table=TableOptions(**layout))  # type: ignore[arg-type]


def _only(places: tuple[Mapping[str, object], ...], key: str) -> object:
    given = [place[key] for place in places if key in place]
    if len(set(map(str, given))) > 1:
        raise InputError(f"{key} is given more than once, with different values")
    if not given:
        raise InputError(f"{key} is missing")
    return given[0]


def _unknown_keys(path: Path, content: Mapping[str, object]) -> Iterator[str]:
    for key, value in content.items():
        if key == "audit":
            continue
        if key in KNOWN_KEYS and isinstance(value, dict):
            unknown = sorted(set(value) - KNOWN_KEYS[key])
            if unknown:
                yield f"{path}: [{key}] {', '.join(unknown)} not used; known: {', '.join(sorted(KNOWN_KEYS[key]))}"
        elif key not in KNOWN_KEYS[""]:
            yield f"{path}: {key} not used; known: {', '.join(sorted(set(KNOWN_KEYS) - {''}))}, sample_rate_Hz, source"


def write_lot_toml(
    folder: Path,
    lot: Lot,
    reference: Reference | None = None,
    more_sources: Sequence[str] = (),
    measured_at: Mapping[str, datetime] | None = None,
) -> None:
    """Write `lot.toml`, with what its source was compared with, further sources, and when audits were measured."""
    document = tomlkit.document()
    document["sample_rate_Hz"] = lot.sample_rate_Hz
    document["source"] = lot.source
    simulated = {"simulated": True} if reference is not None and reference.is_simulated else {}
    more = {"more_sources": list(more_sources)} if more_sources else {}
    document["lot"] = {"id": lot.id, "sensor_model": lot.sensor_model, **more, **simulated}
    document["reference"] = {"quantity": lot.reference_quantity, "unit": lot.reference_unit, **_stated(reference)}
    document["output"] = {"unit": lot.output_unit}
    if lot.limit_rmse is not None:
        document["limit"] = {"rmse": lot.limit_rmse}
    if measured_at:
        document["audit"] = dict(measured_at)
    write_text(folder / "lot.toml", tomlkit.dumps(document))


def read_lot(folder: Path) -> Lot:
    """Return what a folder's `lot.toml` says of its lot.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    return _read_lot_toml(folder / "lot.toml")[0]


def restate_limit(folder: Path, rmse: float) -> None:
    """Write a limit into `lot.toml`, in the reference's unit; all else stays."""
    document = tomlkit.parse((folder / "lot.toml").read_text(encoding="utf-8"))
    document["limit"] = {"rmse": rmse}
    write_text(folder / "lot.toml", tomlkit.dumps(document))


def restate_measured_at(folder: Path, measured_at: Mapping[str, datetime | None]) -> None:
    """Write into `lot.toml` when audits were measured, UTC; None takes out what was stated of an older one."""
    document = tomlkit.parse((folder / "lot.toml").read_text(encoding="utf-8"))
    kept = {serial: at for serial, at in document.get("audit", {}).items() if serial not in measured_at}
    stated = kept | {serial: at for serial, at in measured_at.items() if at is not None}
    if stated:
        document["audit"] = stated
    elif "audit" in document:
        del document["audit"]
    write_text(folder / "lot.toml", tomlkit.dumps(document))


def restate_reference(folder: Path, reference: Reference | None) -> None:
    """Write into `lot.toml` what the source was compared with this time; all else stays."""
    stated = _stated(reference)
    if not stated:
        return
    document = tomlkit.parse((folder / "lot.toml").read_text(encoding="utf-8"))
    document.setdefault("reference", tomlkit.table()).update(stated)
    write_text(folder / "lot.toml", tomlkit.dumps(document))


def _stated(reference: Reference | None) -> dict[str, object]:
    if reference is None or reference.is_simulated:
        return {}
    default = vars(Reference())
    return {name: value for name, value in vars(reference).items() if value != default[name]}
