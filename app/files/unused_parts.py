"""Unused parts of a person's files in an import, an audit or a batch, with reasons."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING
from unicodedata import normalize

from softcal.app.files.recording_file import ColumnNames
from softcal.app.files.unused_input import MAX_NAMES, UnusedInput
from softcal.app.tables.read import PARQUET, READERS
from softcal.core.messages.reason import Reason, reason

if TYPE_CHECKING:
    from softcal.app.files.import_plan import Columns, ImportedUnit, ImportPlan
    from softcal.app.tables.table import Table

PARTS = ("source", "units", "audit", "golden")
"""Folders of a lot folder that hold recordings."""

MAX_HEADER_BYTES = 1 << 16


def unread_files(path: Path) -> list[UnusedInput]:
    """Return the files of a folder that are no table, or lie in a subfolder that is not read."""
    if not path.is_dir():
        return []
    folders = [folder for folder in (path, path / "source", path / "units") if folder.is_dir()]
    items = []
    for folder in folders:
        for entry in _entries(folder):
            if entry.is_dir() and entry not in folders and _entries(entry):
                items.append(UnusedInput("file", f"{entry.relative_to(path)}/", Reason("unused.folder")))
            elif not entry.is_dir() and entry.suffix.lower() not in READERS and entry.name != "lot.toml":
                items.append(UnusedInput("file", str(entry.relative_to(path)), _format()))
    return items


def unused_of_import(
    plan: "ImportPlan", units: Sequence[tuple[Path, str, "ImportedUnit"]]
) -> tuple[list[str], tuple[UnusedInput, ...]]:
    """Return the serials of targets whose references become audits, and the unused parts of the tables."""
    audits: list[str] = []
    items: dict[UnusedInput, None] = {}
    for path, serial, unit in units:
        is_source = serial in plan.sources
        if not is_source and unit.audit is not None:
            audits.append(serial)
        for item in (*_columns(plan, path, unit, is_source), *_audit(plan, path, serial, unit), *_rows(plan, unit)):
            items[item] = None
    return audits, tuple(items)


def _columns(plan: "ImportPlan", path: Path, unit: "ImportedUnit", is_source: bool) -> Iterator[UnusedInput]:
    columns = plan.columns
    for name in unit.file.table.names:
        if not columns.is_requested(name):
            yield UnusedInput("column", name, reason("unused.column"), path.name)
        elif name == columns.reference and not (is_source or plan.audit or columns.is_wide):
            yield UnusedInput("column", name, reason("unused.reference"), path.name)


def _audit(plan: "ImportPlan", path: Path, serial: str, unit: "ImportedUnit") -> Iterator[UnusedInput]:
    reference = plan.columns.reference
    if plan.audit and unit.audit is None and reference is not None and serial not in plan.sources:
        yield UnusedInput("audit", serial, no_reference_column(plan.columns, unit.file.table))


def no_reference_column(columns: "Columns", table: "Table") -> Reason:
    """Return that a table lacks the column of the reference, and which one may be meant."""
    reference = columns.reference or ""
    alike = [name for name in table.names if _folded(name) == _folded(reference)]
    others = alike or [name for name in table.names if not columns.is_requested(name)]
    listed_names = ", ".join(map(repr, others[:MAX_NAMES])) or "no other column"
    return reason("unused.no_column", file=table.path.name, column=repr(reference), others=listed_names)


def _folded(name: str) -> str:
    return "".join(c for c in name.casefold() if c.isalnum())


def _rows(plan: "ImportPlan", unit: "ImportedUnit") -> Iterator[UnusedInput]:
    total, serial = len(unit.file.table), unit.recording.serial
    is_audited = plan.audit and unit.reference is not None
    parts = [plan.fit_rows or (0, total), *([plan.audit_rows or (0, total)] if is_audited else [])]
    rows_used = {row for start, stop in parts for row in range(start, min(stop, total))}
    if unused_count := total - len(rows_used):
        rows = " ".join(f"{start}:{stop}" for start, stop in parts)
        yield UnusedInput("rows", serial, reason("unused.rows", count=unused_count, total=total, rows=rows))


def unused_of_lot(root: Path, sources: Mapping[str, Path], units: Mapping[str, Path]) -> tuple[UnusedInput, ...]:
    """Return what of a lot folder is not used: files of another kind or place, audits of no unit.

    Args:
        sources: recordings of the sources that `lot.toml` names, by serial.
    """
    items = []
    for part in filter(Path.is_dir, (root / name for name in PARTS)):
        serials = {"source": set(sources), "audit": {*units, *sources}}.get(part.name)
        for entry in _entries(part):
            name = str(entry.relative_to(root))
            if entry.suffix.lower() not in READERS:
                items.append(UnusedInput("file", name, _format()))
            elif serials is not None and normalize("NFC", entry.stem) not in serials:
                if part.name == "audit":
                    items.append(UnusedInput("audit", entry.stem, reason("unused.foreign_unit"), name))
                else:
                    items.append(UnusedInput("file", name, reason("unused.source", sources=", ".join(sources))))
    for entry in _entries(root):
        is_folder = entry.is_dir() and entry.name not in PARTS
        tables = _entries(entry) if is_folder else [entry]
        if any(one.suffix.lower() in READERS and one.is_file() for one in tables) and entry.stem != "anchors":
            items.append(UnusedInput("file", f"{entry.name}/" if is_folder else entry.name, Reason("unused.place")))
    return tuple(items)


def unused_columns(root: Path, units: Mapping[str, Path], names: ColumnNames) -> list[UnusedInput]:
    """Return columns of the units' files in a lot folder that no fit reads.

    Only a header in the first line is looked at; a file that cannot be read has none.
    """
    items = []
    for path in units.values():
        header = _header(path, root)
        for name in header if names.output in header else ():
            if not names.is_requested(name):
                code = "unused.labelled" if name == names.reference else "unused.unit_column"
                items.append(UnusedInput("column", name, Reason(code), path.name))
    return items


def _header(path: Path, root: Path) -> list[str]:
    with suppress(OSError, ValueError, csv.Error, RuntimeError):
        if not path.is_file() or not path.resolve().is_relative_to(root.resolve()):
            return []
        if path.suffix.lower() in PARQUET:
            from pyarrow import ArrowException
            from pyarrow.parquet import read_schema

            with suppress(ArrowException):
                return list(read_schema(path).names)
            return []
        with path.open(encoding="utf-8-sig", newline="") as file:
            return next(csv.reader([file.readline(MAX_HEADER_BYTES)]), [])
    return []


def _format() -> Reason:
    return reason("unused.format", suffixes=", ".join(sorted(READERS)))


def _entries(folder: Path) -> list[Path]:
    return [entry for entry in sorted(folder.iterdir()) if not entry.name.startswith((".", "~$"))]
