"""Layout of a text file, detected in its first lines: delimiter, decimal mark, preamble, names and units."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from softcal.app.tables import labview
from softcal.app.tables.encoding import Encoding
from softcal.app.tables.headings import Heading, IsRequested, data_rows, find_heading, refuse_duplicates
from softcal.app.tables.numbers import THOUSANDS, Kind, cell_kind, show_cell, unit_number
from softcal.app.tables.options import TableOptions
from softcal.app.tables.time_column import is_clock_heading
from softcal.core.errors import InputError

HEAD_LINES = 600
"""Lines that the layout is detected in."""

BLANKS = "blanks"
NAMES = {"\t": "tabs", ";": "semicolons", "|": "bars", BLANKS: "blanks", "": "one column"}
DECLARED = {"tab": "\t", "\\t": "\t", "blank": BLANKS, " ": BLANKS, "space": BLANKS, "comma": ",", "semicolon": ";"}
DELIMITERS = ("\t", ";", ",", "|", BLANKS, "")
REMARK_HEADINGS = ("comment", "comments", "note", "notes", "remark", "remarks", "bemerkung", "kommentar", "비고")
"""Names of a last column that rows without a remark end before, as LabVIEW writes them."""

COMMENT = re.compile(r"[# ]*(?:% +)?")
"""How lines begin that name columns in a comment, as numpy and MATLAB write them."""


@dataclass(frozen=True)
class TextLayout:
    """Layout of a text file.

    Args:
        delimiter: one character, "blanks", or "" where there is one column only.
        skipped: lines before the one that `heading` counts from.
        start: index of the first line of data in the file, counted from 0.
        text_columns: columns that hold text in most rows.
        labels: texts that lines above the data begin with.
        clock: time that the header states where no column has it.
    """

    encoding: Encoding
    delimiter: str
    decimal: str
    heading: Heading
    start: int
    text_columns: frozenset[int]
    labels: frozenset[str]
    description: str
    remarks: tuple[str, ...]
    clock: labview.HeaderClock | None = None


def detect_layout(
    lines: Sequence[str], path: Path, encoding: Encoding, options: TableOptions, is_requested: IsRequested
) -> TextLayout:
    """Return the layout of a text file, of which the first lines are enough.

    Raises:
        InputError: there is no row of data, or two readings are possible.
    """
    skipped, declared = _preamble(lines, options)
    line_indices = [k for k in range(skipped, min(len(lines), HEAD_LINES)) if lines[k].strip("# \t")]
    head = [(k, COMMENT.sub("", lines[k], count=1)) for k in line_indices]
    # Rows with commas further down tell the decimal mark where the first ones hold whole numbers.
    more = [line for line in lines[HEAD_LINES:] if "," in line][:200] if len(lines) > HEAD_LINES else []
    texts = [line for _, line in head]
    delimiter, decimal = _detect_marks(texts, more, path, declared, is_requested)
    rows = [split(line, delimiter) for line in texts]
    if delimiter == BLANKS:
        # Names of several words stand two blanks apart.
        width = data_rows(rows, decimal)[2]
        wide_rows = [re.split(r"\s{2,}", line.strip()) for line in texts]
        rows = [wide if len(wide) == width else row for row, wide in zip(rows, wide_rows, strict=True)]
    numbers = [k + 1 for k, _ in head]
    heading = find_heading(rows, numbers, path, decimal=decimal, declared=options.header_row, is_requested=is_requested)
    if labview.TIME in heading.names:
        heading = replace(heading, names=_number_names(heading.names, labview.TIME))
    refuse_duplicates(heading.names, path, is_requested)
    if heading.first >= len(rows) or not heading.names:
        raise InputError(
            f"{path}: there is no row of data below the header; line {numbers[0]} reads {texts[0][:30]!r}: state "
            "--delimiter, --decimal or --header-row, or write the names in one line and only numbers below it"
            if numbers
            else f"{path}: there is no row of data in it"
        )
    _refuse_unnamed(rows[heading.first :], numbers[heading.first], len(heading.names), delimiter, path)
    _, text_columns, _ = data_rows(rows[heading.first :], decimal)
    is_plain = delimiter == "," or (delimiter == "" and len(heading.names) == 1)
    parts = [] if is_plain else [NAMES.get(delimiter, f"{delimiter!r} between cells")]
    parts += ["decimal comma"] if decimal == "," else []
    parts += [] if encoding.name in ("utf-8", "utf-8-sig", "ascii") else [_encoding_label(encoding.name)]
    parts += heading.describe(numbers)
    remarks = (encoding.remark,) if encoding.remark else ()
    start = head[heading.first][0]
    first_cells = [split(line, delimiter)[0] for line in lines[:start] if line.strip()]
    labels = frozenset(cell for cell in first_cells if cell_kind(cell, decimal) is Kind.TEXT)
    clock = None
    if labview.header_ends(lines[:skipped]) and not _has_times(heading, rows, decimal):
        clock = labview.find_header_clock([split(line, delimiter) for line in lines[:skipped]], decimal, path)
        parts += [] if clock is None else [str(clock)]
    description = "; ".join(parts)
    return TextLayout(encoding, delimiter, decimal, heading, start, text_columns, labels, description, remarks, clock)


def _has_times(heading: Heading, rows: Sequence[Sequence[str]], decimal: str) -> bool:
    """Return whether LabVIEW wrote a time column; it may be missing or empty."""
    names = heading.names
    if labview.TIME not in names:
        return labview.HEADER_TIME in names
    column_index = names.index(labview.TIME)
    cells = [row[column_index] for row in rows[heading.first :] if len(row) > column_index]
    return any(cell_kind(cell, decimal) in (Kind.NUMBER, Kind.STAMP) for cell in cells)


def _number_names(names: Sequence[str], repeated: str) -> tuple[str, ...]:
    """Return names with a number added to each repetition of a name."""
    return tuple(
        f"{name} {count}" if name == repeated and (count := names[: k + 1].count(name)) > 1 else name
        for k, name in enumerate(names)
    )


def _refuse_unnamed(rows: Sequence[Sequence[str]], line: int, names: int, delimiter: str, path: Path) -> None:
    """Refuse rows that have more cells than there are names, where most of them have."""
    wider = [row for row in rows if any(row[names:])]
    if len(wider) > len(rows) / 2:
        cure = "give every column a name"
        if delimiter == ",":
            cure += "; with decimal commas write semicolons or tabs between cells"
        raise InputError(
            f"{path}: the rows have more cells than the header ({len(wider[0])} from line {line} on, {names} "
            f"names); {cure}"
        )


def _encoding_label(name: str) -> str:
    return (
        "Latin-1"
        if name in ("cp1252", "iso8859-1", "latin-1")
        else name.upper().removesuffix("-LE").removesuffix("-BE")
    )


def _preamble(lines: Sequence[str], options: TableOptions) -> tuple[int, TableOptions]:
    """Return the number of preamble lines, and the options with the values that these lines state."""
    delimiter, decimal = DECLARED.get(options.delimiter or "", options.delimiter), options.decimal
    if decimal not in (None, ".", ","):
        raise InputError(f"--decimal {decimal!r}: '.' or ',' was expected")
    if delimiter is not None and delimiter != BLANKS and len(delimiter) != 1:
        raise InputError(f"--delimiter {options.delimiter!r}: one character, tab or blanks was expected")
    skipped = 0
    if lines and (match := re.fullmatch(r'"?sep=(.)"?\s*', lines[0])):
        skipped, delimiter = 1, delimiter or match[1]
    head = [line.rstrip("\t;, ") for line in lines[:HEAD_LINES]]
    if ends := labview.header_ends(head):
        # Of the file, then of its first segment.
        skipped = ends[:2][-1] + 1
        for line in head[:skipped]:
            pair = re.split(r"[\t;, ]", line, maxsplit=1)
            if pair[0] == "Separator" and len(pair) > 1:
                delimiter = delimiter or {"Tab": "\t", "Comma": ","}.get(pair[1].strip())
            elif pair[0] == "Decimal_Separator" and pair[-1].strip() in (".", ","):
                decimal = decimal or pair[-1].strip()
    return skipped, replace(options, delimiter=delimiter, decimal=decimal)


def split(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line, without the blanks around them."""
    if delimiter == BLANKS:
        return line.split()
    if delimiter == "":
        return [line.strip().strip('"')]
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]


