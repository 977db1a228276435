"""Tables on disk (CSV, Parquet, Excel) into columns of numbers; every error names file, line and column."""

import csv
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from zipfile import BadZipFile, ZipFile

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array, LabelledRecording, OutputRecording

if TYPE_CHECKING:
    import pandas as pd

CSV, PARQUET, EXCEL = {".csv", ".txt", ".tsv"}, {".parquet", ".pq"}, {".xlsx", ".xlsm"}
SUFFIXES = CSV | PARQUET | EXCEL

MOST_CELLS = 20_000_000
"""A table with more cells is refused before it is read: a few kB of Parquet can hold them. As text they take 1.5 GB."""

EXCEL_BYTES_PER_CELL = 20
"""Fewer bytes no cell of a sheet's XML takes; a usual one takes 40."""

EXCEL_CELLS_SHARE = 0.1
"""Excel cells cost ten times as long to read as others: as many are allowed fewer."""


@dataclass(frozen=True)
class ColumnNames:
    """Which columns of a table hold a recording's output and time.

    Args:
        output: name of the output column.
        time: name of the column of time in s; None makes the time from `rate_Hz`.
        rate_Hz: samples a second, where there is no column of time.

    Raises:
        InputError: neither a column of time nor a rate.
    """

    output: str = "output"
    time: str | None = "t_s"
    rate_Hz: float | None = None

    def __post_init__(self) -> None:
        if self.time is None and not (self.rate_Hz is not None and 0 < self.rate_Hz < float("inf")):
            raise InputError("there is neither a column of time nor a positive sample rate; give one of them")


PLAIN = ColumnNames()


