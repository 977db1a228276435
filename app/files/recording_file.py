"""Recordings on disk: columns of a table into a recording that was inspected, and back."""

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from unicodedata import normalize

import numpy as np

from softcal.app.files.atomic import atomic_file
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.read import PARQUET, read_table, table_pieces
from softcal.app.tables.table import Table
from softcal.app.tables.time_column import (
    INDEX,
    find_time_by_cells,
    find_time_column,
    is_clock_heading,
    is_date_heading,
    is_time_heading,
    parts_per_second,
)
from softcal.app.tables.timestamps import Clock, Start, median_rate_Hz
from softcal.core.errors import InputError
from softcal.core.inspection.build import InspectedRecording, build_recording
from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.reasons import check_reference, summarise
from softcal.core.recording import RATE_TOLERANCE, Array, Indices, LabelledRecording, OutputRecording

STAGE = "stage_mm"
NO_TIME = "there is no column of time such as 't_s'; name it with --time-column, or give the sample rate"


@dataclass(frozen=True)
class ColumnNames:
    """Column names of a recording in a table, and the layout of the table.

    Args:
        time: name of the column of time; None takes the one that the file has.
        reference: name of the column of the reference, where it is read.
        stage: name of the column of the stage position in mm; `stage_mm` may be missing, None takes none.
        rate_Hz: declared samples a second: a check of the time stamps; makes them where the file has none.
        table: the declared layout.
    """

    output: str = "output"
    time: str | None = None
    reference: str = "reference"
    stage: str | None = STAGE
    rate_Hz: float | None = None
    table: TableOptions = DETECT

    def is_requested(self, name: str, *, with_reference: bool = False) -> bool:
        """Whether a column of this name is read."""
        if name in (self.output, self.time, self.stage) or (with_reference and name == self.reference):
            return True
        return is_clock_heading(name) if self.time is None else is_date_heading(name)


PLAIN = ColumnNames()
"""The columns of a lot folder's files."""