def _detect_marks(
    texts: Sequence[str], more: Sequence[str], path: Path, options: TableOptions, is_requested: IsRequested
) -> tuple[str, str]:
    """Return delimiter and decimal mark: those that make the most cells numbers, and requested names cells."""
    scores: dict[tuple[str, str], float] = {}
    candidates: Sequence[str] = DELIMITERS if options.delimiter is None else (options.delimiter,)
    if options.delimiter is None and options.decimal == "," and not any('"' in line for line in texts):
        candidates = [mark for mark in DELIMITERS if mark != ","]
    if options.delimiter is None and sum("\t" in line for line in texts) > len(texts) / 2:
        # A blank may part a date from a time.
        candidates = [mark for mark in candidates if mark != BLANKS]
    for delimiter in candidates:
        rows = [split(line, delimiter) for line in (*texts, *more)]
        if not any(len(row) > 1 for row in rows) and delimiter not in ("", options.delimiter):
            continue
        for decimal in (".", ",") if options.decimal is None else (options.decimal,):
            scores[delimiter, decimal] = _score(rows, decimal, delimiter)
    if is_requested is not None:
        # A clock's name may stand in any preamble.
        cells = {mark: [cell for line in texts for cell in split(line, mark)] for mark, _ in scores}
        matching_marks = {
            mark for mark in cells if any(is_requested(cell) and not is_clock_heading(cell) for cell in cells[mark])
        }
        scores = {marks: score for marks, score in scores.items() if marks[0] in matching_marks and score > 0} or scores
    best = max(scores.values(), default=0.0)
    if best <= 0:
        return options.delimiter or ",", options.decimal or "."
    # Of equal readings the first stands: a tab before a blank, a point where no number has a decimal mark.
    delimiter, decimal = next(marks for marks, score in scores.items() if score > best - 1e-9)
    if options.delimiter is None and scores.get((",", "."), 0) == scores.get(("", ","), 0) == best:
        delimiter, decimal = _comma_or_decimal(texts, path)
    if options.decimal is None:
        _refuse_thousands([split(line, delimiter) for line in (*texts, *more)], delimiter, decimal, path)
    return delimiter, decimal