def read_table(
    path: Path, sheet: str | None = None, content: bytes | None = None, most_cells: int = MOST_CELLS
) -> "pd.DataFrame":
    """Read a whole table without interpreting it further than the file format does.

    Args:
        most_cells: a table with more is refused before it is read.
        sheet: of an Excel file; None takes the first.
        content: the bytes of the file where somebody has read them already, maybe on another machine.

    Raises:
        InputError: the file is missing, empty, or not a table of its format.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: {suffix or 'no'} suffix; one of {', '.join(sorted(SUFFIXES))} was expected")
    if content is None and not path.is_file():
        raise InputError(f"{path}: there is no such file")
    if (path.stat().st_size if content is None else len(content)) == 0:
        raise InputError(f"{path}: the file is empty")
    try:
        with path.open("rb") if content is None else BytesIO(content) as file:
            table = _parsed(file, path, sheet, most_cells)
    except InputError:
        raise
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not a text file (byte {error.start} is not UTF-8); export it as CSV again"
        ) from error
    # The readers raise many kinds for a damaged file; whatever it was, this file is no such table.
    except Exception as error:
        what = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
        raise InputError(f"{path}: cannot be read as a {suffix[1:]} table: {what}") from error
    if table.empty:
        raise InputError(f"{path}: there is no row of data below the header")
    return table


def _parsed(file: BinaryIO, path: Path, sheet: str | None, most_cells: int) -> "pd.DataFrame":
    import pandas as pd

    suffix = path.suffix.lower()
    if suffix in PARQUET:
        _check_parquet_size(file, path, most_cells)
        return pd.read_parquet(file, page_checksum_verification=True)
    if suffix in EXCEL:
        _check_unpacked_size(file, path, most_cells)
        sheet_name = sheet if sheet is not None else 0
        _check_names(pd.read_excel(file, sheet_name=sheet_name, header=None, nrows=1).iloc[0].astype(str), path)
        return pd.read_excel(file, sheet_name=sheet_name)
    _check_text(file, path)
    separator = "\t" if suffix == ".tsv" else ","
    _check_names(_header(file, separator), path)
    table = pd.read_csv(file, sep=separator, low_memory=False)
    # Where rows have a cell more than the header pandas takes the first one for a name, and columns shift.
    if not isinstance(table.index, pd.RangeIndex):
        raise InputError(f"{path}: the rows have more cells than the header; give every column a name")
    return table


def _header(file: BinaryIO, separator: str) -> list[str]:
    """Return the names of the first line that is not empty, and go back to the beginning."""
    line = next((line for line in file if line.strip()), b"").splitlines()
    file.seek(0)
    return next(csv.reader([line[0].decode("utf-8-sig")], delimiter=separator), []) if line else []


def _check_names(names: Iterable[str], path: Path) -> None:
    """Refuse a name that stands twice: readers would call the second one `output.1` and go on."""
    for name, count in Counter(names).items():
        if count > 1 and name not in ("", "nan"):
            raise InputError(f"{path}: more than one column is named {name!r}; rename or remove one")


def _check_parquet_size(file: BinaryIO, path: Path, most_cells: int) -> None:
    import pyarrow.parquet

    facts = pyarrow.parquet.ParquetFile(file).metadata
    # The footer may lie: the row groups say it again, and what a page really holds pyarrow checks against them.
    groups = [facts.row_group(k) for k in range(facts.num_row_groups)]
    rows = max(facts.num_rows, sum(group.num_rows for group in groups))
    _refuse_large(path, rows * facts.num_columns, most_cells)
    _refuse_large(path, sum(group.total_byte_size for group in groups) // 8, most_cells)
    file.seek(0)


def _check_text(file: BinaryIO, path: Path) -> None:
    if b"\0" in file.read(4096):
        raise InputError(f"{path}: not a text file; export it as CSV again")
    file.seek(0)


def _check_unpacked_size(file: BinaryIO, path: Path, most_cells: int) -> None:
    try:
        with ZipFile(file) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except BadZipFile as error:
        raise InputError(f"{path}: not an Excel file; save it as .xlsx again") from error
    _refuse_large(path, size // EXCEL_BYTES_PER_CELL, int(most_cells * EXCEL_CELLS_SHARE))
    file.seek(0)


def _refuse_large(path: Path, cells: int, most_cells: int) -> None:
    if cells > most_cells:
        raise InputError(
            f"{path}: unpacks to about {cells / 1e6:.3g} million cells, more than {most_cells / 1e6:g} million; split "
            "it, or raise the limit of `softcal import` with --most-cells"
        )


def named_column(table: "pd.DataFrame", name: str, path: Path) -> "pd.Series[Any]":
    """Return one column as it stands in the file.

    Raises:
        InputError: the column is missing or stands there twice.
    """
    names = [str(c) for c in table.columns]
    if names.count(name) != 1:
        seen = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
        problem = "there is no column" if name not in names else "more than one column is named"
        raise InputError(f"{path}: {problem} {name!r}; the file has: {seen}")
    return table.iloc[:, names.index(name)]


def column(table: "pd.DataFrame", name: str, path: Path) -> Array:
    """Return one column as finite numbers.

    Raises:
        InputError: the column is missing, stands there twice, or holds something that is not a finite number.
    """
    import pandas as pd

    raw = named_column(table, name, path)
    truth = [value for value in raw if isinstance(value, bool)] if raw.dtype == object else []
    is_time = pd.api.types.is_datetime64_any_dtype(raw) or pd.api.types.is_timedelta64_dtype(raw)
    if pd.api.types.is_bool_dtype(raw) or truth or is_time:
        value = truth[0] if truth else raw.iloc[0]
        raise InputError(f"{path}: column {name!r} holds {shown(value)} where numbers were expected")
    values: Array = pd.to_numeric(raw, errors="coerce").to_numpy(dtype=np.float64, copy=True)
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        row = int(bad[0])
        more = f" ({len(bad)} such rows)" if len(bad) > 1 else ""
        raise InputError(
            f"{path}: line {row + 2}, column {name!r}: {shown(raw.iloc[row])} where a finite number was expected"
            f"{more}; measure again, or remove the row if it was never a sample"
        )
    return values


def shown(value: object) -> str:
    """Return a cell of a table as an error message shows it."""
    text = str(value)
    return "nothing or nan" if text in ("nan", "None", "<NA>") else repr(text[:40])


def read_recording(
    path: Path,
    serial: str,
    sample_rate_Hz: float | None,
    output_unit: str = "V",
    content: bytes | None = None,
    names: ColumnNames = PLAIN,
) -> OutputRecording:
    """Read `t_s, output` (and `stage_mm` where there is one). Any other column, a reference too, is not looked at.

    Args:
        sample_rate_Hz: the declared rate; None takes the median rate of the time stamps.
        content: the bytes of the file where somebody has read them already.
        names: of the columns, where they are called otherwise.
    """
    return _recording(read_table(path, content=content), path, serial, sample_rate_Hz, output_unit, names)


def read_labelled(
    path: Path,
    serial: str,
    sample_rate_Hz: float | None,
    units: tuple[str, str] = ("V", "N"),
    content: bytes | None = None,
) -> LabelledRecording:
    """Read `t_s, output, reference`.

    Args:
        sample_rate_Hz: the declared rate; None takes the median rate of the time stamps.
        units: of output and reference.
        content: the bytes of the file where somebody has read them already.
    """
    output_unit, reference_unit = units
    table = read_table(path, content=content)
    unlabelled = _recording(table, path, serial, sample_rate_Hz, output_unit)
    return LabelledRecording(unlabelled, column(table, "reference", path), reference_unit)


def _recording(
    table: "pd.DataFrame",
    path: Path,
    serial: str,
    sample_rate_Hz: float | None,
    output_unit: str,
    names: ColumnNames = PLAIN,
) -> OutputRecording:
    output = column(table, names.output, path)
    t_s = np.arange(len(output)) / (names.rate_Hz or 1.0) if names.time is None else column(table, names.time, path)
    stage_mm = column(table, "stage_mm", path) if "stage_mm" in table.columns else None
    with naming(path):
        return OutputRecording(serial, t_s, output, sample_rate_Hz or _median_rate_Hz(t_s), output_unit, stage_mm)


def _median_rate_Hz(t_s: Array) -> float:
    steps = np.diff(t_s)
    return 1.0 / float(np.median(steps[steps > 0])) if np.any(steps > 0) else float("nan")


class naming:
    """Put the file's name before the text of any `InputError` raised inside the block."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, InputError) and str(self._path) not in str(error):
            raise InputError(f"{self._path}: {error}") from error


def write_columns(path: Path, columns: Sequence[tuple[str, Array | Sequence[str]]]) -> None:
    """Write columns as CSV or, where `path` ends in .parquet, as Parquet; whole or not at all. NaN stays empty."""
    import pandas as pd

    from softcal.app.files.atomic import whole_file

    table = pd.DataFrame(dict(columns))
    with whole_file(path) as part:
        if path.suffix.lower() in PARQUET:
            table.to_parquet(part, index=False, write_page_checksum=True)
        else:
            table.to_csv(part, index=False, lineterminator="\n")
