"""Grids of cells, as sheets hold them, into tables: which sheet, which columns, where the data end."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.headings import IsRequested, data_rows, find_heading, refuse_duplicates
from softcal.app.tables.numbers import MAX_SUMMARY_ROWS, Kind, cell_kind, is_summary, show_cell
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Column, Grid, Table
from softcal.core.errors import InputError

HEAD_ROWS = 600
"""Rows that the heading is looked for in."""

CELLS_SHARE = 0.1
"""Cells of a sheet cost ten times as long to read as others: as many are allowed fewer."""

BYTES_PER_CELL = 20
"""Fewer bytes no cell of a sheet's XML takes; a usual one takes 40."""

MIN_ROWS = 2
"""Fewer rows of data are no table where one of several sheets is looked for."""


def grid_table(grid: Grid, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Return the table in a grid.

    Raises:
        InputError: there is no row of data, a name twice, or a row with more cells than the header.
    """
    filled = [k for k, row in enumerate(grid.rows) if any(cell_kind(cell) is not Kind.EMPTY for cell in row)]
    rows, lines = [grid.rows[k] for k in filled], [int(grid.lines[k]) for k in filled]
    head = rows[:HEAD_ROWS]
    decimal = _detect_decimal(head, path, options)
    heading = find_heading(head, lines, path, decimal=decimal, declared=options.header_row, is_requested=is_requested)
    refuse_duplicates(heading.names, path, is_requested)
    if heading.first >= len(rows):
        raise InputError(f"{path}: there is no row of data below the header")
    _, text_columns, _ = data_rows(head[heading.first :], decimal)
    remarks = list(grid.remarks)
    stop = _end_of_data(rows, heading.first, text_columns, decimal)
    if stop < len(rows):
        skipped_cell = next(show_cell(cell) for cell in rows[stop] if cell is not None)
        remarks.append(f"rows {lines[stop]} to {lines[-1]}: no rows of data and left out ({skipped_cell})")
    rows, lines = rows[heading.first : stop], lines[heading.first : stop]
    width = len(heading.names)
    for row, line in zip(rows, lines, strict=True):
        if any(cell_kind(cell) is not Kind.EMPTY for cell in row[width:]):
            raise InputError(
                f"{path}: row {line} has cells right of the last heading ({show_cell(row[width])}); give every "
                "column a name"
            )
    indices = [k for k, name in enumerate(heading.names) if is_requested is None or is_requested(name)] or [0]
    columns = tuple(Column(heading.names[k], heading.units[k], _cells(rows, k)) for k in indices)
    layout = [grid.layout] if grid.layout else []
    layout += ["decimal comma"] if decimal == "," else []
    layout += heading.describe([int(grid.lines[k]) for k in filled])
    line_numbers = np.array(lines, dtype=np.int64)
    return Table(path, columns, heading.names, line_numbers, "; ".join(layout), tuple(remarks), decimal)


def _detect_decimal(rows: Sequence[Sequence[Any]], path: Path, options: TableOptions) -> str:
    """Return the decimal mark of the numbers that a sheet stores as text."""
    if options.decimal is not None:
        return options.decimal
    texts = [cell.strip() for row in rows for cell in row if isinstance(cell, str)]
    commas = [text for text in texts if "," in text and cell_kind(text, ",") is Kind.NUMBER]
    points = [text for text in texts if "." in text and cell_kind(text, ".") is Kind.NUMBER]
    return "," if len(commas) > 1 and not points else "."


def _end_of_data(rows: Sequence[Sequence[Any]], first: int, text_columns: frozenset[int], decimal: str) -> int:
    stop = len(rows)
    while stop > first:
        kinds = [cell_kind(cell, decimal) for cell in rows[stop - 1]]
        if is_summary(rows[stop - 1]) and 0 not in text_columns and len(rows) - stop < MAX_SUMMARY_ROWS:
            stop -= 1
            continue
        stray = [k for k, kind in enumerate(kinds) if kind is Kind.TEXT and k not in text_columns]
        if not stray or Kind.NUMBER in kinds or Kind.STAMP in kinds:
            break
        stop -= 1
    return stop


def _cells(rows: Sequence[Sequence[Any]], k: int) -> NDArray[Any]:
    cells = np.empty(len(rows), dtype=object)
    for number, row in enumerate(rows):
        cell = row[k] if k < len(row) else None
        cells[number] = None if isinstance(cell, str) and not cell.strip() else cell
    return cells


def choose_sheet(
    path: Path, heads: Mapping[str, Sequence[Sequence[Any]]], options: TableOptions, is_requested: IsRequested
) -> tuple[str, tuple[str, ...]]:
    """Return the requested sheet, with a remark if the workbook has several.

    Args:
        heads: first rows of each sheet, in the order of the workbook.

    Raises:
        InputError: no such sheet, or several that hold a table.
    """
    names = ", ".join(map(repr, list(heads)[:8]))
    if options.sheet is not None:
        if options.sheet not in heads:
            raise InputError(f"{path}: there is no sheet {options.sheet!r}; it has {names}; name one with --sheet")
        return options.sheet, ()
    tables = {name: rows for name, rows in heads.items() if len(data_rows(rows)[0]) >= MIN_ROWS}
    if len(tables) > 1 and is_requested is not None:
        cells = {
            name: [cell.strip() for row in rows for cell in row if isinstance(cell, str)]
            for name, rows in tables.items()
        }
        tables = {name: rows for name, rows in tables.items() if any(map(is_requested, cells[name]))} or tables
    if len(tables) > 1:
        several = ", ".join(map(repr, list(tables)[:8]))
        raise InputError(f"{path}: more than one sheet holds a table: {several}; name one with --sheet")
    chosen = next(iter(tables or heads))
    remark = f"of the sheets {names} only {chosen!r} holds such a table; it was read"
    return chosen, (remark,) if len(heads) > 1 else ()
