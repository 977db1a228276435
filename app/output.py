"""What commands say: tables and JSON on standard output or in a file, and progress."""

import json
import math
import os
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO, cast

from softcal.app.files.atomic import write_text
from softcal.app.files.spreadsheet import csv_text, write_table
from softcal.core.errors import InputError

WIDTH, MIN_WIDTH = 100, 20
"""Characters of a line of sentences that no terminal shows, and of the narrowest terminal."""

BAR_WIDTH = 24
"""Characters of a bar."""

NOTHING, BELOW = "–", "    "
"""A cell without a value; what begins the lines below a row."""

NO_VALUES = frozenset({NOTHING, ""})

COLOURS = {"pass": "green", "conditional": "yellow", "fail": "red", "retest": "magenta"}
"""Of a terminal, which knows colours by name alone."""


def echo(line: str) -> None:
    """Print one line of progress on standard error."""
    print(escape_controls(line), file=sys.stderr, flush=True)


def escape_controls(text: str) -> str:
    """Return text whose control characters show as codes: a file must not steer a terminal."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


class _Console:
    """Standard output or error, whose reader may leave: what is printed then goes nowhere, and the work goes on."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        with self._reader_may_leave():
            self.stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._reader_may_leave():
            self.stream.flush()

    @contextmanager
    def _reader_may_leave(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())
            os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def printing() -> Iterator[None]:
    """Let a command print to readers that may leave before it is done, such as `head`."""
    consoles = output, error = _Console(sys.stdout), _Console(sys.stderr)
    with redirect_stdout(cast(TextIO, output)), redirect_stderr(cast(TextIO, error)):
        yield
        for console in consoles:
            console.flush()


def stream_of_standard_output() -> TextIO:
    """Return standard output for rows without an end, which nobody makes once their reader has left."""
    return getattr(sys.stdout, "stream", sys.stdout)


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


def print_table(header: Sequence[str], rows: Iterable[Sequence[object]], columns: int | None = None) -> None:
    """Print a table; floats with four significant digits, None as a dash. With `--csv` it is written as CSV instead.

    Columns that have no room in a terminal, or in COLUMNS, stand below their row. On a terminal verdicts have their
    colour unless NO_COLOR is set.

    Args:
        columns: so many are printed, None prints all; CSV always has all.
    """
    table, answer = [list(row) for row in rows], _ANSWER.get()
    if answer.csv == "-" and answer.stdout is not None:
        answer.stdout.write(csv_text(header, table))
        return
    if answer.csv is not None:
        write_table(Path(answer.csv), header, table)
    if answer.stdout is not None:
        return
    _print_rows(header[:columns], [[_cell(value) for value in row[:columns]] for row in table], _width())


def _width() -> int | None:
    """Return how many places a line has: of a terminal, or as COLUMNS says; None in a pipe, where all fits."""
    if sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdecimal():
        return max(shutil.get_terminal_size().columns, MIN_WIDTH)
    return None


def _print_rows(header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None) -> None:
    """Print a table. Where it does not fit, empty columns are left out, and others stand below their row by name."""
    columns = list(zip(header, *rows, strict=True))
    if width is not None and _line_width(columns) > width:
        columns = [column for column in columns if not NO_VALUES.issuperset(column[1:])] or columns
        header, *rows = zip(*columns, strict=True)
    in_rows = len(columns)
    while width is not None and in_rows > 1 and _line_width(columns[:in_rows]) > width:
        in_rows -= 1
    widths = [max(map(_cells_of, column)) for column in columns]
    widths = widths[:in_rows] if width is None or in_rows > 1 else [min(widths[0], width)]
    print_line = _line_printer()
    print_line(header, widths)
    print_line(["-" * one for one in widths], widths)
    for row in rows:
        print_line(row, widths)
        others = zip(header[in_rows:], row[in_rows:], strict=True)
        below = [f"{name}: {cell}" for name, cell in others if cell not in NO_VALUES]
        for line in _wrap("; ".join(below), (width or 0) - len(BELOW)) if below else ():
            print(BELOW + line)


def _line_width(columns: Sequence[Sequence[str]]) -> int:
    return sum(max(map(_cells_of, column)) for column in columns) + 2 * (len(columns) - 1)


def _line_printer() -> Callable[[Sequence[str], Sequence[int]], None]:
    """Return what prints the cells of a line; on a terminal verdicts have their colour."""

    def padded(cells: Sequence[str], widths: Sequence[int]) -> list[str]:
        if len(widths) == 1 and _cells_of(cells[0]) > widths[0]:
            return ["\n".join(_wrap(cells[0], widths[0]))]
        return [cell + " " * (one - _cells_of(cell)) for cell, one in zip(cells, widths, strict=False)]

    def plain(cells: Sequence[str], widths: Sequence[int]) -> None:
        print("  ".join(padded(cells, widths)).rstrip())

    if not sys.stdout.isatty():
        return plain
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False, soft_wrap=True)

    def colour_cells(cells: Sequence[str], widths: Sequence[int]) -> None:
        console.print(Text("  ").join(Text(cell, COLOURS.get(cell.rstrip(), "")) for cell in padded(cells, widths)))

    return colour_cells


