"""A table as read: named columns, the line of each row, the layout that was detected."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.encoding import NOT_UTF_8
from softcal.app.tables.numbers import number_cure, show_cell, to_numbers
from softcal.core.errors import InputError
from softcal.core.recording import Array

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells in rows before the detection of a header, from a text file or a sheet.

    Args:
        rows: cells of each row, which may have unequal lengths: text, a number, None, in sheets a date or time.
        lines: line of the file (row of the sheet) of each row, counted from 1.
        layout, remarks: as of a table, where the grid is one of several.
    """

    rows: Sequence[Sequence[Any]]
    lines: Sequence[int]
    layout: str = ""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Column:
    """One column as stored in its file.

    Args:
        name: heading without the blanks around it.
        unit: unit from the heading's brackets or a row of units; "" where the file states none.
        cells: (n,) float64 with NaN for missing samples, datetime64[ns], timedelta64[ns], or object (text, None).
    """

    name: str
    unit: str
    cells: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Table:
    """Named columns of one file.

    Args:
        path: the file, for messages.
        columns: those that were asked for.
        names: all names of the file, asked for or not.
        lines: (n,) line of the file of each row, counted from 1.
        layout: detected layout in one line: "tabs; decimal comma; header in line 7; units in line 8".
        remarks: what a person should know, one sentence each.
        decimal: mark in the texts of its columns.
    """

    path: Path
    columns: tuple[Column, ...]
    names: tuple[str, ...]
    lines: NDArray[np.int64]
    layout: str = ""
    remarks: tuple[str, ...] = field(default=())
    decimal: str = "."

    def __len__(self) -> int:
        return len(self.lines)

    def has(self, name: str) -> bool:
        """Whether a column of this name was read."""
        return any(column.name == name for column in self.columns)

    def column(self, name: str, cure: str = "") -> Column:
        """Return a column by its name; the error for a missing column adds `cure`.

        Raises:
            InputError: unknown name; a name with other capitals is suggested.
        """
        matches = [column for column in self.columns if column.name == name]
        if len(matches) == 1:
            return matches[0]
        encoding = "".join(f"; {remark}" for remark in self.remarks if remark.startswith(NOT_UTF_8))
        raise InputError(f"{self.path}: {missing_column(name, self.names)}{encoding}; name the one that is meant{cure}")

    def numbers(self, name: str, cure: str = "") -> Array:
        """Return a column as (n,) float64, NaN where a sample is missing.

        Raises:
            InputError: there is no such column, or it holds text, a truth value or a date; the line is named.
        """
        column = self.column(name, cure)
        cells = column.cells
        values = to_numbers(cells, self.decimal)
        if values is not None:
            return values
        if cells.dtype.kind == "O":
            bad = [row for row, cell in enumerate(cells) if to_numbers(cells[row : row + 1], self.decimal) is None]
        else:
            bad = list(range(len(cells)))
        cell, more = cells[bad[0]], f" ({len(bad)} such rows)" if len(bad) > 1 else ""
        cure = number_cure(cell, self.decimal)
        if len(bad) > len(cells) / 2 and "--missing" in cure:
            cure = "write plain numbers in it, or name another column"
        raise InputError(
            f"{self.path}: line {self.lines[bad[0]]}, column {name!r}: {show_cell(cell)} where a number was "
            f"expected{more}; {cure}"
        )

    def finite_numbers(self, name: str, cure: str = "") -> Array:
        """Return a column as `numbers` does; an empty cell is refused with its line."""
        values = self.numbers(name, cure)
        missing = np.flatnonzero(np.isnan(values))
        if len(missing):
            raise InputError(
                f"{self.path}: line {self.lines[missing[0]]}, column {name!r}: nothing where a number was "
                "expected; fill in the cell, or remove the row"
            )
        return values

    def to_frame(self) -> "pd.DataFrame":
        """Return the columns as a data frame."""
        import pandas as pd

        return pd.DataFrame({column.name: column.cells for column in self.columns})

    def texts(self, name: str) -> list[str]:
        """Return a column as texts, "" for empty cells; whole numbers without a decimal point."""
        cells = self.column(name).cells.tolist()
        return ["" if cell is None or cell != cell else _text(cell) for cell in cells]


def _text(cell: Any) -> str:
    return str(int(cell)) if isinstance(cell, float) and cell.is_integer() else str(cell).strip()


def missing_column(name: str, names: Sequence[str]) -> str:
    """Return the error for a missing column, with the existing columns, the likeliest first."""
    alike = [other for other in names if other.casefold().strip() == name.casefold().strip() and other != name]
    if alike:
        return f"there is no column {name!r}, it has {', '.join(map(repr, alike))}"
    listed_names = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"there is no column {name!r}; the file has: {listed_names}"
