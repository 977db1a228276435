"""Header of a grid: row of names, rows of units, first row of data."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from softcal.app.tables.numbers import MAX_SUMMARY_ROWS, UNITS, Kind, cell_kind, unit_number
from softcal.core.errors import InputError

IsRequested = Callable[[str], bool] | None

MAX_PREAMBLE = 100
"""Lines of a preamble in which rows of numbers may stand."""

BRACKETS = re.compile(r"[(\[{<](?P<unit>[^()\[\]{}<>]*)[)\]}>]\s*$")


@dataclass(frozen=True)
class Heading:
    """Names and units of columns, and where the data begin.

    Args:
        names, units: of each column; without a header row `column_1`, `column_2`, ...
        row: row of the grid that names the columns, None without one.
        unit_rows: rows of units below it.
        first: first row of data.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    row: int | None
    unit_rows: int
    first: int

    def describe(self, lines: Sequence[int]) -> list[str]:
        """Return what differs from a header in the first line, in words."""
        parts = []
        if self.row is None:
            begin = f", data from line {lines[self.first]}" if self.first else ""
            parts.append(f"no header{begin}")
        elif lines[self.row] != 1:
            parts.append(f"header in line {lines[self.row]}")
        if self.row is not None and self.unit_rows == 1:
            parts.append(f"units in line {lines[self.row + 1]}")
        elif self.unit_rows:
            parts.append(f"{self.unit_rows} units rows")
        return parts


def data_rows(rows: Sequence[Sequence[Any]], decimal: str = ".") -> tuple[list[int], frozenset[int], int]:
    """Return which rows hold data, which columns hold text in them, and how many columns have data.

    Rows of data are those of the most frequent form: as many cells, text in the same columns, at least one number.
    """
    Form = tuple[frozenset[int], frozenset[int]]
    forms: dict[int, tuple[int, Form]] = {}
    kinds_of = [[cell_kind(cell, decimal) for cell in row] for row in rows]
    has_units = not any(kind in (Kind.NUMBER, Kind.STAMP) for kinds in kinds_of for kind in kinds)
    if has_units:
        # Every number has its unit behind it.
        kinds_of = [[Kind.NUMBER if unit_number(cell, decimal) else cell_kind(cell) for cell in row] for row in rows]
    for k, kinds in enumerate(kinds_of):
        if Kind.NUMBER in kinds or Kind.STAMP in kinds:
            width = max(n for n, kind in enumerate(kinds) if kind is not Kind.EMPTY) + 1
            form_columns = [
                frozenset(n for n, kind in enumerate(kinds) if kind is one) for one in (Kind.TEXT, Kind.STAMP)
            ]
            forms[k] = width, (form_columns[0], form_columns[1])
    if not forms:
        return [], frozenset(), 0
    counts = Counter(form for _, form in forms.values())
    usual_form = max(counts, key=lambda form: (counts[form], -len(form[0])))
    text = usual_form[0]
    usual_rows = [kinds_of[k] for k, (_, form) in forms.items() if form == usual_form]
    filled = Counter(n for kinds in usual_rows for n, kind in enumerate(kinds) if kind is not Kind.EMPTY)
    frequent_columns = {n for n, count in filled.items() if count > len(usual_rows) / 2}

    def is_usual(k: int, form: Form) -> bool:
        # A stamp that is missing makes another form of the same row; so does a text where others have nothing.
        if form[0] == text:
            return form[1] <= usual_form[1]
        kinds = dict(enumerate(kinds_of[k]))
        return not (form[0] - text) & filled.keys() and all(
            kinds.get(n) in (Kind.NUMBER, Kind.STAMP) for n in frequent_columns - text
        )

    matching_rows = {k for k, (_, form) in forms.items() if is_usual(k, form)}
    widths = Counter(forms[k][0] for k in matching_rows)
    # Empty cells at the end of a row do not count, so that the widest of the frequent ones is the table's.
    width = max(w for w, count in widths.items() if count > 0.02 * sum(widths.values()))
    usual = widths.most_common(1)[0][0]
    data = [k for k, (w, _) in forms.items() if k in matching_rows and min(usual, width) <= w <= width]
    return data, frozenset(range(width)) if has_units else text, width


