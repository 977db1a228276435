"""A table as read: named columns, the line of each row, the layout that was detected."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cell = str | float | int | bool | None
"""One cell of a grid: text, a number, or None where it is empty. Spreadsheets also give datetime, date and time."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells in rows, before anybody has said which of them are names: a text file or a sheet.

    Args:
        rows: cells of each row; rows may have unequal lengths.
        lines: line of the file (row of the sheet) of each row, counted from 1.
    """

    rows: Sequence[Sequence[Any]]
    lines: Sequence[int]


@dataclass(frozen=True, eq=False)
class Column:
    """One column as its file holds it.

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
        layout: what was detected, in one line: "tabs; decimal comma; header in line 7; units in line 8".
        remarks: what a person should know, one sentence each.
    """

    path: Path
    columns: tuple[Column, ...]
    names: tuple[str, ...]
    lines: NDArray[np.int64]
    layout: str = ""
    remarks: tuple[str, ...] = field(default=())
