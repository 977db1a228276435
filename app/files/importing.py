"""Make a lot folder out of tables: one file per unit, or one wide file with a column per unit."""

import fnmatch
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softcal.app.files.atomic import whole_folder
from softcal.app.files.bounded_table import MOST_CELLS, NAMES
from softcal.app.files.lot_folder import write_lot_toml
from softcal.app.files.not_used import NotUsed, unused_of_import
from softcal.app.files.recording_file import STAGE, SUFFIXES, column, naming, read_table, timed, write_recording
from softcal.core.errors import InputError
from softcal.core.lot import Lot, check_serial, file_stem, serial_key
from softcal.core.quality.same_recording import Pressed, same_recordings
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.words.reason import Reason, reason

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Columns:
    """Which columns of the tables hold what.

    Args:
        output: the output column; with `*` or `?` many, each becomes a unit of that name.
        time: name of the time column in s; None makes time stamps from the sample rate.
        stage: column of the stage position in mm, None without; `stage_mm` may be missing.
    """

    output: str = "output"
    reference: str | None = None
    time: str | None = None
    stage: str | None = None

    @property
    def is_wide(self) -> bool:
        return any(c in self.output for c in "*?[")

    def asks_for(self, name: str) -> bool:
        """Whether a column of this name is needed; others are not read where possible."""
        return name in (self.reference, self.time, self.stage) or (
            fnmatch.fnmatchcase(name, self.output) if self.is_wide else name == self.output
        )


@dataclass(frozen=True)
class ImportPlan:
    """What to import and what the lot is to be.

    Args:
        lot: facts of the lot; its `sample_rate_Hz` must be known unless there is a time column.
        audit: whether references of target units are kept in audit/: they decide.
        fit_rows, audit_rows: (start, stop) of data rows, counted from 0, for recordings that fit and that score;
            None takes all.
        serials: serial of each file in order; None takes the file names.
    """

    files: Sequence[Path]
    columns: Columns
    lot: Lot
    audit: bool = False
    fit_rows: tuple[int, int] | None = None
    audit_rows: tuple[int, int] | None = None
    sheet: str | None = None
    serials: Sequence[str] | None = None
    most_cells: int = MOST_CELLS
    without: frozenset[str] = frozenset()
    more_sources: Sequence[str] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """Serials of the units whose references train a network, the lot's own source first."""
        return (self.lot.source, *map(check_serial, self.more_sources))


@dataclass(frozen=True, eq=False)
class ImportedUnit:
    """One unit as read: the whole recording, its reference where the table had one, and the names of all columns."""

    recording: OutputRecording
    reference: Array | None
    names: tuple[str, ...] = ()

    def part(self, rows: tuple[int, int] | None) -> "ImportedUnit":
        """Return the given data rows; the whole where `rows` is None."""
        if rows is None:
            return self
        start, stop = rows
        if not 0 <= start < stop <= len(self.recording):
            raise InputError(f"rows {start}:{stop} of {self.recording.serial}: it has {len(self.recording)} rows")
        reference = None if self.reference is None else self.reference[start:stop]
        return ImportedUnit(self.recording.part(start, stop), reference, self.names)


@dataclass(frozen=True)
class ImportedLot:
    """What an import wrote, and what of the tables it did not use.

    Args:
        units: serials of the target units.
        audits: those of them whose references are kept as audits.
        remarks: what is odd and no error, such as one recording under two serials.
    """

    units: tuple[str, ...]
    audits: tuple[str, ...]
    not_used: tuple[NotUsed, ...]
    remarks: tuple[Reason, ...]


