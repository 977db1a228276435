"""Tables on disk (CSV, Parquet, Excel) into columns of numbers; errors name file and line."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.files.bounded_table import CSV, EXCEL, MOST_CELLS, NAMES, PARQUET, Wanted, parsed
from softcal.core.errors import InputError
from softcal.core.recording import Array, LabelledRecording, OutputRecording

if TYPE_CHECKING:
    import pandas as pd

SUFFIXES = CSV | PARQUET | EXCEL


@dataclass(frozen=True)
class ColumnNames:
    """Which columns of a table hold a recording's output and time.

    Args:
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
STAGE = "stage_mm"


def read_table(
    path: Path,
    sheet: str | None = None,
    content: bytes | None = None,
    most_cells: int = MOST_CELLS,
    wanted: Wanted | None = None,
) -> "pd.DataFrame":
    """Read a table without interpreting it further than the file format does.

    Args:
        content: the bytes of the file where somebody has read them already.
        wanted: tells whether a column is asked for: others of Parquet and Excel are not read.

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
            table = parsed(file, path, sheet, most_cells, wanted)
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


def named_column(table: "pd.DataFrame", name: str, path: Path, cure: str = "") -> "pd.Series[Any]":
    """Return one column as it stands in the file; `cure` says what else helps where it is missing.

    Raises:
        InputError: the column is missing or stands there twice.
    """
    names = [str(c) for c in table.columns]
    if names.count(name) != 1:
        there = table.attrs.get(NAMES, names)
        seen = ", ".join(there[:12]) + (", ..." if len(there) > 12 else "")
        problem = "there is no column" if name not in names else "more than one column is named"
        raise InputError(f"{path}: {problem} {name!r}; the file has: {seen}; name the one that is meant{cure}")
    return table.iloc[:, names.index(name)]


def timed(table: "pd.DataFrame", name: str | None, rate_Hz: float, path: Path) -> Array:
    """Return the time in s as finite numbers; made from the rate where no column is named."""
    if name is None:
        return np.arange(len(table)) / rate_Hz
    return column(table, name, path, ", or give the sample rate")


def column(table: "pd.DataFrame", name: str, path: Path, cure: str = "") -> Array:
    """Return one column as finite numbers; `cure` says what else helps where it is missing.

    Raises:
        InputError: it is missing, stands there twice, or holds no finite number.
    """
    import pandas as pd

    raw = named_column(table, name, path, cure)
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
    """Read `t_s, output` (and `stage_mm` where there is one); no other column is looked at. Without
    a declared rate the median one of the time stamps is taken.
    """
    asked = {names.output, names.time, STAGE}
    table = read_table(path, content=content, wanted=asked.__contains__)
    return _recording(table, path, serial, sample_rate_Hz, output_unit, names)


def read_labelled(
    path: Path,
    serial: str,
    sample_rate_Hz: float | None,
    units: tuple[str, str] = ("V", "N"),
    content: bytes | None = None,
) -> LabelledRecording:
    """Read `t_s, output, reference`."""
    output_unit, reference_unit = units
    asked = {PLAIN.output, PLAIN.time, "reference", STAGE}
    table = read_table(path, content=content, wanted=asked.__contains__)
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
    t_s = timed(table, names.time, names.rate_Hz or 1.0, path)
    stage_mm = column(table, STAGE, path) if STAGE in table.columns else None
    if not sample_rate_Hz:
        steps = np.diff(t_s)
        sample_rate_Hz = 1.0 / float(np.median(steps[steps > 0])) if np.any(steps > 0) else float("nan")
    with naming(path):
        return OutputRecording(serial, t_s, output, sample_rate_Hz, output_unit, stage_mm)


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
    """Write columns as CSV or, by the name, Parquet; whole or not at all. NaN stays empty."""
    import pandas as pd

    from softcal.app.files.atomic import whole_file

    table = pd.DataFrame(dict(columns))
    with whole_file(path) as part:
        if path.suffix.lower() in PARQUET:
            table.to_parquet(part, index=False, write_page_checksum=True)
        else:
            table.to_csv(part, index=False, lineterminator="\n")


def replace_recording(folder: Path, serial: str, suffix: str, recording: OutputRecording | LabelledRecording) -> bool:
    """Write a recording as the only one of its serial in a folder; return whether one was there."""
    folder.mkdir(exist_ok=True)
    path, older = folder / f"{serial}{suffix}", [file for file in folder.iterdir() if file.stem == serial]
    write_recording(path, recording)
    for file in older:
        if file != path:
            file.unlink()
    return bool(older)


def write_recording(path: Path, recording: OutputRecording | LabelledRecording, reference: Array | None = None) -> None:
    """Write a recording as a lot folder holds it: `t_s, output`, reference and stage; a reference
    given apart, (n,), was not checked with its output.
    """
    if isinstance(recording, LabelledRecording):
        reference = recording.reference
        recording = recording.unlabelled
    columns = [("t_s", recording.t_s), ("output", recording.output)]
    if reference is not None:
        columns.append(("reference", reference))
    if recording.stage_mm is not None:
        columns.append((STAGE, recording.stage_mm))
    write_columns(path, columns)
