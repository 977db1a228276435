"""Reader of tables: a file or its bytes, whatever program wrote it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from softcal.app.extras import missing_extra
from softcal.app.tables.calamine import read_calamine
from softcal.app.tables.columnar import read_arrow, read_parquet
from softcal.app.tables.encoding import is_text
from softcal.app.tables.grid import grid_table
from softcal.app.tables.hdf5 import read_hdf5
from softcal.app.tables.headings import IsRequested
from softcal.app.tables.matlab import read_matlab
from softcal.app.tables.numbers import missing_codes_remark, parse_formatted_numbers, to_numbers
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.spreadsheet import read_excel
from softcal.app.tables.table import Grid, Table
from softcal.app.tables.tdms import read_tdms
from softcal.app.tables.text import read_text, text_pieces
from softcal.core.errors import InputError, SoftcalError

Reader = Callable[[BinaryIO, Path, TableOptions, IsRequested], Grid | Table]
"""Reads a file that is open at its beginning; where requested columns are named, others need not be read."""

TEXT = (".csv", ".txt", ".tsv", ".lvm", ".dat", ".asc", ".log", ".prn", ".tra")
PARQUET = (".parquet", ".pq")
READERS: dict[str, Reader] = {
    **dict.fromkeys(TEXT, read_text),
    **dict.fromkeys(PARQUET, read_parquet),
    **dict.fromkeys((".feather", ".arrow"), read_arrow),
    **dict.fromkeys((".xlsx", ".xlsm"), read_excel),
    **dict.fromkeys((".xls", ".ods"), read_calamine),
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".mat": read_matlab,
    ".tdms": read_tdms,
}
"""Suffix of a file → what reads it."""

COMPRESSED = (".zip", ".gz", ".7z", ".rar", ".bz2", ".xz", ".tgz")
HEAD_BYTES = 4096
TEXT_REMARK = "a text file, whatever its name says; it was read as one"


def read_table(
    path: Path,
    options: TableOptions = DETECT,
    *,
    content: bytes | None = None,
    is_requested: IsRequested = None,
) -> Table:
    """Return a table: names, cells, and detected layout.

    Args:
        content: the bytes of the file, if already read.
        is_requested: tells whether a column is asked for; others are not read where the format allows it.

    Raises:
        InputError: the file is missing, empty, too large, not a table of its format, or has two possible readings.
    """
    with _translate_errors(path, content), path.open("rb") if content is None else BytesIO(content) as file:
        reader = _reader(file, path)
        read = reader(file, path, options, is_requested)
    table = grid_table(read, path, options, is_requested) if isinstance(read, Grid) else read
    if not len(table):
        raise InputError(f"{path}: there is no row of data below the header")
    if reader is read_text and READERS.get(path.suffix.lower(), read_text) is not read_text:
        table = replace(table, remarks=(*table.remarks, TEXT_REMARK))
    return _convert_numbers(table, options)


def column_names(path: Path, options: TableOptions = DETECT) -> tuple[str, ...]:
    """Return the names of all columns of a file."""
    return read_table(path, options, is_requested=lambda name: False).names


def table_pieces(path: Path, options: TableOptions, is_requested: IsRequested, rows: int) -> Iterator[Table]:
    """Yield a table in pieces of about a number of rows for a text file, else in one piece.

    Raises:
        InputError: as `read_table`, for a row that cannot be read once its piece is reached.
    """
    with _translate_errors(path, None), path.open("rb") as file:
        if _reader(file, path) is read_text:
            for table in text_pieces(file, path, options, is_requested, rows):
                yield _convert_numbers(table, options)
            return
    yield read_table(path, options, is_requested=is_requested)


def _reader(file: BinaryIO, path: Path) -> Reader:
    """Return the reader of an open file by its suffix, or the text reader for plain text."""
    head, suffix = file.read(HEAD_BYTES), path.suffix.lower()
    file.seek(0)
    if is_text(head):
        return read_text
    if suffix not in READERS:
        kinds = ", ".join(sorted({*READERS} - {*TEXT}))
        cure = "unpack it" if suffix in COMPRESSED else f"text such as CSV, or one of {kinds} is read"
        raise InputError(f"{path}: no table by its suffix, and no plain text; {cure}")
    return READERS[suffix]


@contextmanager
def _translate_errors(path: Path, content: bytes | None) -> Iterator[None]:
    """Refuse a file that is no table, and turn a reader's exception for a damaged file into one line."""
    if content is None and not path.is_file():
        raise InputError(
            f"{path}: {'a folder where a file was expected' if path.is_dir() else 'there is no such file'}"
        )
    if (path.stat().st_size if content is None else len(content)) == 0:
        raise InputError(f"{path}: the file is empty")
    try:
        yield
    except SoftcalError:
        raise
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: {missing_extra(error) or error}") from error
    except UnicodeError as error:
        raise InputError(f"{path}: not a text file in this encoding; name another with --encoding") from error
    # The readers raise many kinds for a damaged file; whatever it was, this file is no such table.
    except Exception as error:
        message = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: damaged, cut off or no {path.suffix.lower()} file ({message}); export or copy it again"
        ) from error


def _convert_numbers(table: Table, options: TableOptions) -> Table:
    """Return the table with a column of numbers wherever every cell is one."""
    columns, remarks = [], list(table.remarks)
    for column in table.columns:
        cells = to_numbers(column.cells, table.decimal, options.missing)
        formatted_numbers = None
        if cells is None and column.cells.dtype == object:
            formatted_numbers = parse_formatted_numbers(column.cells, table.decimal, options.missing)
        if (cells is not None or formatted_numbers is not None) and column.cells.dtype == object:
            remarks += missing_codes_remark(column.name, column.cells, options.missing)
        if formatted_numbers is not None:
            cells, unit, remark = formatted_numbers
            column = replace(column, unit=column.unit or unit)
            remarks += [f"column {column.name!r}: {remark}"] if remark else []
        if cells is None and options.missing and column.cells.dtype == object:
            absent = [isinstance(cell, str) and cell.strip() in options.missing for cell in column.cells]
            cells = column.cells.copy()
            cells[absent] = None
        columns.append(column if cells is None else replace(column, cells=cells))
    return replace(table, columns=tuple(columns), remarks=tuple(remarks))
