"""Make a lot folder out of tables: one file per unit, or one wide file with a column per unit."""

import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from softcal.app.files.atomic import atomic_folder
from softcal.app.files.import_plan import Columns, ImportedUnit, ImportPlan
from softcal.app.files.lot_toml import write_lot_toml
from softcal.app.files.measured_at import local_time_remarks, measured_at_row
from softcal.app.files.recording_file import (
    FileRecording,
    build_from_table,
    read_timed_table,
    read_times,
    write_rows,
)
from softcal.app.files.unused_input import UnusedInput
from softcal.app.files.unused_parts import unused_of_import
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.read import READERS
from softcal.app.tables.table import Table
from softcal.app.tables.time_column import is_clock_heading
from softcal.app.tables.timestamps import Start, median_rate_Hz
from softcal.core.errors import InputError
from softcal.core.inspection.comparison import compare_with_source
from softcal.core.lot import check_serial, file_stem, serial_key
from softcal.core.messages.reason import Reason, reason
from softcal.core.quality.duplicate_recordings import RecordedOutput, same_recordings
from softcal.core.recording import Array, LabelledRecording


@dataclass(frozen=True, eq=False)
class ImportedLot:
    """Result of an import, with the unused parts of the tables.

    Args:
        units, audits: serials of the target units, and of those whose references are kept.
        layouts: detected layout of each file, in one line; "" for the plain form.
        remarks: what is odd but no error, such as one recording under two serials.
        reference_range: range of the source's reference, in its unit.
    """

    units: tuple[str, ...]
    audits: tuple[str, ...]
    reference_range: float
    layouts: Mapping[str, str]
    not_used: tuple[UnusedInput, ...]
    remarks: tuple[Reason | str, ...]


def list_tables(path: Path) -> list[Path]:
    """Return a file, or the tables of a folder; those of a lot folder are in source/ and units/.

    Raises:
        InputError: a folder without a table.
    """
    if not path.is_dir():
        return [path]
    folders = [path, path / "source", path / "units"]
    files = [file for folder in folders if folder.is_dir() for file in sorted(folder.iterdir())]
    tables = [file for file in files if file.suffix.lower() in READERS and not file.name.startswith(".")]
    if not tables:
        raise InputError(f"{path}: there is no table in this folder; {', '.join(sorted(READERS))} were looked for")
    return tables


def import_lot(plan: ImportPlan, folder: Path) -> ImportedLot:
    """Write a lot folder, whole or not at all, with every row that a table has: empty cells stay empty.

    Raises:
        InputError: `folder` exists and is not empty, a table cannot be used, a source comes twice,
            or the source is not among the units or has no reference.
    """
    if not plan.files:
        raise InputError("no file to import; name at least one table")
    if plan.serials is not None and (plan.columns.is_wide or len(plan.serials) != len(plan.files)):
        raise InputError(f"{len(plan.serials)} serials for {len(plan.files)} files; give one serial per file, in order")
    tables, unnamed = _read_units(plan)
    units = {serial: unit for _, serial, unit in tables}
    for serial in plan.sources:
        if serial not in units:
            raise InputError(f"source {serial!r} is none of the units {', '.join(list(units)[:8])}")
        if units[serial].reference is None:
            raise InputError(f"source {serial!r} has no reference; name its column")
    labelled = {s: unit.file if s in plan.sources else unit.audit for s, unit in units.items()} if plan.audit else {}
    audited = {serial: audit for serial, audit in labelled.items() if audit is not None}
    first = plan.audit_rows[0] if plan.audit_rows else 0
    instants = {serial: at for serial, audit in audited.items() if (at := measured_at_row(audit, first))}
    with atomic_folder(folder) as part:
        write_lot_toml(part, plan.lot, more_sources=plan.more_sources, measured_at=instants)
        for serial, unit in units.items():
            subfolder = "source" if serial in plan.sources else "units"
            write_rows(part / subfolder / f"{serial}.csv", unit.file, plan.fit_rows)
        for serial, audit in audited.items():
            write_rows(part / "audit" / f"{serial}.csv", audit, plan.audit_rows)
    audits, not_used = unused_of_import(plan, tables)
    comparison_remarks = compare_audits(plan, units)
    layouts = {path.name: unit.file.table.layout for path, _, unit in tables}
    file_remarks = dict.fromkeys(f"{path.name}: {remark}" for path, _, unit in tables for remark in unit.file.remarks)
    targets = tuple(serial for serial in units if serial not in plan.sources)
    recorded_outputs = [
        RecordedOutput(serial, plan.lot.id, unit.recording.output_sha256) for serial, unit in units.items()
    ]
    remarks: list[Reason | str] = [
        *file_remarks,
        *local_time_remarks({one.table.path: one.start for one in audited.values()}),
        *comparison_remarks,
        *same_recordings(recorded_outputs),
    ]
    remarks += [] if targets else [Reason("lot.no_units")]
    reference = units[plan.lot.source].reference
    full_range = 0.0 if reference is None else float(np.ptp(reference))
    return ImportedLot(targets, tuple(audits), full_range, layouts, (*unnamed, *not_used), tuple(remarks))


