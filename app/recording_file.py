"""Tables on disk (CSV, Parquet, Excel) into columns of numbers; every error names file, line and column."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array, LabelledRecording, OutputRecording

if TYPE_CHECKING:
    import pandas as pd

CSV, PARQUET, EXCEL = {".csv", ".txt", ".tsv"}, {".parquet", ".pq"}, {".xlsx", ".xlsm"}
SUFFIXES = CSV | PARQUET | EXCEL

MAX_UNPACKED_BYTES = 2_000_000_000
"""An Excel file that unpacks to more than this is refused before it is opened."""


def read_table(path: Path, sheet: str | None = None) -> "pd.DataFrame":
    """Read a whole table without interpreting it further than the file format does.

    Raises:
        InputError: the file is missing, empty, or not a table of its format.
    """
    import pandas as pd

    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: {suffix or 'no'} suffix; one of {', '.join(sorted(SUFFIXES))} was expected")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty")
    try:
        if suffix in PARQUET:
            table = pd.read_parquet(path)
        elif suffix in EXCEL:
            _check_unpacked_size(path)
            table = pd.read_excel(path, sheet_name=sheet if sheet is not None else 0)
        else:
            _check_text(path)
            table = pd.read_csv(path, sep="\t" if suffix == ".tsv" else ",", low_memory=False)
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


def _check_text(path: Path) -> None:
    with path.open("rb") as file:
        if b"\0" in file.read(4096):
            raise InputError(f"{path}: not a text file; export it as CSV again")


def _check_unpacked_size(path: Path) -> None:
    try:
        with ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except BadZipFile as error:
        raise InputError(f"{path}: not an Excel file; save it as .xlsx again") from error
    if size > MAX_UNPACKED_BYTES:
        raise InputError(
            f"{path}: unpacks to {size / 1e9:.1f} GB, more than {MAX_UNPACKED_BYTES / 1e9:.0f} GB; split it"
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


def read_recording(path: Path, serial: str, sample_rate_Hz: float | None, output_unit: str = "V") -> OutputRecording:
    """Read `t_s, output` (and `stage_mm` where there is one). Any other column, a reference too, is not looked at.

    Args:
        sample_rate_Hz: the declared rate; None takes the median rate of the time stamps.
    """
    return _recording(read_table(path), path, serial, sample_rate_Hz, output_unit)


def read_labelled(
    path: Path, serial: str, sample_rate_Hz: float | None, output_unit: str = "V", reference_unit: str = "N"
) -> LabelledRecording:
    """Read `t_s, output, reference`."""
    table = read_table(path)
    unlabelled = _recording(table, path, serial, sample_rate_Hz, output_unit)
    return LabelledRecording(unlabelled, column(table, "reference", path), reference_unit)


def _recording(
    table: "pd.DataFrame", path: Path, serial: str, sample_rate_Hz: float | None, output_unit: str
) -> OutputRecording:
    t_s, output = column(table, "t_s", path), column(table, "output", path)
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

    from softcal.app.files import whole_file

    table = pd.DataFrame(dict(columns))
    with whole_file(path) as part:
        if path.suffix.lower() in PARQUET:
            table.to_parquet(part, index=False)
        else:
            table.to_csv(part, index=False, lineterminator="\n")
