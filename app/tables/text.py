"""Text files into tables: rows of data under a detected layout, read whole or piece by piece."""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from softcal.app.tables.arrays import refuse_large
from softcal.app.tables.encoding import Encoding, detect_encoding
from softcal.app.tables.headings import Heading, IsRequested
from softcal.app.tables.labview import HEADER_TIME
from softcal.app.tables.numbers import missing_codes_remark, texts_to_numbers, to_numbers
from softcal.app.tables.options import TableOptions
from softcal.app.tables.other_text import refuse_other_text
from softcal.app.tables.table import Column, Table
from softcal.app.tables.terminal_text import TerminalLines, find_terminal_lines
from softcal.app.tables.text_layout import BLANKS, HEAD_LINES, TextLayout, detect_layout
from softcal.app.tables.text_rows import TextRows, extract_data_rows
from softcal.core.errors import InputError

MAX_BYTES_PER_CELL = 25
"""More bytes no number takes as text, with what parts it from the next one."""


def read_text(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Read a text file with the requested columns.

    Raises:
        InputError: not a text, a row longer or shorter than the header, or two readings are possible.
    """
    encoding = detect_encoding(file, path, options.encoding)
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    refuse_large(path, size // (MAX_BYTES_PER_CELL * encoding.bytes_per_character), options.max_cells)
    with _open_text(file, encoding) as text:
        lines = text.read().split("\n")
    lines, layout, _ = _lay_out_rows(lines, path, encoding, options, is_requested)
    rows = extract_data_rows(lines[layout.start :], layout, path, options, is_last=True, is_open=bool(lines[-1]))
    return _table(rows, layout, path, options, is_requested)


def _lay_out_rows(
    lines: list[str], path: Path, encoding: Encoding, options: TableOptions, is_requested: IsRequested
) -> tuple[list[str], TextLayout, TerminalLines]:
    """Return rows without zero bytes, their layout, and the terminal's additions to each of them."""
    lines, remarks = _drop_zero_bytes(lines, path)
    refuse_other_text(lines, path)
    terminal = find_terminal_lines(lines)
    rows = terminal.to_rows(lines)
    layout = terminal.to_layout(detect_layout(rows, path, encoding, options, is_requested))
    return rows, replace(layout, remarks=(*layout.remarks, *remarks)), terminal


@contextmanager
def _open_text(file: BinaryIO, encoding: Encoding) -> Iterator[io.TextIOWrapper]:
    text = io.TextIOWrapper(file, encoding.name, newline=None)
    try:
        yield text
    finally:
        text.detach()


def _drop_zero_bytes(lines: list[str], path: Path) -> tuple[list[str], list[str]]:
    """Remove zero bytes at the end of a file with a remark; refuse zero bytes elsewhere."""
    remark = ""
    if not any("\0" in line for line in lines):
        return lines, []
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
    return lines, [remark]


def _table(
    rows: TextRows, layout: TextLayout, path: Path, options: TableOptions, is_requested: IsRequested, first: int = 0
) -> Table:
    """Return rows as a table; `first` counts the rows of data before them."""
    heading = layout.heading
    names = heading.names
    indices = [k for k, name in enumerate(names) if is_requested is None or is_requested(name)] or [0]
    if rows.cells is not None:
        raw: dict[int, Any] = {k: np.array([row[k] or None for row in rows.cells], dtype=object) for k in indices}
        numbers = {k: to_numbers(cells, layout.decimal, options.missing) for k, cells in raw.items()}
    else:
        raw = _parse_columns(rows.texts, layout, len(names), indices)
        numbers = {k: texts_to_numbers(cells, layout.decimal, options.missing) for k, cells in raw.items()}
    columns, remarks = [], [*layout.remarks, *rows.remarks]
    for k in indices:
        values = numbers[k]
        cells = raw[k]
        if values is None:
            values = cells if isinstance(cells, np.ndarray) else _to_texts(cells, options.missing)
        elif np.isnan(values).any():
            remarks += missing_codes_remark(names[k], cells, options.missing)
        columns.append(Column(names[k], heading.units[k], values))
    if layout.clock is not None:
        names = (*names, HEADER_TIME)
        if is_requested is None or is_requested(HEADER_TIME):
            columns.append(layout.clock.column(len(rows.lines), first))
    table = Table(path, tuple(columns), names, rows.lines, layout.description, tuple(remarks), layout.decimal)
    return _drop_empty_columns(table, heading, is_requested)


def _parse_columns(texts: Sequence[str], layout: TextLayout, width: int, indices: Sequence[int]) -> dict[int, Any]:
    """Return the columns as arrow arrays of text."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    delimiter = "\t" if layout.delimiter == BLANKS else layout.delimiter or "\x1f"
    body = "\n".join(texts).encode()
    names = [str(k) for k in range(width)]
    # A row of one empty cell would be taken for no row.
    convert = arrow_csv.ConvertOptions(
        column_types={str(k): pa.string() for k in indices}, include_columns=[str(k) for k in indices], null_values=[],
        strings_can_be_null=False,
    )  # fmt: skip
    parse = arrow_csv.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=True)
    read = arrow_csv.ReadOptions(column_names=names, use_threads=True)
    table = arrow_csv.read_csv(io.BytesIO(body), read_options=read, parse_options=parse, convert_options=convert)
    return {k: table[str(k)].combine_chunks() for k in indices}


def _to_texts(cells: Any, missing: Sequence[str]) -> Any:
    texts = [text.strip() for text in cells.to_pylist()]
    return np.array([None if not text or text in missing else text for text in texts], dtype=object)


def _drop_empty_columns(table: Table, heading: Heading, is_requested: IsRequested) -> Table:
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
    with _open_text(file, encoding) as text:
        head = list(islice(text, max(HEAD_LINES, rows)))
        is_open = bool(head) and not head[-1].endswith("\n")
        head, layout, terminal = _lay_out_rows(
            [line.rstrip("\n") for line in head], path, encoding, options, is_requested
        )
        offset, pending, first = layout.start, head[layout.start :], 0
        while True:
            more = list(islice(text, rows))
            is_last = not more
            is_open = not more[-1].endswith("\n") if more else is_open
            # The last lines wait for those after them: only the end of the file tells a footer from a broken row.
            cut = len(pending) if is_last else max(0, len(pending) - 60)
            if cut:
                piece = extract_data_rows(
                    pending[:cut], layout, path, options, is_last=is_last, is_open=is_last and is_open, offset=offset
                )
                if len(piece.lines):
                    yield _table(piece, layout, path, options, is_requested, first)
                first += len(piece.lines)
            if is_last:
                return
            following = terminal.to_rows([line.rstrip("\n") for line in more])
            offset, pending = offset + cut, [*pending[cut:], *following]
