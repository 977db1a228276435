"""Long streams on disk, piece by piece: `t_s, output` in, estimates out."""

import csv
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from softcal.app.files.atomic import whole_file
from softcal.app.files.bounded_table import CSV, PARQUET
from softcal.app.files.recording_file import PLAIN, ColumnNames, named_column, read_table, shown
from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.unit.estimate import Estimate
from softcal.core.windows import TAPS

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetWriter

COLUMNS = ("t_s", "estimate", "lower", "upper", "flag")
"""Of a file of estimates."""

HEADER = f"{','.join(COLUMNS)}\n"
"""First line of such a file as CSV."""

PIECE = 1024
"""Rows read, estimated and written at once."""


def read_stream(path: Path, names: ColumnNames = PLAIN) -> Iterator[tuple[Array, Array]]:
    """Yield `t_s` and `output` in pieces, every row of the file; what is empty is NaN.

    Raises:
        InputError: no such file or columns, a text for a number, or fewer rows than a window.
    """
    rows = 0
    wanted = (names.output,) if names.time is None else (names.time, names.output)
    for columns in _csv_pieces(path, wanted) if path.suffix.lower() in CSV else _table_pieces(path, wanted):
        output = columns[-1]
        t_s = (rows + np.arange(len(output))) / names.rate_Hz if names.rate_Hz and not names.time else columns[0]
        rows += len(output)
        # A first piece this short is the whole file.
        if rows < TAPS:
            raise InputError(f"{path}: {rows} rows; at least {TAPS} are needed to fill one window")
        yield t_s, output


def count_rows(path: Path) -> int:
    """Return about how many rows a file holds; 0 where only reading it would tell."""
    if path.suffix.lower() in PARQUET:
        from pyarrow.lib import ArrowInvalid
        from pyarrow.parquet import read_metadata

        with suppress(ArrowInvalid, OSError):
            return int(read_metadata(path).num_rows)
    elif path.suffix.lower() in CSV and path.is_file():
        with path.open("rb") as file:
            return max(0, sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b"")) - 1)
    return 0


def _table_pieces(path: Path, names: tuple[str, ...]) -> Iterator[tuple[Array, ...]]:
    import pandas as pd

    table = read_table(path)
    columns = []
    for name in names:
        raw = named_column(table, name, path)
        values = pd.to_numeric(raw, errors="coerce").to_numpy(dtype=np.float64)
        text = np.flatnonzero(np.isnan(values) & raw.notna().to_numpy())
        if len(text):
            raise _not_a_number(path, int(text[0]) + 2, name, raw.iloc[text[0]])
        columns.append(values)
    for start in range(0, len(table), PIECE):
        yield tuple(values[start : start + PIECE] for values in columns)


def _csv_pieces(path: Path, names: tuple[str, ...]) -> Iterator[tuple[Array, ...]]:
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            yield from _numbers(path, file, names)
        except UnicodeDecodeError as error:
            raise InputError(
                f"{path}: not a text file (byte {error.start} is not UTF-8); export it as CSV again"
            ) from error
        except csv.Error as error:
            raise InputError(f"{path}: cannot be read as a CSV table: {error}") from error


def _numbers(path: Path, file: IO[str], names: tuple[str, ...]) -> Iterator[tuple[Array, ...]]:
    import pandas as pd

    reader = csv.reader(file, delimiter="\t" if path.suffix.lower() == ".tsv" else ",")
    header = next(reader, None)
    if header is None:
        raise InputError(f"{path}: the file is empty")
    header = [name.strip() for name in header]
    for name in names:
        named_column(pd.DataFrame(columns=header), name, path)
    places = [header.index(name) for name in names]
    piece: list[list[float]] = []
    wrong: InputError | None = None
    for row in reader:
        if wrong is not None:
            raise wrong
        if not row:
            continue
        values = []
        for name, place in zip(names, places, strict=True):
            text = row[place].strip() if place < len(row) else ""
            try:
                values.append(float(text) if text else np.nan)
            except ValueError:
                # A last line may have been cut off; only a further one makes it wrong.
                wrong = wrong or _not_a_number(path, reader.line_num, name, text)
                values.append(np.nan)
        piece.append(values)
        if len(piece) == PIECE:
            yield _columns(piece)
            piece = []
    if piece:
        yield _columns(piece)
    elif reader.line_num <= 1:
        raise InputError(f"{path}: there is no row of data below the header")


def _columns(piece: list[list[float]]) -> tuple[Array, ...]:
    return tuple(np.array(piece).T.copy())


def _not_a_number(path: Path, line: int, name: str, value: object) -> InputError:
    return InputError(
        f"{path}: line {line}, column {name!r}: {shown(value)} is not a number; correct the row or leave it empty"
    )


@contextmanager
def estimate_writer(path: Path) -> Iterator[Callable[[Estimate], None]]:
    """Give what writes estimates piece by piece; `path` appears when the block has ended well."""
    import pandas as pd

    is_parquet, is_first = path.suffix.lower() in PARQUET, True
    with whole_file(path) as part, ExitStack() as stack:
        parquet: ParquetWriter | None = None

        def write(rows: Estimate) -> None:
            nonlocal parquet, is_first
            columns: dict[str, Any] = {name: getattr(rows, name) for name in COLUMNS[:-1]}
            if is_parquet:
                import pyarrow as pa
                from pyarrow.parquet import ParquetWriter

                table = pa.table(columns | {"flag": rows.flag.astype(str)})
                parquet = parquet or stack.enter_context(ParquetWriter(part, table.schema))
                parquet.write_table(table)
                return
            with part.open("a", encoding="utf-8", newline="") as file:
                table = pd.DataFrame(columns | {"flag": rows.flag})
                table.to_csv(file, header=is_first, index=False, lineterminator="\n")
            is_first = False

        yield write
