"""Text files into tables: rows of data under a detected layout, read whole or piece by piece."""

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from softcal.app.tables.arrays import refuse_large
from softcal.app.tables.encoding import Encoding, detect_encoding
from softcal.app.tables.headings import Heading, IsRequested
from softcal.app.tables.numbers import MAX_SUMMARY_ROWS, SUMMARY_WORDS, Kind, cell_kind, texts_to_numbers, to_numbers
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Column, Table
from softcal.app.tables.text_layout import BLANKS, HEAD_LINES, REMARKS, TextLayout, detect_layout, split
from softcal.core.errors import InputError
from softcal.core.recording import Indices

MAX_BYTES_PER_CELL = 25
"""More bytes no number takes as text, with what parts it from the next one."""

ARROW = re.compile(r"(\d{1,2}:\d{2}:\d{2}[.,]\d+) -> ?(.*)")


def read_text(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Read a text file with the requested columns.

    Raises:
        InputError: not a text, a row longer or shorter than the header, or two readings are possible.
    """
    encoding = detect_encoding(file, path, options.encoding)
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    refuse_large(path, size // (MAX_BYTES_PER_CELL * encoding.bytes_per_character), options.max_cells)
    lines, remark = _without_zeros(_lines(file, encoding), path)
    lines = _without_arrows(lines, _arrow_mark(lines))
    layout = detect_layout(lines, path, encoding, options, is_requested)
    if remark:
        layout = replace(layout, remarks=(*layout.remarks, remark))
    rows = _rows(lines[layout.start :], layout, path, options, is_last=True, is_open=bool(lines[-1]))
    return _table(rows, layout, path, options, is_requested)


def _lines(file: BinaryIO, encoding: Encoding) -> list[str]:
    text = io.TextIOWrapper(file, encoding.name, newline=None)
    try:
        return text.read().split("\n")
    finally:
        text.detach()


def _arrow_mark(lines: Sequence[str]) -> str:
    """Return what stands between cells behind `10:00:00.020 -> `, as Arduino's serial monitor writes; "" elsewhere."""
    head = [line for line in lines[:HEAD_LINES] if line.strip()]
    behind = [match[2] for line in head if (match := ARROW.fullmatch(line))]
    if len(behind) <= len(head) / 2:
        return ""
    return next((mark for mark in "\t;," if mark in behind[-1]), ",")


def _without_arrows(lines: list[str], mark: str) -> list[str]:
    """Return lines with the time before an arrow as their first cell."""
    if not mark:
        return lines
    return [f"{match[1]}{mark}{match[2]}" if (match := ARROW.fullmatch(line)) else line for line in lines]


def _without_zeros(lines: list[str], path: Path) -> tuple[list[str], str]:
    """Take zero bytes off the end of a file; refuse them elsewhere."""
    remark = ""
    if not any("\0" in line for line in lines):
        return lines, remark
    while lines and "\0" in lines[-1] and not lines[-1].strip("\0 "):
        lines, remark = lines[:-1], "zero bytes at the end were left out: the logger lost its power, or was not stopped"
    if lines and lines[-1].endswith("\0"):
        # The row that was being written is cut off with them.
        lines, remark = [*lines[:-1], lines[-1].rstrip("\0")], "zero bytes at the end were left out"
    for number, line in enumerate(lines, 1):
        if "\0" in line:
            raise InputError(
                f"{path}: line {number} holds zero bytes; the file was not closed, or is no text: take it from the "
                "logger again, or remove that line"
            )
    return lines, remark


@dataclass(frozen=True)
class _Rows:
    """Rows of data: their texts or, where cells are quoted, their cells; and their lines."""

    texts: list[str]
    cells: list[list[str]] | None
    lines: Indices
    remarks: tuple[str, ...]


def _rows(
    lines: Sequence[str],
    layout: TextLayout,
    path: Path,
    options: TableOptions,
    *,
    is_last: bool,
    is_open: bool = False,
    offset: int | None = None,
) -> _Rows:
    """Return the rows of data among lines, all of one width.

    Args:
        is_last: whether the file ends with these lines.
        is_open: whether it ends without the end of a line: its last row may be cut off.
        offset: lines of the file before these.

    Raises:
        InputError: a row longer or shorter than the header.
    """
    texts, numbers = _filled(lines, layout.start if offset is None else offset)
    delimiter, width = layout.delimiter, len(layout.heading.names)
    whole = "\n".join(texts)
    remarks = _drop_comments(texts, numbers, layout) if "#" in whole else []
    remarks += _drop_headers(texts, numbers, layout)
    cells = None
    if '"' in whole:
        cells = [_unquoted(text, delimiter, number, path) for text, number in zip(texts, numbers, strict=True)]
        widths = list(map(len, cells))
    elif delimiter == BLANKS:
        texts = ["\t".join(text.split()) for text in texts]
        widths = [text.count("\t") + 1 for text in texts]
    else:
        widths = [1] * len(texts) if delimiter == "" else [text.count(delimiter) + 1 for text in texts]
    refuse_large(path, sum(widths), options.max_cells)
    at = "\t" if delimiter == BLANKS else delimiter
    if is_open and len(texts) > 1 and _is_cut(texts[-1], widths[-1], layout, at, texts[:-1]):
        remarks.append(f"line {numbers[-1]} is cut off ({texts[-1].strip()[:40]!r}): what it lacks is missing")
        # The last number that was written may lack digits, too.
        row = split(texts[-1], at)[: min(width, widths[-1]) - 1]
        texts[-1], widths[-1] = at.join([*row, *[""] * (width - len(row))]), width
        if cells is not None:
            cells[-1] = split(texts[-1], at)
        if not row:
            del texts[-1], numbers[-1], widths[-1], (cells if cells is not None else [0])[-1]
    stop = _end_of_data(texts, numbers, widths, layout, at) if is_last else len(texts)
    rest = [k for k in range(stop, len(texts)) if texts[k].strip(f"{at} ")]
    if rest:
        where = f"line {numbers[rest[0]]}" if len(rest) == 1 else f"lines {numbers[rest[0]]} to {numbers[rest[-1]]}"
        remarks.append(f"{where}: no row of data and left out ({texts[rest[0]].strip()[:40]!r})")
    del texts[stop:], numbers[stop:], widths[stop:]
    cells = None if cells is None else cells[:stop]
    if widths.count(width) < len(widths):
        _fit(texts, cells, numbers, widths, layout, path)
    return _Rows(texts, cells, np.array(numbers, dtype=np.int64), tuple(remarks))


def _filled(lines: Sequence[str], offset: int) -> tuple[list[str], list[int]]:
    """Return the lines that are not empty, and their numbers."""
    empty = {k for k, line in enumerate(lines) if not line or line.isspace()}
    if not empty:
        return list(lines), list(range(offset + 1, offset + 1 + len(lines)))
    filled = [k for k in range(len(lines)) if k not in empty]
    return [lines[k] for k in filled], [offset + 1 + k for k in filled]


def _drop_comments(texts: list[str], numbers: list[int], layout: TextLayout) -> list[str]:
    """Take lines that begin with # out, and return a remark on them.

    A line of as many cells as the others is a broken row, whatever it begins with.
    """
    width = len(layout.heading.names)
    comments = [k for k, text in enumerate(texts) if text[0] == "#" and len(split(text, layout.delimiter)) != width]
    for k in reversed(comments):
        del texts[k], numbers[k]
    return [f"{len(comments)} lines that begin with # are comments"] if comments else []


def _drop_headers(texts: list[str], numbers: list[int], layout: TextLayout) -> list[str]:
    """Take lines that repeat the header out, and return a remark on each."""
    names, at = layout.heading.names, layout.delimiter
    if layout.heading.row is None or len(names) < 2:
        return []
    again = [k for k, text in enumerate(texts) if names[0] in text and tuple(split(text, at)) == names]
    remarks = [f"line {numbers[k]} repeats the header and is left out" for k in again]
    for k in reversed(again):
        del texts[k], numbers[k]
    return remarks


def _fit(
    texts: list[str],
    cells: list[list[str]] | None,
    numbers: Sequence[int],
    widths: Sequence[int],
    layout: TextLayout,
    path: Path,
) -> None:
    """Give each row the cells of the header, where only empty ones are too many or missing.

    Raises:
        InputError: a row is longer or shorter.
    """
    width, at = len(layout.heading.names), "\t" if layout.delimiter == BLANKS else layout.delimiter
    for k, count in enumerate(widths):
        if count == width:
            continue
        row = _fitted(cells[k] if cells is not None else split(texts[k], at), width, layout)
        if row is None:
            raise InputError(_unequal(path, numbers[k], count, width, layout))
        if cells is not None:
            cells[k] = row
        else:
            texts[k] = at.join(row)


def _unquoted(text: str, delimiter: str, line: int, path: Path) -> list[str]:
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


def _fitted(row: list[str], width: int, layout: TextLayout) -> list[str] | None:
    """Return a row with the cells of the header, where only empty ones are too many or missing."""
    while len(row) > width and not row[-1]:
        row = row[:-1]
    unnamed = [name == f"column_{k}" for k, name in enumerate(layout.heading.names, 1)]
    while len(row) < width and unnamed[len(row)] and all(unnamed[len(row) :]) and layout.heading.row is not None:
        row = [*row, ""]
    if len(row) == width - 1 and layout.heading.names[-1].lower() in REMARKS:
        row = [*row, ""]
    return row if len(row) == width else None


def _unequal(path: Path, line: int, cells: int, width: int, layout: TextLayout) -> str:
    cure = "repair or remove that line"
    if layout.delimiter == "," and cells > width:
        cure += "; are there decimal commas? write the file with semicolons or tabs between cells then"
    return f"{path}: line {line} has {cells} cells where the header has {width}; {cure}"


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
    """Return the number of rows before those of a summary at the end: their first cell says of what."""
    while stop and len(texts) - stop < MAX_SUMMARY_ROWS and 0 not in layout.text_columns:
        word = re.match(r"[^\W\d_]*", split(texts[stop - 1], delimiter)[0].lower())
        if word is None or word[0] not in SUMMARY_WORDS:
            break
        stop -= 1
    return stop


def _table(rows: _Rows, layout: TextLayout, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    heading = layout.heading
    names = heading.names
    places = [k for k, name in enumerate(names) if is_requested is None or is_requested(name)] or [0]
    if rows.cells is not None:
        raw: dict[int, Any] = {k: np.array([row[k] or None for row in rows.cells], dtype=object) for k in places}
        numbers = {k: to_numbers(cells, layout.decimal, options.missing) for k, cells in raw.items()}
    else:
        raw = _parsed(rows.texts, layout, len(names), places)
        numbers = {k: texts_to_numbers(cells, layout.decimal, options.missing) for k, cells in raw.items()}
    columns, remarks = [], [*layout.remarks, *rows.remarks]
    for k in places:
        values = numbers[k]
        if values is None:
            cells = raw[k]
            values = cells if isinstance(cells, np.ndarray) else _texts(cells, options.missing)
        columns.append(Column(names[k], heading.units[k], values))
    table = Table(path, tuple(columns), names, rows.lines, layout.description, tuple(remarks), layout.decimal)
    return _without_unnamed(table, heading, is_requested)


def _parsed(texts: Sequence[str], layout: TextLayout, width: int, places: Sequence[int]) -> dict[int, Any]:
    """Return the columns as arrow arrays of text."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    delimiter = "\t" if layout.delimiter == BLANKS else layout.delimiter or "\x1f"
    body = "\n".join(texts).encode()
    names = [str(k) for k in range(width)]
    # A row of one empty cell would be taken for no row.
    convert = arrow_csv.ConvertOptions(
        column_types={str(k): pa.string() for k in places}, include_columns=[str(k) for k in places], null_values=[],
        strings_can_be_null=False,
    )  # fmt: skip
    parse = arrow_csv.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=True)
    read = arrow_csv.ReadOptions(column_names=names, use_threads=True)
    table = arrow_csv.read_csv(io.BytesIO(body), read_options=read, parse_options=parse, convert_options=convert)
    return {k: table[str(k)].combine_chunks() for k in places}


def _texts(cells: Any, missing: Sequence[str]) -> Any:
    texts = [text.strip() for text in cells.to_pylist()]
    return np.array([None if not text or text in missing else text for text in texts], dtype=object)


def _without_unnamed(table: Table, heading: Heading, is_requested: IsRequested) -> Table:
    """Leave out columns that have neither a name nor a cell: a comma at the end of each line makes one."""
    if heading.row is None:
        return table
    empty = {
        column.name
        for k, column in enumerate(table.columns, 1)
        if column.name.startswith("column_") and column.cells.dtype.kind == "f" and bool(np.isnan(column.cells).all())
    }
    names = tuple(name for name in table.names if name not in empty)
    return replace(table, columns=tuple(c for c in table.columns if c.name not in empty), names=names)


def text_pieces(
    file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested, rows: int
) -> Iterator[Table]:
    """Yield a long text file in tables of about so many rows, each as `read_text` would give them.

    Raises:
        InputError: as `read_text`, once the piece is reached.
    """
    encoding = detect_encoding(file, path, options.encoding)
    text = io.TextIOWrapper(file, encoding.name, newline=None)
    try:
        yield from _pieces(text, encoding, path, options, is_requested, rows)
    finally:
        text.detach()


def _pieces(
    text: io.TextIOWrapper,
    encoding: Encoding,
    path: Path,
    options: TableOptions,
    is_requested: IsRequested,
    rows: int,
) -> Iterator[Table]:
    head = list(islice(text, max(HEAD_LINES, rows)))
    is_open = bool(head) and not head[-1].endswith("\n")
    head, remark = _without_zeros([line.rstrip("\n") for line in head], path)
    arrow = _arrow_mark(head)
    head = _without_arrows(head, arrow)
    layout = detect_layout(head, path, encoding, options, is_requested)
    if remark:
        layout = replace(layout, remarks=(*layout.remarks, remark))
    offset, pending = layout.start, head[layout.start :]
    while True:
        more = list(islice(text, rows))
        is_last = not more
        is_open = not more[-1].endswith("\n") if more else is_open
        # The last lines wait for those after them: only the end of the file tells a footer from a broken row.
        cut = len(pending) if is_last else max(0, len(pending) - 60)
        if cut:
            piece = _rows(
                pending[:cut], layout, path, options, is_last=is_last, is_open=is_last and is_open, offset=offset
            )
            if len(piece.lines):
                yield _table(piece, layout, path, options, is_requested)
        if is_last:
            return
        following = _without_arrows([line.rstrip("\n") for line in more], arrow)
        offset, pending = offset + cut, [*pending[cut:], *following]