def compare_audits(plan: ImportPlan, units: Mapping[str, ImportedUnit]) -> tuple[Reason, ...]:
    """Return findings that an audit has another unit of measure or sign than the source."""
    source, unit = units.get(plan.lot.source), plan.lot.reference_unit
    labelled: dict[str, LabelledRecording] = {}
    for serial, one in units.items():
        # A reference that can label nothing is refused where it is used.
        with suppress(InputError):
            if one.audit is not None or one is source:
                labelled[serial] = one.labelled(unit)
    labelled_source = labelled.pop(plan.lot.source, None)
    return () if labelled_source is None else compare_with_source(labelled_source, labelled.values())


def _read_units(plan: ImportPlan) -> tuple[list[tuple[Path, str, ImportedUnit]], list[UnusedInput]]:
    """Read the units of a plan by file name, and report files whose name is no serial."""
    rows: list[tuple[Path, str, ImportedUnit]] = []
    for path, serial, unit in _read(plan):
        if isinstance(unit, InputError):
            raise unit
        rows.append((path, serial, unit))
    problems = _name_problems([(path, serial) for path, serial, _ in rows])
    tables, unnamed = [], list[UnusedInput]()
    for number, ((path, serial, unit), problem) in enumerate(zip(rows, problems, strict=True), start=1):
        stem = serial
        if problem is not None:
            if serial in plan.sources:
                raise InputError(problem)
            # Its file keeps a name that is no serial: the batch gives it a row that says why it is not calibrated.
            stem = file_stem(f"{serial} (file {number})" if problem.code == "name.twice" else serial)
            is_wide = plan.columns.is_wide
            unnamed.append(
                UnusedInput("column", serial, problem, path.name)
                if is_wide
                else UnusedInput("file", path.name, problem)
            )
        tables.append((path, stem, unit))
    return tables, unnamed


@dataclass(frozen=True, eq=False)
class ImportPreview:
    """Preview of one table, or one column of it: a unit as read, or the reason of a refusal.

    A table that cannot be read as a whole has no serial.
    """

    path: Path
    serial: str
    unit: ImportedUnit | None
    problem: str = ""

    @property
    def file(self) -> str:
        return self.path.name


def preview_import(plan: ImportPlan) -> list[ImportPreview]:
    """Read every unit and return refusals with reasons; a plan without refusals can be imported."""
    previews, rows = [], list(_read(plan))
    problems = _name_problems([(path, serial) for path, serial, _ in rows])
    for (path, serial, unit), name_problem in zip(rows, problems, strict=True):
        if isinstance(unit, InputError):
            problem = str(unit).replace(f"{path}: ", "").replace(str(path), path.name)
            previews.append(ImportPreview(path, serial, None, problem))
        elif name_problem is not None:
            previews.append(ImportPreview(path, serial, None, str(name_problem)))
        else:
            previews.append(ImportPreview(path, serial, unit))
    return previews


