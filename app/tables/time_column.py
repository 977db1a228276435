"""Time column and date column of a table, by the heading, else by the cells."""

import re
from collections.abc import Sequence

import numpy as np

from softcal.app.tables.numbers import to_numbers
from softcal.app.tables.stamp_text import is_stamp
from softcal.app.tables.table import Column
from softcal.core.errors import InputError
from softcal.core.recording import RATE_TOLERANCE, Array

PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "ticks": 1e7, "min": 1 / 60, "h": 1 / 3600}
"""Units of time, and how many of them a second has; Windows counts ticks of 100 ns."""

UNIT_TOKENS = {
    "s": ("s", "sec", "secs", "second", "seconds", "sek", "sekunden", "초", "秒"),
    "ms": ("ms", "msec", "msecs", "millis", "millisecond", "milliseconds", "밀리초", "毫秒"),
    "us": ("us", "µs", "μs", "usec", "usecs", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanos", "nanosecond", "nanoseconds"),
    "min": ("min", "mins", "minute", "minutes", "minuten", "분"),
    "h": ("h", "hr", "hrs", "hour", "hours"),
}
UNIT_OF = {token: unit for unit, tokens in UNIT_TOKENS.items() for token in tokens}
BARE_UNITS = {token for unit in ("s", "ms", "us") for token in UNIT_TOKENS[unit]} - {"s", "us"}
"""Units that name a column of time alone; `min` is as often the minimum."""

TIME_HEADINGS = {
    ("t",), ("time",), ("timestamp",), ("timestamps",), ("time", "stamp"), ("stamp",), ("datetime",), ("date", "time"),
    ("elapsed",), ("clock",), ("utc",), ("elapsedtime",), ("testtime",),
    ("elapsed", "time"), ("time", "elapsed"), ("test", "time"), ("run", "time"), ("relative", "time"), ("x", "value"),
    ("time", "of", "day"), ("fractional",), ("local", "time"),
    ("zeit",), ("uhrzeit",), ("zeitstempel",), ("temps",), ("heure",), ("tiempo",), ("hora",), ("시간",), ("시각",),
    ("時間",), ("時刻",), ("时间",), ("日時",), ("일시",),
}  # fmt: skip
"""Headings of a column of time, without its unit."""

DATE_HEADINGS = frozenset({"date", "datum", "fecha", "data", "날짜", "日付", "日期"})
PATTERN_TOKENS = frozenset({"hh", "mm", "ss", "fff", "yyyy", "yy", "dd", "yyyymmdd", "hhmmss", "ddmmyyyy", "mmddyyyy"})
"""Words of headings that state how a stamp is written."""

INDEX = "index"
"""Name of the rows of a data frame, which may be dates."""

MIN_NEW_STAMPS = 0.5
"""Share of samples whose stamp is later than the one before; below it the clock is too coarse for them."""

EVEN_SHARE, EVEN_WITHIN = 0.9, 0.25
"""Steps of a clock are alike: so many of them differ from the median one by this share of it at most."""

BACK_SHARE = 0.7
"""An output that ends within this share of its range from where it began was pressed and let go."""


def split_heading(name: str) -> tuple[str, ...]:
    """Return the words of a heading in small letters, without numbers and marks."""
    return tuple(
        token for token in re.split(r"[^a-zµμ\u00c0-\u024f\uac00-\ud7a3\u4e00-\u9fff]+", name.lower()) if token
    )


def find_declared_unit(column: Column) -> str | None:
    """Return the unit of time that a heading or a row of units states; None where they state none."""
    for text in (column.unit, column.name):
        units = [UNIT_OF[token] for token in split_heading(text) if token in UNIT_OF]
        if units:
            return units[-1]
    return None


def is_time_heading(name: str) -> bool:
    """Return whether a heading names a time column."""
    tokens = split_heading(name)
    bare = tuple(token for token in tokens if token not in UNIT_OF and token not in PATTERN_TOKENS)
    return bare in TIME_HEADINGS or (len(tokens) == 1 and tokens[0] in BARE_UNITS)


def is_date_heading(name: str) -> bool:
    """Return whether a heading names a date column."""
    first, *others = split_heading(name) or ("",)
    return first in DATE_HEADINGS and PATTERN_TOKENS.issuperset(others)


def is_clock_heading(name: str) -> bool:
    """Whether a column of this name may hold the time or its date."""
    return is_time_heading(name) or is_date_heading(name) or name == INDEX


def find_time_column(names: Sequence[str], columns: Sequence[Column] = ()) -> str | None:
    """Return the heading of the time column, or None.

    Args:
        columns: cells of the table: an index of dates is a time, and a clock that stands still in most rows is none.

    Raises:
        InputError: several columns may be it.
    """
    if "t_s" in names:
        return "t_s"
    dates = {column.name for column in columns if column.name == INDEX and column.cells.dtype.kind in "mM"}
    times = [name for name in names if is_time_heading(name) or name in dates]
    if len(times) > 1:
        repeating_names = {
            column.name for column in columns if np.mean(column.cells[1:] != column.cells[:-1]) < MIN_NEW_STAMPS
        }
        times = [name for name in times if name not in repeating_names] or times
    cells = {column.name: column.cells for column in columns}
    if len(times) > 1 and all(name in cells and np.array_equal(cells[times[0]], cells[name]) for name in times):
        return times[0]
    return _require_single(times) if times else None


def find_time_by_cells(columns: Sequence[Column], output: Array, rate_Hz: float | None) -> tuple[str | None, str]:
    """Return the column that rises like a clock, with its evidence, or None.

    Args:
        columns: those that may be it.
        output: (n,) output of the same rows.
        rate_Hz: declared rate; tells the unit of a clock and the column that counts samples.

    Raises:
        InputError: several columns may be it, or one that may be something else.
    """
    stamps = [column.name for column in columns if _is_stamped(column)]
    numbers = {column.name: values for column in columns if (values := _rising_values(column)) is not None}
    rising = [column for column in columns if column.name in numbers]
    unit_columns = [column.name for column in rising if column.unit and find_declared_unit(column)]
    unit_columns = unit_columns or [column.name for column in rising if not column.unit and find_declared_unit(column)]
    if candidates := stamps or unit_columns:
        return _require_single(candidates), "it holds stamps that rise" if stamps else "it rises, in a unit of time"
    # Whatever has another unit is no time.
    steps = {
        c.name: float(np.median(np.diff(numbers[c.name]))) for c in rising if not c.unit and _is_even(numbers[c.name])
    }
    if rate_Hz is not None:
        fitting = [name for name, step in steps.items() if _is_period(step, rate_Hz)]
        if fitting:
            return _require_single(fitting), f"its steps are those of {rate_Hz:g} Hz"
        counting = [name for name, step in steps.items() if step == 1 and not np.any(numbers[name] % 1)]
        return (counting[0], f"it counts samples at {rate_Hz:g} Hz") if len(counting) == 1 else (None, "")
    if len(steps) > 1:
        return _require_single(list(steps)), ""
    for name in steps:
        is_pressed = abs(output[-1] - output[0]) < BACK_SHARE * np.ptp(output)
        if not np.any(numbers[name] % 1) or not is_pressed:
            raise InputError(
                f"there is no column of time such as 't_s'; {name!r} rises evenly and may be it: name it with "
                "--time-column and state its unit with --time-format, or give the sample rate"
            )
        return name, "it alone rises evenly; name another with --time-column"
    return None, ""


def _require_single(names: Sequence[str]) -> str:
    if len(names) > 1:
        raise InputError(f"{' and '.join(map(repr, names[:4]))} may be the column of time; name it with --time-column")
    return names[0]


def _is_stamped(column: Column) -> bool:
    """Whether a column holds dates or times of day that go on."""
    cells = column.cells
    if cells.dtype.kind == "O":
        texts = [cell if isinstance(cell, str) else str(cell) for cell in cells if cell is not None and cell == cell]
        if sum(map(is_stamp, texts)) <= 0.9 * len(cells):
            return False
    elif cells.dtype.kind not in "mM":
        return False
    return bool(np.mean(cells[1:] != cells[:-1]) >= MIN_NEW_STAMPS)


def _rising_values(column: Column) -> Array | None:
    """Return a column of numbers that rises from row to row, or None."""
    values = to_numbers(column.cells) if column.cells.dtype.kind in "iuf" else None
    return values if values is not None and len(values) > 2 and bool(np.all(np.diff(values) > 0)) else None


def parts_per_second(column: Column) -> float | None:
    """Return the parts per second of a column that counts them next to a clock of whole seconds, or None.

    Whole numbers of ms below 1000, or fractional seconds below 1, which begin again.
    """
    values, tokens = to_numbers(column.cells), split_heading(column.name)
    parts = {("ms",): 1000.0, ("fractional", "seconds"): 1.0}.get(tokens)
    if values is None or parts is None or not np.any(np.diff(values) < 0):
        return None
    is_part = (values >= 0) & (values < parts) & ((values % 1 == 0) | (parts == 1))
    return parts if np.all(is_part) else None


def _is_even(values: Array) -> bool:
    steps = np.diff(values)
    usual = float(np.median(steps))
    return bool(np.mean(np.abs(steps - usual) <= EVEN_WITHIN * usual) >= EVEN_SHARE)


def _is_period(step: float, rate_Hz: float) -> bool:
    return any(abs(per / step / rate_Hz - 1) <= RATE_TOLERANCE for per in PER_SECOND.values())