@dataclass(frozen=True, eq=False)
class FileRecording:
    """A recording, with the rows of its table.

    Args:
        columns: `t_s`, `output`, `reference` and `stage_mm` where there are such, each (n,) with NaN where a sample is
            missing.
        rows: (m,) row of the table of each sample of the recording.
        reading_remarks: what a person should know of how its table and its time were read.
        start: when its first sample was taken, by its own stamps; None where they are not absolute.
    """

    table: Table
    inspected: InspectedRecording
    columns: Mapping[str, Array]
    rows: Indices
    reading_remarks: tuple[str, ...]
    start: Start | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks for people on the table, its time and its samples."""
        return (*self.reading_remarks, *map(str, summarise(self.inspected.inspection, self.lines)))

    @property
    def t_s(self) -> Array:
        """(n,) time of each row of the table."""
        return self.columns["t_s"]

    @property
    def lines(self) -> Indices:
        """(k,) line of the file of each row that has a time: of each row that was inspected."""
        return self.table.lines[np.isfinite(self.t_s)]

    @property
    def recording(self) -> OutputRecording:
        return self.inspected.recording

    def labelled(self, reference_unit: str) -> LabelledRecording:
        """Return the recording with its reference.

        Raises:
            InputError: it was read without one, or its reference can label nothing; the line is named.
        """
        if self.inspected.reference is None:
            raise InputError(f"{self.table.path}: the recording was read without its reference")
        with prefix_errors(self.table.path):
            check_reference(self.inspected.inspection, self.lines)
            return LabelledRecording(self.recording, self.inspected.reference, reference_unit)


def read_times(table: Table, names: ColumnNames, rate_Hz: float | None) -> tuple[Array, list[str], Start | None]:
    """Return (n,) times in s, NaN for a missing stamp, remarks, and the start of absolute stamps.

    Args:
        rate_Hz: declared rate; makes the time where the table has no column of it.

    Raises:
        InputError: no column of time and no rate, or a column that cannot be read as time.
    """
    clock = find_clock(table, names, rate_Hz)
    if clock is None:
        if not rate_Hz:
            raise InputError(f"{table.path}: {NO_TIME}; the file has: {', '.join(table.names[:12])}")
        return np.arange(len(table)) / rate_Hz, [], None
    t_s = clock.seconds(table, ", or give the sample rate")
    return t_s, clock.remarks, clock.start


def read_timed_table(
    path: Path, names: ColumnNames, is_requested: Callable[[str], bool], content: bytes | None = None
) -> tuple[Table, ColumnNames]:
    """Return the requested columns of a table; without a time heading the cells decide the time column.

    Returns:
        The table, and the names with that of the time.

    Raises:
        InputError: the table cannot be read, or several columns may be the time.
    """
    table = read_table(path, names.table, content=content, is_requested=is_requested)
    time, remark = detect_time_column(table, names, is_requested, content)
    if time is None:
        return table, names
    table = read_table(path, names.table, content=content, is_requested=lambda name: name == time or is_requested(name))
    return replace(table, remarks=(*table.remarks, remark)), replace(names, time=time)


def detect_time_column(
    table: Table, names: ColumnNames, is_requested: Callable[[str], bool], content: bytes | None = None
) -> tuple[str | None, str]:
    """Return the time column by its cells, with a remark; None without one, or without need."""
    outputs = [column for column in table.columns if column.name == names.output and column.cells.dtype.kind == "f"]
    if names.time is not None or any(is_time_heading(name) or name == INDEX for name in table.names) or not outputs:
        return None, ""
    requested = {names.output, names.reference, names.stage}
    others = {name for name, count in Counter(table.names).items() if count == 1 and name not in requested}
    if not others:
        return None, ""
    if content is None:
        read = next(table_pieces(table.path, names.table, others.__contains__, len(table)))
    else:
        read = read_table(table.path, names.table, content=content, is_requested=others.__contains__)
    with prefix_errors(table.path):
        time, evidence = find_time_by_cells(read.columns, outputs[0].cells, names.rate_Hz)
    return time, f"column {time!r} is taken as the time: {evidence}"


def check_rate(path: Path, t_s: Array, rate_Hz: float) -> None:
    """Raise `InputError` if a declared rate contradicts the time stamps."""
    median_Hz = median_rate_Hz(t_s)
    if abs(median_Hz / rate_Hz - 1) > RATE_TOLERANCE:
        raise InputError(
            f"{path}: the time stamps show {median_Hz:.4g} Hz, the declared sample rate is {rate_Hz:.4g} Hz; "
            "correct the one that is wrong"
        )


def find_clock(table: Table, names: ColumnNames, rate_Hz: float | None) -> Clock | None:
    """Return the clock of a table's named time column, else of its detected one; None without one."""
    name = names.time
    if name is None:
        with prefix_errors(table.path):
            others = [one for one in table.names if one not in (names.output, names.reference)]
            name = find_time_column(others, table.columns)
        if name is None or _is_empty(table, name):
            return None
    others = [other for other in table.names if other != name and table.has(other)]
    stamps = [other for other in others if is_time_heading(other)]
    parts = {one: per for one in (name, *stamps) if table.has(one) and (per := parts_per_second(table.column(one)))}
    full_stamps = [one for one in (name, *stamps) if one not in parts]
    # The stamps count whole seconds, and the column beside them the rest of each.
    rest = next(iter(parts.items())) if len(parts) == len(full_stamps) == 1 else None
    dates = [other for other in others if is_date_heading(other)]
    return Clock(
        full_stamps[0] if rest else name,
        names.table.time_format,
        rate_Hz,
        date=dates[0] if len(dates) == 1 else None,
        rest_of_second=rest,
    )


def _is_empty(table: Table, name: str) -> bool:
    cells = table.column(name).cells
    return cells.dtype.kind == "f" and bool(np.isnan(cells).all())


def inspect_recording(
    path: Path,
    serial: str,
    sample_rate_Hz: float | None,
    output_unit: str = "V",
    content: bytes | None = None,
    names: ColumnNames = PLAIN,
    *,
    with_reference: bool = False,
    config: InspectionConfig = InspectionConfig(),  # noqa: B008 - frozen
) -> FileRecording:
    """Return an inspected recording; its reference is inspected only on request.

    Args:
        sample_rate_Hz: rate that the time stamps must have; None takes the declared one of `names`, else theirs.
        config: thresholds of masking, from the calibration method of the unit.

    Raises:
        InputError: the table cannot be read, or is no recording.
    """
    table, names = read_timed_table(path, names, partial(names.is_requested, with_reference=with_reference), content)
    table.column(names.output)
    t_s, remarks, start = read_times(table, names, names.rate_Hz)
    if names.rate_Hz and sample_rate_Hz:
        check_rate(path, t_s, names.rate_Hz)
    rate_Hz = sample_rate_Hz or names.rate_Hz
    built = build_from_table(
        table, t_s, serial, rate_Hz, output_unit, names, with_reference=with_reference, config=config
    )
    return replace(built, reading_remarks=(*built.reading_remarks, *remarks), start=start)