def _cells_of(text: str) -> int:
    """Return how many places a text takes in a terminal: a Korean letter takes two."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)


def _wrap(text: str, width: int) -> list[str]:
    """Return a text in lines of at most so many places, broken at blanks where it can be."""
    if text.isascii():
        return textwrap.wrap(text, width, break_on_hyphens=False)
    from rich.console import Console
    from rich.text import Text

    return [line.plain.rstrip() for line in Text(text).wrap(Console(width=width), width)]


def _cell(value: object) -> str:
    if value is None:
        return NOTHING
    return f"{value:.4g}" if isinstance(value, float) else escape_controls(str(value)).replace("\n", " ")


def print_sentence(text: str) -> None:
    """Print a sentence in as many lines as it needs."""
    print(*_wrap(escape_controls(text), min(_width() or WIDTH, WIDTH)), sep="\n")


def print_reasons(subject: str, reasons: Iterable[object]) -> None:
    """Print what is said of something: its name, then a reason a line."""
    print_sentence(subject)
    for reason in reasons:
        first, *others = _wrap(escape_controls(str(reason)), min(_width() or WIDTH, WIDTH) - len(BELOW)) or [""]
        print(f"  - {first}", *(f"{BELOW}{line}" for line in others), sep="\n")


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

    def __init__(self, items: str, total: int, done: int = 0) -> None:
        self._items, self._total, self._start, self._printed_s = items, total, time.monotonic(), 0.0
        self._before = self._done = done

    def step(self, note: str = "", count: int = 1) -> None:
        self.show_progress(self._done + count, note)

    def show_progress(self, done: int, note: str = "") -> None:
        """Show that so many items are finished by now, whoever finished them."""
        self._done = done
        elapsed_s = time.monotonic() - self._start
        is_last = self._done >= self._total
        is_terminal = sys.stderr.isatty()
        if not is_last and elapsed_s - self._printed_s < (0.1 if is_terminal else 5.0):
            return
        self._printed_s = elapsed_s
        speed_per_s = (self._done - self._before) / max(elapsed_s, 1e-9)
        parts = [f"{self._done}/{self._total} {self._items}, {_duration(elapsed_s)}"]
        if speed_per_s:
            parts.append(f", {speed_per_s:.3g} {self._items}/s")
            if not is_last:
                parts.append(f", about {_duration((self._total - self._done) / speed_per_s)} left")
        parts += [f"  {note}"] if note else []
        # A line that is folded cannot be written over.
        while is_terminal and len(parts) > 1 and _cells_of("".join(parts)) >= shutil.get_terminal_size().columns:
            parts.pop()
        _show_progress("".join(parts), is_last)


class ProgressBar:
    """Lines like `[######......] 50 %, 38 s, about 38 s left  unit S2` on standard error, from 0 to 1 of one task.

    The first line comes at once. A terminal has one line that is written over, by characters that need no colours.
    """

    def __init__(self, note: str) -> None:
        self._start_s, self._printed_s = time.monotonic(), -math.inf
        self.show_progress(0.0, note)

    def show_progress(self, share: float, note: str = "") -> None:
        """Show that this share of the task is done, and what happens now."""
        now_s, is_terminal = time.monotonic(), sys.stderr.isatty()
        if share < 1.0 and now_s - self._printed_s < (0.1 if is_terminal else 5.0):
            return
        self._printed_s, elapsed_s = now_s, now_s - self._start_s
        filled = round(BAR_WIDTH * share)
        parts = [f"[{'#' * filled}{'.' * (BAR_WIDTH - filled)}] {share:.0%}, {_duration(elapsed_s)}"]
        if 0.0 < share < 1.0:
            parts.append(f", about {_duration(elapsed_s * (1.0 - share) / share)} left")
        parts += [f"  {escape_controls(note)}"] if note else []
        while is_terminal and len(parts) > 1 and _cells_of("".join(parts)) >= shutil.get_terminal_size().columns:
            parts.pop()
        _show_progress("".join(parts), share >= 1.0)


def _show_progress(line: str, is_last: bool) -> None:
    """Print a line on standard error; a terminal's next one is written over it."""
    is_terminal = sys.stderr.isatty()
    end = "\n" if is_last or not is_terminal else ""
    print(f"\r\x1b[K{line}" if is_terminal else line, end=end, file=sys.stderr, flush=True)


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
