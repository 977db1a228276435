"""Declared layout of a table; undeclared parts are detected."""

from dataclasses import dataclass

MAX_CELLS = 20_000_000
"""A table with more is refused before it is read: few kB of Parquet can hold 1.5 GB of text."""


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """Declared layout of a table; None means detection.

    Args:
        delimiter: separator of cells of a text file: one character, or "tab" or "blanks".
        decimal: "." or ",".
        encoding: name of a text encoding, such as "utf-16" or "latin-1".
        header_row: line of the file that holds the names of the columns, counted from 1; 0 where no line does.
        sheet: name of a sheet of a workbook, of a group of a .tdms or .h5 file, or of a variable of a .mat file.
        time_format: unit of the time column ("s", "ms", "us", "ns", "min"), "iso", "excel", or a strptime pattern.
        missing: texts of a missing sample, in addition to an empty cell and NaN.
        max_cells: a larger table is refused before it is read.
    """

    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    header_row: int | None = None
    sheet: str | None = None
    time_format: str | None = None
    missing: tuple[str, ...] = ()
    max_cells: int = MAX_CELLS


DETECT = TableOptions()
"""Nothing is declared."""