def tables_of(path: Path) -> list[Path]:
    """Return a file as it is, and of a folder its tables; a lot folder's lie in source/ and units/.

    Raises:
        InputError: a folder without a table.
    """
    if not path.is_dir():
        return [path]
    folders = [path, path / "source", path / "units"]
    files = [file for folder in folders if folder.is_dir() for file in sorted(folder.iterdir())]
    tables = [file for file in files if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")]
    if not tables:
        raise InputError(f"{path}: there is no table in this folder; {', '.join(sorted(SUFFIXES))} were looked for")
    return tables


def import_lot(plan: ImportPlan, folder: Path) -> ImportedLot:
    """Write a lot folder, whole or not at all, and return what was written and what was not used.

    Raises:
        InputError: `folder` exists and is not empty, a table cannot be used, a source comes twice,
            or the source is not among the units or has no reference.
    """
    if not plan.files:
        raise InputError("no file to import; name at least one CSV, Excel or Parquet file")
    if plan.serials is not None and (plan.columns.is_wide or len(plan.serials) != len(plan.files)):
        raise InputError(f"{len(plan.serials)} serials for {len(plan.files)} files; give one serial per file, in order")
    rows: list[tuple[Path, str, ImportedUnit]] = []
    for path, serial, unit in _read(plan):
        if isinstance(unit, InputError):
            raise unit
        rows.append((path, serial, unit))
    problems = _name_problems([(path, serial) for path, serial, _ in rows])
    units, tables, unnamed = {}, [], list[NotUsed]()
    for number, ((path, serial, unit), problem) in enumerate(zip(rows, problems, strict=True), start=1):
        stem = serial
        if problem is not None:
            if serial in plan.sources:
                raise InputError(problem)
            # Its file keeps a name that is no serial: the batch gives it a row that says why it is not calibrated.
            stem = file_stem(f"{serial} (file {number})" if problem.code == "name.twice" else serial)
            unnamed.append(NotUsed("file", path.name, problem))
        units[stem] = unit
        tables.append((path, stem, unit))
    for serial in plan.sources:
        source = units.get(serial)
        if source is None:
            raise InputError(f"source {serial!r} is none of the units {', '.join(list(units)[:8])}")
        if source.reference is None:
            raise InputError(f"source {serial!r} has no reference; name its column")
    with whole_folder(folder) as part:
        write_lot_toml(part, plan.lot, more_sources=plan.more_sources)
        for serial, unit in units.items():
            fit = unit.part(plan.fit_rows)
            if serial in plan.sources and fit.reference is not None:
                # Both columns are checked here: a lot folder never holds a broken source.
                LabelledRecording(fit.recording, fit.reference)
                write_recording(part / "source" / f"{serial}.csv", fit.recording, fit.reference)
            else:
                write_recording(part / "units" / f"{serial}.csv", fit.recording)
            if plan.audit and unit.reference is not None:
                audit = unit.part(plan.audit_rows)
                write_recording(part / "audit" / f"{serial}.csv", audit.recording, audit.reference)
    audits, not_used = unused_of_import(plan, tables)
    not_used = (*unnamed, *not_used)
    targets = tuple(serial for serial in units if serial not in plan.sources)
    named = [Pressed(serial, plan.lot.id, unit.recording.output_sha256) for serial, unit in units.items()]
    remarks = (*same_recordings(named), *([] if targets else [Reason("lot.no_units")]))
    return ImportedLot(targets, tuple(audits), not_used, remarks)


@dataclass(frozen=True, eq=False)
class LookedAt:
    """What one table, or one column of it, would become: a unit as read, or why it is refused. It
    has no serial where the table as a whole cannot be read.
    """

    path: Path
    serial: str
    unit: ImportedUnit | None
    problem: str = ""

    @property
    def file(self) -> str:
        return self.path.name


def look_through(plan: ImportPlan) -> list[LookedAt]:
    """Read every unit and say which would be refused and why; a plan without those can be imported."""
    looked, rows = [], list(_read(plan))
    problems = _name_problems([(path, serial) for path, serial, _ in rows])
    for (path, serial, unit), name_problem in zip(rows, problems, strict=True):
        if isinstance(unit, InputError):
            problem = str(unit).replace(f"{path}: ", "").replace(str(path), path.name)
            looked.append(LookedAt(path, serial, None, problem))
        elif name_problem is not None:
            looked.append(LookedAt(path, serial, None, str(name_problem)))
        else:
            looked.append(LookedAt(path, serial, unit))
    return looked


def _name_problems(named: Sequence[tuple[Path, str]]) -> list[Reason | None]:
    """Return for each (file, serial) why it names no unit: no serial, or one that is given twice; None where it does.

    A table that cannot be read has no serial, "", and no problem here.
    """
    files: dict[str, list[str]] = {}
    for path, serial in named:
        files.setdefault(serial_key(serial), []).append(str(path))
    problems: list[Reason | None] = []
    for _, serial in named:
        same = files[serial_key(serial)]
        problems.append(_name_problem(serial, same) if serial else None)
    return problems


def _name_problem(serial: str, same: Sequence[str]) -> Reason | None:
    try:
        check_serial(serial)
    except InputError as error:
        return error.reason
    return reason("name.twice", serial=repr(serial), files=", ".join(same)) if len(same) > 1 else None


def _read(plan: ImportPlan) -> Iterator[tuple[Path, str, "ImportedUnit | InputError"]]:
    """Yield every unit of a plan with its file and serial; in place of one that is refused, or of a table, why."""
    columns = plan.columns
    others = (columns.reference, columns.time, columns.stage)
    for k, path in enumerate(plan.files):
        try:
            table = read_table(path, plan.sheet, most_cells=plan.most_cells, wanted=columns.asks_for)
            outputs = [columns.output]
            if columns.is_wide:
                names = [str(name) for name in table.columns if name not in others]
                outputs = [name for name in names if fnmatch.fnmatchcase(name, columns.output)]
                if not outputs:
                    raise InputError(f"{path}: no column matches {columns.output!r}")
        except InputError as error:
            yield path, "", error
            continue
        for output in outputs:
            serial = path.stem
            if columns.is_wide:
                serial = output
            elif plan.serials:
                serial = plan.serials[k]
            serial = unicodedata.normalize("NFC", serial)
            if serial in plan.without:
                continue
            try:
                yield path, serial, _checked(plan, table, path, output, serial)
            except InputError as error:
                yield path, serial, error


def _checked(plan: ImportPlan, table: "pd.DataFrame", path: Path, output: str, serial: str) -> ImportedUnit:
    with naming(path):
        columns, rate_Hz = plan.columns, plan.lot.sample_rate_Hz
        values = column(table, output, path)
        t_s = timed(table, columns.time, rate_Hz, path)
        is_still = columns.stage is None or (columns.stage == STAGE and STAGE not in table.columns)
        stage_mm = None if is_still else column(table, str(columns.stage), path)
        reference = None
        is_read = serial in plan.sources or (plan.audit and columns.reference in table.columns)
        if columns.reference is not None and is_read:
            reference = column(table, columns.reference, path)
        recording = OutputRecording(serial, t_s, values, rate_Hz, plan.lot.output_unit, stage_mm)
    return ImportedUnit(recording, reference, tuple(map(str, table.attrs.get(NAMES, table.columns))))


OTHER_TIMES = re.compile(r"(?:^|[^A-Za-z])(ms|us|µs|μs|ns|msec|usec|min|millis|micros)(?:$|[^A-Za-z])", re.IGNORECASE)
"""Names of time columns that are not in seconds."""

SLOWEST_HZ = 0.5
"""A soft sensor that is read less often is none: the time column is not in seconds."""


def median_rate_Hz(path: Path, time_column: str, sheet: str | None = None, most_cells: int = MOST_CELLS) -> float:
    """Return the sample rate that the time column of a table shows, rounded to five digits.

    Raises:
        InputError: the column never advances, or is not in seconds by its name or by its steps.
    """
    if unit := OTHER_TIMES.search(time_column):
        raise InputError(
            f"{path}: column {time_column!r} is in {unit[1]} by its name, not in s; convert it, or leave out "
            "the time column and give the sample rate"
        )
    t_s = timed(read_table(path, sheet, most_cells=most_cells, wanted=time_column.__eq__), time_column, 1.0, path)
    steps = np.diff(t_s)
    if not np.any(steps > 0):
        raise InputError(f"{path}: column {time_column!r} never advances; give the sample rate, or another time column")
    rate_Hz = float(f"{1 / np.median(steps[steps > 0]):.5g}")
    if rate_Hz < SLOWEST_HZ:
        raise InputError(
            f"{path}: column {time_column!r} shows {rate_Hz:g} Hz if it is in s; is it in ms? convert it, or give "
            "the sample rate and leave out the time column"
        )
    return rate_Hz
