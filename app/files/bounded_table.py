"""Tables of CSV, Parquet and Excel, no larger than allowed: counted before they are read.

A few kB can unpack to more than any memory holds: repeated values of Parquet, a spreadsheet whose only cell stands in
its last row. What is counted is what the reader would have to make, never what the file says of itself alone.
"""

import csv
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO
from zipfile import BadZipFile, ZipFile

from softcal.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

CSV, PARQUET, EXCEL = {".csv", ".txt", ".tsv"}, {".parquet", ".pq"}, {".xlsx", ".xlsm"}

MOST_CELLS = 20_000_000
"""A table with more is refused before it is read: few kB of Parquet can hold 1.5 GB of text."""

CSV_BYTES_PER_CELL = 25
"""More bytes no number takes as text, with what parts it from the next one."""

EXCEL_BYTES_PER_CELL = 20
"""Fewer bytes no cell of a sheet's XML takes; a usual one takes 40."""

EXCEL_CELLS_SHARE = 0.1
"""Excel cells cost ten times as long to read as others: as many are allowed fewer."""

BYTES_AT_ONCE = 1 << 20
NAMES = "names"
"""Attribute of a table that holds the names of all columns of its file."""

Wanted = Callable[[str], bool]


def parsed(file: BinaryIO, path: Path, sheet: str | None, most_cells: int, wanted: Wanted | None) -> "pd.DataFrame":
    """Return the wanted columns of a table; of a CSV all; where none is wanted the first.

    Raises:
        InputError: too large, or a name twice. Readers raise what they like for a broken file.
    """
    suffix = path.suffix.lower()
    if suffix in PARQUET:
        return _parquet(file, path, most_cells, wanted)
    if suffix in EXCEL:
        return _excel(file, path, sheet, most_cells, wanted)
    return _csv(file, path, most_cells)


def _csv(file: BinaryIO, path: Path, most_cells: int) -> "pd.DataFrame":
    import pandas as pd

    separator = "\t" if path.suffix.lower() == ".tsv" else ","
    size = cells = 0
    while part := file.read(BYTES_AT_ONCE):
        if not size and b"\0" in part[:4096]:
            raise InputError(f"{path}: not a text file; export it as CSV again")
        size += len(part)
        cells += part.count(separator.encode()) + max(part.count(b"\n"), part.count(b"\r"))
        refuse_large(path, max(cells, size // CSV_BYTES_PER_CELL), most_cells)
    file.seek(0)
    header = next((line for line in file if line.strip()), b"").splitlines()
    file.seek(0)
    names = next(csv.reader([header[0].decode("utf-8-sig")], delimiter=separator), []) if header else []
    if len(names) == 1 and ";" in names[0]:
        raise InputError(f"{path}: its cells are separated by ';'; save it with ',' between cells and decimal points")
    _check_names(names, path)
    table = pd.read_csv(file, sep=separator, low_memory=False)
    # Where rows have a cell more than the header pandas takes the first one for a name.
    if not isinstance(table.index, pd.RangeIndex):
        raise InputError(f"{path}: the rows have more cells than the header; give every column a name")
    return table


def _parquet(file: BinaryIO, path: Path, most_cells: int, wanted: Wanted | None) -> "pd.DataFrame":
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    schema = pq.read_schema(file)
    _check_names(schema.names, path)
    names = _asked(schema.names, wanted)
    is_text = (pa.types.is_string, pa.types.is_binary)
    text = [name for name in names if any(is_such(schema.field(name).type) for is_such in is_text)]
    file.seek(0)
    # Equal texts stay one text: a column of them may otherwise unpack to any size.
    opened = pq.ParquetFile(file, page_checksum_verification=True, read_dictionary=text)
    # The footer may lie: the row groups say it again, and pyarrow checks pages against them.
    groups = [opened.metadata.row_group(k) for k in range(opened.metadata.num_row_groups)]
    rows = max(int(opened.metadata.num_rows), sum(int(group.num_rows) for group in groups))
    cells = 0
    for name in names:
        kind = schema.field(name).type
        if pa.types.is_nested(kind):
            raise InputError(f"{path}: column {name!r} holds lists or records where numbers were expected")
        try:
            cells += 1 if name in text else max(1, int(kind.bit_width) // 64)
        except ValueError:
            cells += 1  # A type without a width
    refuse_large(path, rows * cells, most_cells)
    if text:
        # What the file unpacks to, with the columns that nobody asks for. A column's own facts are not looked at: where
        # they contradict the schema, pyarrow ends the whole process there; reading the column refuses them in order.
        # Numbers need no such count: their rows say how much they take.
        refuse_large(path, sum(int(group.total_byte_size) for group in groups) // 8, most_cells)
    table = opened.read(columns=names)
    for name in text:
        # What the texts would take one after another
        lengths = (pc.take(pc.binary_length(chunk.dictionary), chunk.indices) for chunk in table[name].chunks)
        refuse_large(path, sum(int(pc.sum(each).as_py() or 0) for each in lengths) // 8, most_cells)
    whole: pd.DataFrame = table.to_pandas(ignore_metadata=True)
    for name in text:
        whole[name] = whole[name].astype(object)
    whole.attrs[NAMES] = list(schema.names)
    return whole


def _excel(file: BinaryIO, path: Path, sheet: str | None, most_cells: int, wanted: Wanted | None) -> "pd.DataFrame":
    import pandas as pd
    from openpyxl import load_workbook

    most_cells = int(most_cells * EXCEL_CELLS_SHARE)
    try:
        # Nothing reads more of an entry than it says here.
        with ZipFile(file) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except BadZipFile as error:
        raise InputError(f"{path}: not an Excel file; save it as .xlsx again") from error
    file.seek(0)
    refuse_large(path, size // EXCEL_BYTES_PER_CELL, most_cells)
    workbook = load_workbook(file, read_only=True, data_only=True)
    worksheet = workbook.worksheets[0] if sheet is None else workbook[sheet]
    # What the sheet says of its own size is not asked: it makes the reader fill up every row.
    worksheet.reset_dimensions()
    rows = worksheet.iter_rows(values_only=True)
    first = next(rows, ())
    header, count = ["" if name is None else str(name) for name in first], max(1, len(first))
    refuse_large(path, count, most_cells)
    _check_names(header, path)
    names = _asked(header, wanted)
    places, cells = [header.index(name) for name in names], []
    for row in rows:
        count += max(1, len(row))
        refuse_large(path, count, most_cells)
        cells.append([row[k] if k < len(row) else None for k in places])
    while cells and all(cell is None for cell in cells[-1]):
        cells.pop()
    table = pd.DataFrame(cells, columns=names)
    table.attrs[NAMES] = header
    return table


def _asked(names: Sequence[str], wanted: Wanted | None) -> list[str]:
    asked = [name for name in names if name and (wanted is None or wanted(name))]
    return asked or list(islice(names, 1))


def _check_names(names: Sequence[str], path: Path) -> None:
    """Refuse a name that stands twice: readers would call the second one `output.1` and go on."""
    for name, count in Counter(names).items():
        if count > 1 and name not in ("", "nan"):
            raise InputError(f"{path}: more than one column is named {name!r}; rename or remove one")


def refuse_large(path: Path, cells: int, most_cells: int) -> None:
    """Refuse a table with more cells than allowed."""
    if cells > most_cells:
        raise InputError(
            f"{path}: unpacks to about {cells / 1e6:.3g} million cells, more than {most_cells / 1e6:g} million; split "
            "it, or raise the limit of the import (most cells)"
        )