def _score(rows: Sequence[Sequence[str]], decimal: str, delimiter: str) -> float:
    """Return the rows that have the form of data, times the share of numbers in their cells."""
    data, _, width = data_rows(rows, decimal)
    if width == 1 and delimiter == BLANKS:
        # It parts the words of a name alone.
        return 0.0
    cells = [cell for k in data for cell in rows[k]]
    kinds = [Kind.NUMBER if unit_number(cell, decimal) else cell_kind(cell, decimal) for cell in cells]
    filled = len(kinds) - kinds.count(Kind.EMPTY)
    return len(data) * (1 - kinds.count(Kind.TEXT) / filled) if filled else 0.0


def _comma_or_decimal(texts: Sequence[str], path: Path) -> tuple[str, str]:
    """Decide by the header whether `0,512` is two numbers or one."""
    data, _, _ = data_rows([split(line, ",") for line in texts])
    above = [len(split(line, ",")) for line in texts[: data[0]]] if data else []
    if not above:
        raise InputError(
            f"{path}: {texts[-1][:30]!r} may be two numbers or one with a decimal comma; give --delimiter , or "
            f"--decimal ,"
        )
    return (",", ".") if above[-1] > 1 else ("", ",")


def _refuse_thousands(rows: Sequence[Sequence[str]], delimiter: str, decimal: str, path: Path) -> None:
    """Refuse `1,234` if the column does not decide whether its mark is decimal."""
    marked = [cell for row in rows for cell in row if decimal in cell and cell_kind(cell, decimal) is Kind.NUMBER]
    if decimal == "," and marked and all(THOUSANDS.fullmatch(cell) for cell in marked):
        raise InputError(f"{path}: {show_cell(marked[0])} may be in thousands or have a decimal comma; give --decimal")
