"""Rows of data in a text file, and the treatment of the other lines."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softcal.app.tables.arrays import refuse_large
from softcal.app.tables.labview import refuse_segments
from softcal.app.tables.numbers import MAX_SUMMARY_ROWS, Kind, cell_kind, is_summary
from softcal.app.tables.options import TableOptions
from softcal.app.tables.text_layout import BLANKS, REMARK_HEADINGS, TextLayout, split
from softcal.core.errors import InputError
from softcal.core.recording import Indices


@dataclass(frozen=True)
class TextRows:
    """Rows of data: their texts or, where cells are quoted, their cells; and their lines."""

    texts: list[str]
    cells: list[list[str]] | None
    lines: Indices
    remarks: tuple[str, ...]


def extract_data_rows(
    lines: Sequence[str],
    layout: TextLayout,
    path: Path,
    options: TableOptions,
    *,
    is_last: bool,
    is_open: bool = False,
    offset: int | None = None,
) -> TextRows:
    """Return the rows of data among lines, all of one width.

    Args:
        is_last: whether the file ends with these lines.
        is_open: whether it ends without the end of a line: its last row may be cut off.
        offset: lines of the file before these.

    Raises:
        InputError: a row longer or shorter than the header.
    """
    if layout.clock is not None:
        refuse_segments(lines, path)
    texts, numbers = _drop_empty_lines(lines, layout.start if offset is None else offset)
    delimiter, width = layout.delimiter, len(layout.heading.names)
    joined_text = "\n".join(texts)
    remarks = _drop_comments(texts, numbers, layout) if "#" in joined_text or "%" in joined_text else []
    remarks += _drop_repeats(texts, numbers, layout)
    cells = None
    if '"' in joined_text:
        cells = [_split_quoted(text, delimiter, number, path) for text, number in zip(texts, numbers, strict=True)]
        widths = list(map(len, cells))
    elif delimiter == BLANKS:
        texts = ["\t".join(_split_blanks(text, width, layout.decimal)) for text in texts]
        widths = [text.count("\t") + 1 for text in texts]
    else:
        widths = [1] * len(texts) if delimiter == "" else [text.count(delimiter) + 1 for text in texts]
    refuse_large(path, sum(widths), options.max_cells)
    separator = "\t" if delimiter == BLANKS else delimiter
    if is_open and len(texts) > 1 and _is_cut(texts[-1], widths[-1], layout, separator, texts[:-1]):
        remarks.append(f"line {numbers[-1]} is cut off ({texts[-1].strip()[:40]!r}): what it lacks is missing")
        # The last number that was written may lack digits, too.
        row = split(texts[-1], separator)[: min(width, widths[-1]) - 1]
        texts[-1], widths[-1] = separator.join([*row, *[""] * (width - len(row))]), width
        if cells is not None:
            cells[-1] = split(texts[-1], separator)
        if not row:
            del texts[-1], numbers[-1], widths[-1], (cells if cells is not None else [0])[-1]
    stop = _end_of_data(texts, numbers, widths, layout, separator) if is_last else len(texts)
    trailing_rows = [k for k in range(stop, len(texts)) if texts[k].strip(f"{separator} ")]
    if trailing_rows:
        location = (
            f"line {numbers[trailing_rows[0]]}"
            if len(trailing_rows) == 1
            else f"lines {numbers[trailing_rows[0]]} to {numbers[trailing_rows[-1]]}"
        )
        remarks.append(f"{location}: no row of data and left out ({texts[trailing_rows[0]].strip()[:40]!r})")
    del texts[stop:], numbers[stop:], widths[stop:]
    cells = None if cells is None else cells[:stop]
    if widths.count(width) < len(widths):
        _fit_rows(texts, cells, numbers, widths, layout, path)
    return TextRows(texts, cells, np.array(numbers, dtype=np.int64), tuple(remarks))


def _split_blanks(text: str, width: int, decimal: str) -> list[str]:
    """Return the cells of a line separated by blanks, keeping words of one cell such as `no signal` together."""
    pieces = text.split()
    if len(pieces) <= width:
        return pieces
    cells: list[str] = []
    is_text = False
    for piece in pieces:
        was_text, is_text = is_text, cell_kind(piece, decimal) is Kind.TEXT
        if was_text and is_text:
            cells[-1] += f" {piece}"
        else:
            cells.append(piece)
    return cells if len(cells) == width else pieces


def _drop_empty_lines(lines: Sequence[str], offset: int) -> tuple[list[str], list[int]]:
    """Return the lines that are not empty, and their numbers."""
    filled = [k for k, line in enumerate(lines) if line and not line.isspace()]
    return [lines[k] for k in filled], [offset + 1 + k for k in filled]


def _drop_comments(texts: list[str], numbers: list[int], layout: TextLayout) -> list[str]:
    """Remove lines that begin with # or %, and return a remark on them.

    A line of as many cells as the others is a broken row, whatever it begins with.
    """
    width = len(layout.heading.names)
    comments = [k for k, text in enumerate(texts) if text[0] in "#%" and len(split(text, layout.delimiter)) != width]
    marks = " or ".join(sorted({texts[k][0] for k in comments}))
    for k in reversed(comments):
        del texts[k], numbers[k]
    return [f"{len(comments)} lines that begin with {marks} are comments"] if comments else []


def _drop_repeats(texts: list[str], numbers: list[int], layout: TextLayout) -> list[str]:
    """Remove lines that repeat lines above the samples, and return a remark on each block.

    A header that comes again, that of another block or segment: their first cells are the same texts.
    """
    delimiter, labels, joined_text = layout.delimiter, layout.labels, "\n".join(texts)
    if not any(label in joined_text for label in labels):
        return []
    repeated_rows = [k for k, text in enumerate(texts) if (cells := split(text, delimiter)) and cells[0] in labels]
    if 0 in layout.text_columns:
        repeated_rows = [k for k in repeated_rows if tuple(split(texts[k], delimiter)) == layout.heading.names]
    blocks = [[k] for k in repeated_rows if k - 1 not in repeated_rows]
    for block in blocks:
        while block[-1] + 1 in repeated_rows:
            block.append(block[-1] + 1)
    remarks = [
        f"line {numbers[block[0]]} repeats what stands above the samples and is left out"
        if len(block) == 1
        else f"lines {numbers[block[0]]} to {numbers[block[-1]]} repeat what stands above the samples and are left out"
        for block in blocks
    ]
    for k in reversed(repeated_rows):
        del texts[k], numbers[k]
    return remarks


def _fit_rows(
    texts: list[str],
    cells: list[list[str]] | None,
    numbers: Sequence[int],
    widths: Sequence[int],
    layout: TextLayout,
    path: Path,
) -> None:
    """Return each row with the cells of the header, if only empty cells are surplus or missing.

    Raises:
        InputError: a row is longer or shorter.
    """
    width, delimiter = len(layout.heading.names), "\t" if layout.delimiter == BLANKS else layout.delimiter
    for k, count in enumerate(widths):
        if count == width:
            continue
        row = _fit_row(cells[k] if cells is not None else split(texts[k], delimiter), width, layout)
        if row is None:
            line = "each row" if set(widths) == {count} and k == 0 else f"line {numbers[k]}"
            raise InputError(_width_error(path, line, count, width, layout))
        if cells is not None:
            cells[k] = row
        else:
            texts[k] = delimiter.join(row)


def _split_quoted(text: str, delimiter: str, line: int, path: Path) -> list[str]:
    if '"' in text and delimiter not in (BLANKS, ""):
        try:
            next(csv.reader([text], delimiter=delimiter, skipinitialspace=True, strict=True))
        except csv.Error as error:
            raise InputError(
                f"{path}: line {line}: a quote without its other end; repair or remove that line"
            ) from error
    return split(text, delimiter)


def _is_cut(text: str, cells: int, layout: TextLayout, delimiter: str, others: Sequence[str]) -> bool:
    """Whether the last row of a file was being written when the file ended; all `others` have a longer last number."""
    row = split(text, delimiter)
    if cells < len(layout.heading.names) and cell_kind(row[0], layout.decimal) in (Kind.NUMBER, Kind.STAMP):
        return True
    shortest = min((len(split(one, delimiter)[-1]) for one in others), default=0)
    if cells == len(layout.heading.names) and 0 < len(row[-1]) < shortest:
        return True
    is_text_column = len(row) - 1 in layout.text_columns
    return (
        cells == len(layout.heading.names) and bool(re.fullmatch(r"[+-]|.*\d[eE][+-]?", row[-1])) and not is_text_column
    )


def _fit_row(row: list[str], width: int, layout: TextLayout) -> list[str] | None:
    """Return a row with the cells of the header, where only empty ones are too many or missing."""
    while len(row) > width and not row[-1]:
        row = row[:-1]
    unnamed = [name == f"column_{k}" for k, name in enumerate(layout.heading.names, 1)]
    while len(row) < width and unnamed[len(row)] and all(unnamed[len(row) :]) and layout.heading.row is not None:
        row = [*row, ""]
    if len(row) == width - 1 and layout.heading.names[-1].lower() in REMARK_HEADINGS:
        row = [*row, ""]
    return row if len(row) == width else None


def _width_error(path: Path, line: str, cells: int, width: int, layout: TextLayout) -> str:
    cure = "repair or remove that line" if line != "each row" else "give each column one name, and no name more"
    if layout.delimiter == "," and cells > width:
        cure += "; are there decimal commas? write the file with semicolons or tabs between cells then"
    return f"{path}: {line} has {cells} cells where the header has {width}; {cure}"


def _end_of_data(
    texts: Sequence[str], numbers: Sequence[int], widths: Sequence[int], layout: TextLayout, delimiter: str
) -> int:
    """Return the number of rows without what follows the last row of data: empty cells, a footer, a row cut off."""
    stop = _before_summary(texts, len(texts), layout, delimiter)
    width = len(layout.heading.names)
    text_columns = layout.text_columns

    def kinds(k: int) -> list[Kind]:
        return [cell_kind(cell, layout.decimal) for cell in split(texts[k], delimiter)]

    def is_footer(k: int) -> bool:
        row = kinds(k)
        stray = [n for n, kind in enumerate(row) if kind is Kind.TEXT and n not in text_columns]
        has_numbers = Kind.NUMBER in row or Kind.STAMP in row
        if not has_numbers:
            return bool(stray) or all(kind is Kind.EMPTY for kind in row)
        return bool(stray) and stray[0] == 0 and (widths[k] != width or numbers[k] - numbers[k - 1] > 1)

    while stop and is_footer(stop - 1):
        stop -= 1
    # A block of lines below an empty one whose rows all begin with a text is a summary.
    breaks = [k for k in range(max(1, stop - 50), stop) if numbers[k] - numbers[k - 1] > 1]
    if breaks and all(
        (row := kinds(k)) and row[0] is Kind.TEXT and 0 not in text_columns for k in range(breaks[0], stop)
    ):
        stop = breaks[0]
    return stop


def _before_summary(texts: Sequence[str], stop: int, layout: TextLayout, delimiter: str) -> int:
    """Return the number of rows before a summary at the end, found by its first filled cell."""
    while stop and len(texts) - stop < MAX_SUMMARY_ROWS and 0 not in layout.text_columns:
        cells = split(texts[stop - 1], delimiter)
        if any(cells) and not is_summary(cells):
            break
        stop -= 1
    return stop
