"""Sheets of .xlsx and .xlsm, as rows of cells; formulas count by the value that is stored with them."""

from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import BadZipFile, ZipFile

from softcal.app.tables.arrays import refuse_large
from softcal.app.tables.grid import BYTES_PER_CELL, CELLS_SHARE, HEAD_ROWS, choose_sheet
from softcal.app.tables.headings import IsRequested
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Grid
from softcal.core.errors import InputError


def read_excel(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Grid:
    """Return the cells of the declared sheet, or of the only sheet with a table.

    Raises:
        InputError: no such sheet, several with a table, a formula without a stored value, or too many cells.
    """
    from openpyxl import load_workbook

    max_cells = int(options.max_cells * CELLS_SHARE)
    try:
        # Nothing reads more of an entry than it says here.
        with ZipFile(file) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except BadZipFile as error:
        raise InputError(f"{path}: not an Excel file; save it as .xlsx again") from error
    file.seek(0)
    refuse_large(path, size // BYTES_PER_CELL, max_cells)
    workbook = load_workbook(file, read_only=True, data_only=True)
    sheets = {worksheet.title: worksheet for worksheet in workbook.worksheets}
    heads = {}
    for name, worksheet in sheets.items():
        # What the sheet says of its own size is not asked: it makes the reader fill up every row.
        worksheet.reset_dimensions()
        is_meant = options.sheet is None and len(sheets) > 1
        heads[name] = list(_rows(worksheet, path, max_cells, HEAD_ROWS)) if is_meant else []
    name, remarks = choose_sheet(path, heads, options, is_requested)
    rows = list(_rows(sheets[name], path, max_cells))
    while rows and all(cell is None for cell in rows[-1]):
        rows.pop()
    if any(cell is None for row in rows for cell in row):
        _refuse_formulas(file, path, name, rows)
    layout = f"sheet {name!r}" if len(sheets) > 1 else ""
    return Grid(rows, range(1, len(rows) + 1), layout, remarks)


def _rows(worksheet: Any, path: Path, max_cells: int, limit: int | None = None) -> Any:
    count = 0
    for row in islice(worksheet.iter_rows(values_only=True), limit):
        count += max(1, len(row))
        refuse_large(path, count, max_cells)
        yield row


def _refuse_formulas(file: BinaryIO, path: Path, name: str, rows: list[Any]) -> None:
    """Refuse a formula without a stored value, which would read as an empty cell."""
    from openpyxl import load_workbook
    from openpyxl.utils import get_column_letter

    file.seek(0)
    worksheet = load_workbook(file, read_only=True)[name]
    worksheet.reset_dimensions()
    for number, (row, values) in enumerate(zip(worksheet.iter_rows(values_only=True), rows, strict=False), 1):
        for k, cell in enumerate(row):
            is_formula = isinstance(cell, str) and cell.startswith("=")
            if is_formula and (k >= len(values) or values[k] is None):
                raise InputError(
                    f"{path}: cell {get_column_letter(k + 1)}{number} is a formula without a stored value; open "
                    "the file in the spreadsheet program and save it there"
                )