def find_heading(
    rows: Sequence[Sequence[Any]],
    lines: Sequence[int],
    path: Path,
    *,
    decimal: str = ".",
    declared: int | None = None,
    is_requested: IsRequested = None,
) -> Heading:
    """Return the heading of a grid, of which the first rows are enough.

    Args:
        declared: line that names the columns, 0 where none does; None looks for it.

    Raises:
        InputError: the declared line is none of the file, or two rows may be the header.
    """
    data, _, width = data_rows(rows, decimal)
    first = _first_row(rows, data)
    if declared == 0:
        return _unnamed_heading(rows, width, first)
    if declared is not None:
        row = next((k for k, line in enumerate(lines) if line == declared), None)
        if row is None:
            raise InputError(f"{path}: --header-row {declared}: line {declared} is empty or not among the first lines")
        return _heading_from_row(rows, row, max(row + 1, next((k for k in data if k > row), len(rows))), width, decimal)
    _refuse_counting_row(rows, lines, first, path, is_requested)
    row = _header_row(rows, first, width, decimal, is_requested)
    return _unnamed_heading(rows, width, first) if row is None else _heading_from_row(rows, row, first, width, decimal)


def _first_row(rows: Sequence[Sequence[Any]], data: Sequence[int]) -> int:
    """Return the first row of data.

    One or two rows of numbers with lines of one text behind them are of a preamble; so are a few with other names
    behind them, which are those of a table of results.
    """
    if not data:
        return len(rows)
    first, above = 0, {tuple(row) for row in rows[: data[0]]}
    for k, (row, after) in enumerate(pairwise(data), 1):
        skipped_rows = [[cell for cell in rows[n] if cell] for n in range(row + 1, after)]
        has_single_cells = any(len(cells) == 1 for cells in skipped_rows)
        has_names = any(
            len(cells) > 1 and {cell_kind(cell) for cell in cells} == {Kind.TEXT} and tuple(rows[n]) not in above
            for n, cells in enumerate(skipped_rows, row + 1)
        )
        is_short = (has_single_cells and k - first <= 2) or (has_names and k <= MAX_SUMMARY_ROWS and len(data) > 3 * k)
        if is_short and len(data) - k > 5 and row < MAX_PREAMBLE:
            first = k
    return data[first]


def _header_row(
    rows: Sequence[Sequence[Any]], first: int, width: int, decimal: str, is_requested: IsRequested
) -> int | None:
    texts, full, mixed = list[int](), list[int](), list[int]()
    for k in range(first):
        kinds = [kind for cell in rows[k] if (kind := cell_kind(cell, decimal)) is not Kind.EMPTY]
        if set(kinds) == {Kind.TEXT} and (len(kinds) >= 2 or width <= 1) and len(kinds) >= width / 2:
            texts.append(k)
            if len(kinds) >= width:
                full.append(k)
        elif kinds and _is_mixed_header(rows[k], width, decimal):
            mixed.append(k)
    if is_requested is not None:
        counts = {k: sum(is_requested(_heading_text(cell)) for cell in rows[k]) for k in (*texts, *mixed)}
        matches = [k for k, count in counts.items() if count == max(counts.values()) and count]
        if len(matches) == 1:
            return matches[0]
    names = [k for k in texts if not is_units_row(rows[k])]
    if names:
        best = names[-1]
        later = [k for k in mixed if k > best]
        return later[-1] if later and best not in full else best
    if mixed:
        return mixed[-1]
    return texts[0] if texts else None


