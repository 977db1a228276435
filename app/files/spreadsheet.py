"""Tables for spreadsheets, as CSV or Excel, in which no cell can run as a formula."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from softcal.app.files.atomic import write_bytes, write_text
from softcal.core.errors import InputError

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
"""Text that starts like this is run by a spreadsheet (OWASP, CSV Injection)."""


def guard_cell(cell: object) -> object:
    """Return a cell that a spreadsheet shows as text: an apostrophe before a formula."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(FORMULA_STARTS) else cell


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV text."""
    text = io.StringIO()
    csv.writer(text).writerows([guard_cell(cell) for cell in row] for row in (header, *rows))
    return text.getvalue()


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table as .csv or .xlsx, whole or not at all.

    Raises:
        InputError: another suffix, or the file cannot be written.
    """
    if path.suffix.lower() == ".csv":
        write_text(path, csv_text(header, rows))
    elif path.suffix.lower() == ".xlsx":
        write_bytes(path, excel_bytes(header, rows))
    else:
        raise InputError(f"{path}: the suffix {path.suffix!r} is not known; give .csv or .xlsx")


def excel_bytes(header: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """Return a table as the bytes of an .xlsx file."""
    from openpyxl import Workbook

    workbook = Workbook(write_only=True)
    sheet = workbook.create_sheet("softcal")
    for row in (header, *rows):
        sheet.append([guard_cell(cell) for cell in row])
    content = io.BytesIO()
    workbook.save(content)
    return content.getvalue()
