"""Lines as terminals and serial monitors write them, into rows: a stamp before each line, a name before each value."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from softcal.app.tables.numbers import NUMBER, Kind, cell_kind
from softcal.app.tables.stamp_text import is_stamp
from softcal.app.tables.text_layout import BLANKS, HEAD_LINES, TextLayout, split

STAMP_LINE = re.compile(r"(\[[^\]]+\]|(?:[\d./-]+[ T])?\d{1,2}:\d{2}:\d{2}[.,]\d+)( -> ?|[ \t]+)(.*)")
"""A line with the time before it."""

PAIR = re.compile(
    r"\s*([^\W\d][^\s:=,;]*)\s*[:=]\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?|nan)(?: ([^\W\d][^\s:=,;]*))?\s*(?:[,;\s]|$)"
)
"""A value with its name before it, and its unit where it has one: `force:2.4`, `U = 0.3 V`."""


@dataclass(frozen=True)
class TerminalLines:
    """Additions of a terminal program to each line.

    Args:
        mark: separator of the cells behind a stamp; "" for lines without stamps.
        labels: names in front of the values of each line, with the units behind them.
    """

    mark: str = ""
    labels: tuple[tuple[str, str], ...] = ()

    def to_rows(self, lines: list[str]) -> list[str]:
        """Return lines with the stamp as their first cell, and values without their names."""
        if not self.mark and not self.labels:
            return lines
        return [self._row(line) for line in lines]

    def _row(self, line: str) -> str:
        stamp, _, rest = (self.mark and _split_stamp(line)) or ("", "", line)
        first = [stamp] if stamp else []
        if self.labels:
            pairs = _pairs(rest)
            is_row = _labels(pairs) == self.labels and bool(stamp) == bool(self.mark)
            return "\t".join([*first, *(value for _, value, _ in pairs)]) if is_row else line
        if not stamp:
            return line
        cells = split(rest, self.mark)
        if all(cell_kind(cell) is Kind.TEXT for cell in cells):
            first = ["time"]
        return ("\t" if self.mark == BLANKS else self.mark).join([*first, *cells])

    def to_layout(self, layout: TextLayout) -> TextLayout:
        """Return the layout of such rows, with the names in front of the values."""
        if not self.labels:
            return layout
        names, units = zip(*((("time", ""),) if self.mark else ()), *self.labels, strict=True)
        description = "; ".join(filter(None, (layout.description, "a name before each value")))
        return replace(layout, heading=replace(layout.heading, names=names, units=units), description=description)


def find_terminal_lines(lines: Sequence[str]) -> TerminalLines:
    """Return the additions of a terminal program to each line of a file, from its first lines."""
    head = [line for line in lines[:HEAD_LINES] if line.strip()]
    stamp_parts = [parts for line in head if (parts := _split_stamp(line))]
    is_stamped = len(stamp_parts) > len(head) / 2
    texts = [rest for _, _, rest in stamp_parts] if is_stamped else head
    counts = Counter(_labels(_pairs(text)) for text in texts)
    labels, count = counts.most_common(1)[0] if counts else ((), 0)
    if labels and count > len(head) / 2 and len({name for name, _ in labels}) == len(labels):
        return TerminalLines("\t" if is_stamped else "", labels)
    return TerminalLines(_detect_mark(*stamp_parts[-1]) if is_stamped else "")


def _split_stamp(line: str) -> tuple[str, str, str] | None:
    """Return stamp, separator and rest of a line such as `10:00:00.020 -> 0.3` or `[10:00:00.020] 0.3`."""
    match = STAMP_LINE.fullmatch(line)
    return (match[1], match[2], match[3]) if match and is_stamp(match[1]) else None


def _labels(pairs: Sequence[tuple[str, str, str]]) -> tuple[tuple[str, str], ...]:
    return tuple((name, unit) for name, _, unit in pairs)


def _pairs(text: str) -> list[tuple[str, str, str]]:
    """Return name, value and unit of each pair of a text that consists of pairs alone; else an empty list."""
    pairs, end = [], 0
    while end < len(text):
        match = PAIR.match(text, end)
        if match is None:
            return []
        pairs.append((match[1], match[2], match[3] or ""))
        end = match.end()
    return pairs


def _detect_mark(stamp: str, gap: str, rest: str) -> str:
    """Return the separator of the cells behind a stamp; "" if the stamp is a cell itself."""
    value_texts = rest.split()
    are_numbers = all(NUMBER["."].fullmatch(text) or NUMBER[","].fullmatch(text) for text in value_texts)
    has_blanks = are_numbers and len(value_texts) > 1 and "\t" not in rest
    mark = BLANKS if has_blanks else next((mark for mark in "\t;," if mark in rest), ",")
    if gap.strip() or stamp.startswith("["):
        return mark
    is_cell = mark in (gap, BLANKS) or (len(value_texts) == 1 and are_numbers)
    return "" if is_cell or cell_kind(split(rest, mark)[0]) is not Kind.NUMBER else mark