def _name_problems(files_and_serials: Sequence[tuple[Path, str]]) -> list[Reason | None]:
    """Return for each (file, serial) why it names no unit (no serial, or a repeated one), else None.

    A table that cannot be read has no serial, "", and no problem here.
    """
    files: dict[str, list[str]] = {}
    for path, serial in files_and_serials:
        files.setdefault(serial_key(serial), []).append(str(path))
    problems: list[Reason | None] = []
    for _, serial in files_and_serials:
        paths = files[serial_key(serial)]
        problems.append(_name_problem(serial, paths) if serial else None)
    return problems


def _name_problem(serial: str, paths: Sequence[str]) -> Reason | None:
    try:
        check_serial(serial)
    except InputError as error:
        return error.reason
    return reason("name.twice", serial=repr(serial), files=", ".join(paths)) if len(paths) > 1 else None


def _read(plan: ImportPlan) -> Iterator[tuple[Path, str, "ImportedUnit | InputError"]]:
    """Yield every unit of a plan with its file and serial, or the error of a refused unit or table."""
    columns, renamed = plan.columns, set[str]()
    others = (columns.reference, columns.stage)
    for k, path in enumerate(plan.files):
        try:
            names = replace(columns.names(columns.output, plan.table), rate_Hz=plan.lot.sample_rate_Hz)
            table, names = read_timed_table(path, names, columns.is_requested)
            t_s, remarks, start = read_times(table, names, plan.lot.sample_rate_Hz)
            outputs = [columns.output]
            if columns.is_wide:
                other_names = (*others, names.time)
                candidates = [
                    c.name for c in table.columns if c.name not in other_names and not is_clock_heading(c.name)
                ]
                outputs = list(filter(columns.is_output, candidates))
                if not outputs:
                    raise InputError(f"{path}: no column matches {columns.output!r}")
        except InputError as error:
            yield path, "", error
            continue
        table = replace(table, remarks=(*table.remarks, *remarks))
        for output in outputs:
            name = output if columns.is_wide else path.stem
            serial = unicodedata.normalize("NFC", plan.renames.get(name, plan.serials[k] if plan.serials else name))
            renamed.add(name)
            if serial in plan.without:
                continue
            try:
                yield path, serial, _build_unit(plan, table, t_s, output, serial, start)
            except InputError as error:
                yield path, serial, error
    if unused := sorted(set(plan.renames) - renamed):
        raise InputError(f"--serial {unused[0]}={plan.renames[unused[0]]}: no file or column is named {unused[0]!r}")


def _build_unit(
    plan: ImportPlan, table: Table, t_s: Array, output: str, serial: str, start: Start | None
) -> ImportedUnit:
    lot, columns = plan.lot, plan.columns
    identity = (serial, lot.sample_rate_Hz, lot.output_unit, columns.names(output, plan.table))

    def build(*, with_reference: bool) -> FileRecording:
        return replace(build_from_table(table, t_s, *identity, with_reference=with_reference), start=start)

    if serial in plan.sources and columns.reference is not None:
        return ImportedUnit(build(with_reference=True))
    has_audit = plan.audit and columns.reference in table.names
    return ImportedUnit(build(with_reference=False), build(with_reference=True) if has_audit else None)


def detect_rate_Hz(path: Path, columns: Columns, table: TableOptions = DETECT) -> float:
    """Return the sample rate that the time column of a table shows, rounded to five digits.

    Raises:
        InputError: there is no such column, it never advances, or nothing states its unit.
    """
    read, names = read_timed_table(path, columns.names(columns.output, table), columns.is_requested)
    t_s, *_ = read_times(read, names, None)
    rate_Hz = median_rate_Hz(t_s)
    if not np.isfinite(rate_Hz):
        raise InputError(
            f"{path}: column {columns.time or 't_s'!r} never advances; give the sample rate, or another time column"
        )
    return rate_Hz