def build_from_table(
    table: Table,
    t_s: Array,
    serial: str,
    rate_Hz: float | None,
    output_unit: str,
    names: ColumnNames,
    *,
    with_reference: bool = False,
    config: InspectionConfig = InspectionConfig(),  # noqa: B008 - frozen
) -> FileRecording:
    """Return an inspected recording of columns of a table, without rows that lack a time.

    Raises:
        InputError: a column is missing or contains text, or the remaining rows are no recording.
    """
    columns = {"t_s": t_s, **_columns(table, names, with_reference=with_reference)}
    timed_rows = np.flatnonzero(np.isfinite(t_s))
    present = {name: values[timed_rows] for name, values in columns.items()}
    remarks = list(table.remarks)
    if len(timed_rows) < len(t_s):
        first = table.lines[np.flatnonzero(~np.isfinite(t_s))[0]]
        remarks.append(f"{len(t_s) - len(timed_rows)} rows have no time and are left out (line {first})")
    with prefix_errors(table.path):
        inspected = build_recording(
            serial,
            present["t_s"],
            present["output"],
            sample_rate_Hz=rate_Hz,
            output_unit=output_unit,
            stage_mm=present.get(STAGE),
            reference=present.get("reference"),
            lines=table.lines[timed_rows],
            config=config,
        )
    return FileRecording(table, inspected, columns, timed_rows[inspected.rows], tuple(remarks))


def _columns(table: Table, names: ColumnNames, *, with_reference: bool) -> dict[str, Array]:
    """Return `output` and, where they are asked for or there, `reference` and `stage_mm`, each (n,)."""
    columns = {"output": table.numbers(names.output)}
    if with_reference:
        columns["reference"] = table.numbers(names.reference)
    if names.stage is not None and (names.stage != STAGE or table.has(STAGE)):
        columns[STAGE] = table.numbers(names.stage)
    return columns


def read_columns(path: Path, names: ColumnNames, *, with_reference: bool) -> tuple[dict[str, Array], Start | None]:
    """Return `output`, `lines` and, where the table has them, `t_s`, `reference` and `stage_mm`, and when they begin.

    Each column is (n,); NaN for a missing value; rows without a time are left out.

    Raises:
        InputError: the file is no table, or lacks a column.
    """
    table, names = read_timed_table(path, names, partial(names.is_requested, with_reference=with_reference))
    columns = {**_columns(table, names, with_reference=with_reference), "lines": table.lines.astype(np.float64)}
    clock = find_clock(table, names, names.rate_Hz)
    if clock is not None:
        columns["t_s"] = clock.seconds(table)
    has_time = np.isfinite(columns.get("t_s", np.zeros(len(table))))
    return {name: values[has_time] for name, values in columns.items()}, None if clock is None else clock.start


@contextmanager
def prefix_errors(path: Path) -> Iterator[None]:
    """Prepend the file's name to the text of any `InputError` raised inside the block."""
    try:
        yield
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from error


def write_columns(path: Path, columns: Sequence[tuple[str, Array | Sequence[str]]]) -> None:
    """Write columns as CSV or, by the name, Parquet; whole or not at all. NaN stays empty."""
    with atomic_file(path) as part:
        if path.suffix.lower() in PARQUET:
            import pandas as pd

            pd.DataFrame(dict(columns)).to_parquet(part, index=False, write_page_checksum=True)
            return
        cells = [[None if cell != cell else cell for cell in np.asarray(values, dtype=object)] for _, values in columns]
        with part.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([name for name, _ in columns])
            writer.writerows(zip(*cells, strict=True))


def write_rows(path: Path, file: FileRecording, rows: tuple[int, int] | None = None) -> None:
    """Write the rows of a recording that have a time in the format of a lot folder, empty cells empty.

    Args:
        rows: (start, stop) of data rows, counted from 0; None takes all.

    Raises:
        InputError: the table has not so many rows.
    """
    start, stop = rows or (0, len(file.t_s))
    if not 0 <= start < stop <= len(file.t_s):
        raise InputError(f"rows {start}:{stop} of {file.recording.serial}: it has {len(file.t_s)} rows")
    chosen = np.arange(start, stop)
    chosen = chosen[np.isfinite(file.t_s[chosen])]
    write_columns(path, [(name, values[chosen]) for name, values in file.columns.items()])


def replace_table(path: Path, write: Callable[[Path], None]) -> bool:
    """Write a table as the only one of its serial in its folder; return whether one was there."""
    path.parent.mkdir(exist_ok=True)
    older = [file for file in path.parent.iterdir() if normalize("NFC", file.stem) == path.stem]
    write(path)
    for file in older:
        if file != path:
            file.unlink()
    return bool(older)


def write_recording(path: Path, recording: OutputRecording | LabelledRecording) -> None:
    """Write a recording in the format of a lot folder: `t_s, output`, reference and stage."""
    raw = recording.unlabelled if isinstance(recording, LabelledRecording) else recording
    columns = [("t_s", raw.t_s), ("output", raw.output)]
    if isinstance(recording, LabelledRecording):
        columns.append(("reference", recording.reference))
    if raw.stage_mm is not None:
        columns.append((STAGE, raw.stage_mm))
    write_columns(path, columns)