def _is_mixed_header(row: Sequence[Any], width: int, decimal: str) -> bool:
    """Return whether a row with numbers is a header: a text first, then integers (numbered units)."""
    cells = [_heading_text(cell) for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    has_text_first = bool(cells) and cell_kind(cells[0], decimal) in (Kind.TEXT, Kind.EMPTY)
    others = [text for text in cells[1:] if cell_kind(text, decimal) is not Kind.TEXT]
    return (
        has_text_first
        and len(cells) >= max(2, width)
        and all(text.isdigit() for text in others)
        and len(set(cells)) == len(cells)
    )


def is_units_row(row: Sequence[Any]) -> bool:
    """Whether every cell of a row is a unit, or nothing."""
    cells = [str(cell).strip() for cell in row if cell is not None and str(cell).strip()]
    return bool(cells) and all(_parse_unit(cell) is not None for cell in cells)


def _parse_unit(cell: str) -> str | None:
    text = cell.strip()
    if match := re.fullmatch(r"[(\[{<]([^()\[\]{}<>]*)[)\]}>]", text):
        return match[1].strip()
    if text.lower() in UNITS or re.fullmatch(r"[-=_]+", text):
        return "" if re.fullmatch(r"[-–—=_]+|n/a|none", text.lower()) else text
    return None


def _heading_from_row(rows: Sequence[Sequence[Any]], row: int, first: int, width: int, decimal: str) -> Heading:
    """Return the heading with its names in `row`; rows of units follow, then data."""
    start = row + 1
    while start < first and not _may_be_data(rows[start], decimal):
        start += 1
    unit_rows = start - row - 1
    cells = [_heading_text(cell) for cell in rows[row]]
    if cells and cells[0].startswith("#"):
        cells[0] = cells[0].lstrip("# ")
    while len(cells) > width and (not cells[-1] or _has_number(rows[row + 1 : start], len(cells) - 1, decimal)):
        # A scope writes the start and the step of its samples here, below names that no row has a cell for.
        cells.pop()
    units = []
    for k, name in enumerate(cells):
        unit_texts = [str(rows[r][k]) for r in range(row + 1, start) if k < len(rows[r]) and rows[r][k] is not None]
        in_name = BRACKETS.search(name)
        parsed_units = [unit for text in unit_texts if (unit := _parse_unit(text))]
        units.append(parsed_units[0] if parsed_units else in_name["unit"].strip() if in_name else "")
    names = [name or f"column_{k}" for k, name in enumerate(cells, 1)]
    return Heading(tuple(names), tuple(units), row, unit_rows, start)


def _has_number(rows: Sequence[Sequence[Any]], k: int, decimal: str) -> bool:
    return any(k < len(row) and cell_kind(row[k], decimal) is Kind.NUMBER for row in rows)


def _may_be_data(row: Sequence[Any], decimal: str) -> bool:
    """Return whether a row below the names is data, even with one text cell; oscilloscopes write numbers with units."""
    kinds = [cell_kind(cell, decimal) for cell in row]
    has_numbers = any(
        kind in (Kind.NUMBER, Kind.STAMP) and _parse_unit(str(cell)) is None
        for cell, kind in zip(row, kinds, strict=True)
    )
    texts = [str(cell) for cell, kind in zip(row, kinds, strict=True) if kind is Kind.TEXT]
    return has_numbers and not (kinds[0] is Kind.TEXT and any(_parse_unit(text) for text in texts[1:]))


def _unnamed_heading(rows: Sequence[Sequence[Any]], width: int, first: int) -> Heading:
    names = tuple(f"column_{k}" for k in range(1, width + 1))
    return Heading(names, ("",) * width, None, 0, first)


def _refuse_counting_row(
    rows: Sequence[Sequence[Any]], lines: Sequence[int], first: int, path: Path, is_requested: IsRequested
) -> None:
    """Refuse an ambiguous first row 0, 1, 2, ...: numbers of columns or a sample."""
    if first >= len(rows) or first > 0:
        return
    cells = [_heading_text(cell) for cell in rows[first]]
    if len(cells) >= 3 and cells in ([str(k) for k in range(len(cells))], [str(k + 1) for k in range(len(cells))]):
        raise InputError(
            f"{path}: line {lines[first]} ({', '.join(cells[:4])}, ...) may name the columns or be a row of data; "
            f"say which with --header-row {lines[first]} or --header-row 0"
        )


def _heading_text(cell: Any) -> str:
    return "" if cell is None else re.sub(r"\s*[\r\n]+\s*", " ", str(cell)).strip()


def refuse_duplicates(names: Sequence[str], path: Path, is_requested: IsRequested = None) -> None:
    """Refuse a requested name that two columns have."""
    for name, count in Counter(names).items():
        if count > 1 and name and (is_requested is None or is_requested(name)):
            raise InputError(
                f"{path}: more than one column is named {name!r}; rename one, or name another line "
                "of names with --header-row"
            )
