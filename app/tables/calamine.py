"""Sheets of .xls and .ods, as rows of cells."""

import json
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree.ElementTree import iterparse
from zipfile import ZipFile

from softcal.app.tables import sheet_process
from softcal.app.tables.arrays import refuse_large
from softcal.app.tables.grid import BYTES_PER_CELL, CELLS_SHARE, HEAD_ROWS, choose_sheet
from softcal.app.tables.headings import IsRequested
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Grid
from softcal.core.errors import InputError

BYTES_AT_ONCE = 1 << 20
MAX_READING_S = 300
TABLE = "{urn:oasis:names:tc:opendocument:xmlns:table:1.0}"
ROW, CELLS = f"{TABLE}table-row", (f"{TABLE}table-cell", f"{TABLE}covered-table-cell")
REPEATED_ROW, REPEATED_CELL = f"{TABLE}number-rows-repeated", f"{TABLE}number-columns-repeated"


def read_calamine(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Grid:
    """Return the cells of the declared sheet, or of the only sheet with a table.

    Raises:
        InputError: no such sheet, several with a table, a password, a damaged file, or too many cells.
    """
    max_cells, content = int(options.max_cells * CELLS_SHARE), file.read()
    if path.suffix.lower() == ".ods":
        _check_ods(path, content, max_cells)
    sheets = _sheets(path, content, max_cells)
    heads = {name: rows[:HEAD_ROWS] for name, rows in sheets.items()}
    name, remarks = choose_sheet(path, heads, options, is_requested)
    rows = [[None if cell == "" else cell for cell in row] for row in sheets[name]]
    return Grid(rows, range(1, len(rows) + 1), f"sheet {name!r}" if len(sheets) > 1 else "", remarks)


def _sheets(path: Path, content: bytes, max_cells: int) -> dict[str, list[list[Any]]]:
    # Imported only to say what is to be installed where it is missing.
    import python_calamine  # noqa: F401

    command = [sys.executable, "-I", sheet_process.__file__, str(max_cells)]
    try:
        process = subprocess.run(command, input=content, capture_output=True, timeout=MAX_READING_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{path}: not read within {MAX_READING_S} s; save it as CSV") from error
    if process.returncode:
        if b"PasswordError" in process.stderr:
            raise InputError(f"{path}: it is protected by a password; save it without one")
        raise InputError(f"{path}: damaged, or not a workbook of its format; save it again as .xlsx or CSV")
    sheets = json.loads(process.stdout, object_hook=sheet_process.decode)
    if isinstance(sheets, int):
        refuse_large(path, sheets, max_cells)
        raise InputError(f"{path}: there is no sheet in this workbook")
    return dict(sheets)


def _check_ods(path: Path, content: bytes, max_cells: int) -> None:
    """Refuse a document that unpacks to too much: repeated cells, a cell far out, an archive that lies of its size."""
    with ZipFile(BytesIO(content)) as archive:
        refuse_large(path, sum(entry.file_size for entry in archive.infolist()) // BYTES_PER_CELL, max_cells)
        for entry in archive.infolist():
            # Reading checks the checksum: of an entry that is larger than it says the reading fails.
            with archive.open(entry) as part:
                while part.read(BYTES_AT_ONCE):
                    pass
        with archive.open("content.xml") as part:
            _check_repeats(part, path, max_cells)


def _check_repeats(content: Any, path: Path, max_cells: int) -> None:
    height = width = last_row = 0
    for event, element in iterparse(content, ("start", "end")):
        if event == "start" and element.tag == f"{TABLE}table":
            height = width = last_row = 0
        if event == "end" and element.tag == ROW:
            column = last_column = 0
            for cell in element:
                if cell.tag in CELLS:
                    column += int(cell.get(REPEATED_CELL, "1"))
                    is_filled = len(cell) > 0 or any(not key.startswith(TABLE) for key in cell.attrib)
                    last_column = column if is_filled else last_column
            height += int(element.get(REPEATED_ROW, "1"))
            if last_column:
                last_row, width = height, max(width, last_column)
                refuse_large(path, last_row * width, max_cells)
            element.clear()
