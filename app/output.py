"""What commands say: tables and JSON on standard output or in a file, and progress."""

import json
import sys
import textwrap
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TextIO

from softcal.app.files.atomic import write_text
from softcal.app.files.spreadsheet import csv_text, write_table
from softcal.core.errors import InputError

WIDTH, NARROWEST = 100, 4
"""Characters of a table that no terminal shows, and of its narrowest column."""

COLOURS = {"pass": "green", "conditional": "yellow", "fail": "red", "retest": "magenta"}
"""Of a terminal, which knows colours by name alone."""


def say(line: str) -> None:
    """Print one line of progress on standard error."""
    print(shown(line), file=sys.stderr, flush=True)


def shown(text: str) -> str:
    """Return text whose control characters show as codes: a file must not steer a terminal."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


@dataclass
class _Answer:
    """Where the one machine-readable answer goes: alone to `stdout`, a table to `csv`."""

    stdout: TextIO | None = None
    csv: str | None = None


_ANSWER: ContextVar[_Answer] = ContextVar("answer", default=_Answer())  # noqa: B039 - never changed in place


@contextmanager
def answering(json_target: str | None, csv_target: str | None) -> Iterator[None]:
    """Keep standard output for the answer that was asked for with `-`, all else on standard error.

    Raises:
        InputError: JSON and CSV are both to go to standard output.
    """
    if json_target == "-" and csv_target == "-":
        raise InputError("--json - and --csv - both want standard output; give one of them a file")
    is_piped = "-" in (json_target, csv_target)
    token = _ANSWER.set(_Answer(sys.stdout if is_piped else None, csv_target))
    try:
        with redirect_stdout(sys.stderr) if is_piped else nullcontext():
            yield
    finally:
        _ANSWER.reset(token)


def print_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; floats with four significant digits, None as a dash. With `--csv` it is written as CSV instead.

    Long texts are wrapped to the width of the terminal, or of a page where there is none. On a terminal verdicts have
    their colour unless NO_COLOR is set.
    """
    table, answer = [list(row) for row in rows], _ANSWER.get()
    if answer.csv == "-" and answer.stdout is not None:
        answer.stdout.write(csv_text(header, table))
        return
    if answer.csv is not None:
        write_table(Path(answer.csv), header, table)
    if answer.stdout is not None:
        return
    cells = [[_cell(value) for value in row] for row in table]
    if sys.stdout.isatty():
        from rich.box import SIMPLE_HEAD
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        fitting = Table(box=SIMPLE_HEAD, pad_edge=False, header_style="")
        for name in header:
            fitting.add_column(Text(name), overflow="fold")
        for row in cells:
            fitting.add_row(*(Text(cell, style=COLOURS.get(cell, "")) for cell in row))
        Console(highlight=False).print(fitting)
        return
    lines = [[*header], *cells]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    # The widest columns give way until a row fits.
    while sum(widths) > WIDTH - 2 * (len(widths) - 1) and max(widths) > NARROWEST:
        widths[widths.index(max(widths))] -= 1
    folded = [
        [
            textwrap.wrap(cell, width, break_on_hyphens=False) if len(cell) > width else [cell]
            for cell, width in zip(line, widths, strict=True)
        ]
        for line in lines
    ]
    for parts in (folded[0], [["-" * width] for width in widths], *folded[1:]):
        for shown_parts in zip_longest(*parts, fillvalue=""):
            print("  ".join(part.ljust(width) for part, width in zip(shown_parts, widths, strict=True)).rstrip())


def _cell(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else shown(str(value)).replace("\n", " ")


def print_reasons(subject: str, reasons: Iterable[object]) -> None:
    """Print what is said of something: its name, then a reason a line."""
    print(shown(subject))
    for reason in reasons:
        print(textwrap.fill(shown(str(reason)), WIDTH, initial_indent="  - ", subsequent_indent="    "))


def write_json(target: str | None, value: Mapping[str, object]) -> None:
    """Write a result as JSON into a file, on standard output for `-`, nowhere without a target. NaN is refused.

    Every answer is an object whose first key, `schema`, names what the others are: `softcal.NAME/VERSION`.
    """
    if next(iter(value), "") != "schema":
        raise ValueError(f"an answer begins with its schema, this one with {next(iter(value), None)!r}")
    if not target:
        return
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    if target == "-":
        (_ANSWER.get().stdout or sys.stdout).write(text)
    else:
        write_text(Path(target), text)


class ProgressLine:
    """Lines like `3/40 units, 12 s, 4.1 units/s, about 9 s left` on standard error.

    What was done before counts for the share and not for the speed.
    """

    def __init__(self, what: str, total: int, done: int = 0) -> None:
        self._what, self._total, self._start, self._shown_s = what, total, time.monotonic(), 0.0
        self._before = self._done = done

    def step(self, note: str = "", count: int = 1) -> None:
        self.reach(self._done + count, note)

    def reach(self, done: int, note: str = "") -> None:
        """Show that so many items are finished by now, whoever finished them."""
        self._done = done
        elapsed_s = time.monotonic() - self._start
        is_last = self._done >= self._total
        is_terminal = sys.stderr.isatty()
        if not is_last and elapsed_s - self._shown_s < (0.1 if is_terminal else 5.0):
            return
        self._shown_s = elapsed_s
        speed_per_s = (self._done - self._before) / max(elapsed_s, 1e-9)
        line = f"{self._done}/{self._total} {self._what}, {_duration(elapsed_s)}"
        if speed_per_s:
            line += f", {speed_per_s:.3g} {self._what}/s"
            line += "" if is_last else f", about {_duration((self._total - self._done) / speed_per_s)} left"
        line += f"  {note}" if note else ""
        print(
            f"\r\x1b[K{line}" if is_terminal else line,
            end="\n" if is_last or not is_terminal else "",
            file=sys.stderr,
            flush=True,
        )


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
