"""A column of time into seconds: numbers in a unit, dates with or without a zone, times of day, counters that wrap."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.numbers import THOUSANDS, Kind, cell_kind, number_cure, show_cell
from softcal.app.tables.stamp_text import (
    CLOCK_TIME,
    DAY_MONTH,
    ELAPSED_DAYS,
    YEAR_FIRST,
    ZONE,
    find_zone,
    normalize_stamp,
    point_fraction,
    to_iso_stamp,
)
from softcal.app.tables.table import Column, Table
from softcal.app.tables.time_column import MIN_NEW_STAMPS, PER_SECOND, split_heading
from softcal.app.tables.time_unit import CURE, EPOCHS, SAMPLES, number_unit
from softcal.core.errors import InputError
from softcal.core.recording import Array

EXCEL_ZERO_S, TICKS_ZERO_S = -25_569 * 86400, -11_644_473_600
"""Where the days of a spreadsheet and the ticks of Windows begin: 1899-12-30 and 1601, in s since 1970."""

LABVIEW_ZERO_S, LABVIEW_AHEAD_S = -2_082_844_800, 30 * 365.25 * 86400
"""Where LabVIEW's seconds begin, 1904; taken from 1970 they are so far ahead of today at least."""

UTC_NAMES = frozenset({"utc", "gmt"})
"""Words of a heading, or a unit, that state the zone of a column's stamps."""

COUNTERS = (2**16, 2**32)
"""Where counters of ms and us begin again."""

DAY_S = 86400.0
CLOCK_BACK = {
    3600.0: "the clock was put back by an hour; write the stamps in UTC or with their offset, such as +01:00",
    43200.0: "a clock of 12 hours begins again at 1; write the stamps with AM and PM, or with 24 hours",
}
"""By how many s clocks are put back, and what to do."""
RESTART_QUESTION = "was the logger started again? split the file there, or sort its lines"

WITHIN_ONE_SAMPLE = 1.5
"""Largest step over the end of a counter, in median steps."""

MAX_MIDNIGHT_GAP_S = 600.0
"""Rows may be lost over midnight; a time of day that goes back by nearly a day can be nothing else."""


@dataclass(frozen=True)
class Start:
    """Time of the first sample of a recording, UTC.

    Args:
        is_local: its stamps state no zone and were taken as local time of this computer.
    """

    at: datetime
    is_local: bool


@dataclass
class Clock:
    """Converter of a time column in pieces; the layout detected in the first piece applies to all.

    Args:
        name: heading of the column.
        time_format: declared unit or pattern; None detects it.
        rate_Hz: declared rate: of units that nobody states it tells the right one.
        is_absolute: keeps dates as seconds since 1970 instead of since the first sample.
        date: heading of the date column next to times of day.
        rest_of_second: heading of the column that holds the rest of each whole second, and its parts a second.
        start: when the first sample was taken, once that was read; None where stamps are not absolute.
    """

    name: str
    time_format: str | None = None
    rate_Hz: float | None = None
    is_absolute: bool = False
    date: str | None = None
    rest_of_second: tuple[str, float] | None = None
    remarks: list[str] = field(default_factory=list)
    start: Start | None = None
    _unit: str | None = None
    _origin_ns: int | None = None
    _last: float = float("nan")
    _wrapped_s: float = 0.0

    def seconds(self, table: Table, cure: str = "") -> Array:
        """Return (n,) seconds, NaN where the stamp is missing.

        Raises:
            InputError: no such column, an invalid stamp, decreasing time, or an undecided unit.
        """
        column = table.column(self.name, cure)
        cells, time_format = column.cells, self.time_format
        wraps: tuple[float, ...] = ()
        is_pattern = time_format is not None and time_format not in (*PER_SECOND, "iso", "excel")
        if self.date is not None and _are_times_of_day(cells):
            dated_values = self._with_dates(table, column, str(time_format) if is_pattern else None)
            if dated_values is not None:
                return self._unwrap_time(table, dated_values, (DAY_S,))
        if cells.dtype.kind in "mM":
            values = self._from_dates(cells, column.unit)
        elif cells.dtype.kind == "O" and not is_pattern and _are_numbers(cells, table.decimal):
            # One text among numbers is named by its line.
            values, wraps = self._from_numbers(table, column)
        elif cells.dtype.kind == "O":
            values, wraps = self._from_objects(table, column, time_format if is_pattern else None), (DAY_S,)
        elif is_pattern:
            texts = np.array([None if np.isnan(v) else f"{v:.15g}" for v in cells.astype(float)], dtype=object)
            values, wraps = self._parse_pattern(table, texts, str(time_format)), (DAY_S,)
        else:
            values, wraps = self._from_numbers(table, column)
        return self._unwrap_time(table, values, wraps)

    def _with_dates(self, table: Table, column: Column, pattern: str | None) -> Array | None:
        """Return times of day joined with their dates; None if the file has one constant text that is no date.

        A date in the first row alone applies to the rows below it.
        """
        dates = table.column(str(self.date)).cells
        if dates.dtype.kind not in "OM":
            return None
        texts = _to_texts(dates)
        if dates.dtype.kind == "M" or any(isinstance(cell, date) for cell in dates):
            texts = np.array([text and text[:10] for text in texts], dtype=object)
        for row in range(1, len(texts)):
            texts[row] = texts[row] or texts[row - 1]
        times = np.array([text and normalize_stamp(text) for text in _to_texts(column.cells)], dtype=object)
        if pattern is not None and any(f"%{mark}" in pattern for mark in "dDjFxcsyYmbB"):
            joined = [day and at and f"{day} {at}" for day, at in zip(texts, times, strict=True)]
            return self._parse_pattern(table, np.array(joined, dtype=object), pattern)
        try:
            days = Clock(str(self.date), is_absolute=True)._parse_dates(
                table, np.array([text and normalize_stamp(text) for text in texts], dtype=object)
            )
        except InputError:
            if len({text for text in texts if text}) > 1:
                raise
            return None
        seconds = self._times_of_day(table, times) if pattern is None else self._parse_pattern(table, times, pattern)
        is_missing = np.isnan(days) | np.isnan(seconds)
        counts = np.where(is_missing, 0, days).astype(np.int64) * 10**9
        return self._elapsed_seconds(
            counts + np.round(np.where(is_missing, 0, seconds) * 1e9).astype(np.int64), is_missing
        )

    def _from_dates(self, cells: NDArray[Any], unit: str = "") -> Array:
        is_stamp = cells.dtype.kind == "M"
        counts = cells.astype("datetime64[ns]" if is_stamp else "timedelta64[ns]").astype(np.int64)
        return self._elapsed_seconds(counts, np.isnat(cells), is_stamp, has_zone=unit.lower() in UTC_NAMES)

    def _elapsed_seconds(
        self,
        counts_ns: NDArray[np.int64],
        is_missing: NDArray[np.bool_],
        is_stamp: bool = True,
        *,
        has_zone: bool = False,
        zero_s: int = 0,
    ) -> Array:
        present = counts_ns[~is_missing]
        if self._origin_ns is None and len(present):
            if is_stamp:
                self._start_at(int(present[0]) / 1e9 + zero_s, has_zone=has_zone)
            self._origin_ns = 0 if self.is_absolute or not is_stamp else int(present[0])
        values = (counts_ns - (self._origin_ns or 0)) / 1e9
        return np.where(is_missing, np.nan, values)

    def _start_at(self, seconds: float, *, has_zone: bool) -> None:
        """Store the time of the first sample; a clock that was never set shows a year before 2001."""
        low, high = EPOCHS["s"]
        if self.start is None and low <= seconds < high:
            is_local = not has_zone and not UTC_NAMES & set(split_heading(self.name))
            at = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
            self.start = Start(at.replace(tzinfo=None).astimezone(UTC) if is_local else at, is_local)

    def _from_numbers(self, table: Table, column: Column) -> tuple[Array, tuple[float, ...]]:
        values = table.numbers(self.name)
        if self._unit is None:
            self._unit, remark = number_unit(table.path, column, values, self.time_format, self.rate_Hz)
            self.remarks += [remark] if remark else []
        if self._unit == "excel":
            return self._elapsed_seconds(
                np.round(np.nan_to_num(values) * DAY_S * 1e6).astype(np.int64) * 1000,
                np.isnan(values),
                zero_s=EXCEL_ZERO_S,
            ), ()
        per_second = float(self.rate_Hz or 1.0) if self._unit == SAMPLES else PER_SECOND[self._unit]
        present = values[np.isfinite(values)]
        if self._unit != SAMPLES and len(present):
            zero_s = TICKS_ZERO_S if self._unit == "ticks" else 0
            start_s = float(present[0]) / per_second + zero_s
            # LabVIEW counts from 1904; nobody measures in the 2080s yet.
            is_ahead = start_s > datetime.now(UTC).timestamp() + LABVIEW_AHEAD_S
            self._start_at(start_s + LABVIEW_ZERO_S * is_ahead, has_zone=True)
        wraps = tuple(counter / per_second for counter in COUNTERS) if self._unit in ("ms", "us") else ()
        return values / per_second, wraps

    def _from_objects(self, table: Table, column: Column, pattern: str | None) -> Array:
        texts = _to_texts(column.cells)
        if pattern is not None:
            return self._parse_pattern(table, texts, pattern)
        texts = np.array([text and normalize_stamp(text) for text in texts], dtype=object)
        present = [text for text in texts if text]
        if sum(bool(ELAPSED_DAYS.fullmatch(text)) for text in present) > len(present) / 2:
            return self._elapsed_days(table, texts)
        if sum(bool(CLOCK_TIME.fullmatch(text)) for text in present) > len(present) / 2:
            return self._times_of_day(table, texts)
        return self._parse_dates(table, texts)

    def _elapsed_days(self, table: Table, texts: NDArray[Any]) -> Array:
        """Return `0 days 00:00:01.5`, as pandas writes a Timedelta, as seconds."""
        import pandas as pd

        spans = pd.to_timedelta(pd.Series(texts), errors="coerce").to_numpy()
        bad = [row for row, text in enumerate(texts) if text and np.isnat(spans[row])]
        if bad:
            raise self._stamp_error(table, bad[0], texts[bad[0]])
        return self._from_dates(spans)

    def _times_of_day(self, table: Table, texts: NDArray[Any]) -> Array:
        """Return `HH:MM:SS.f` (with a comma, AM, PM or `:mmm`) and `MM:SS.f` as seconds."""
        values = np.full(len(texts), np.nan)
        for row, text in enumerate(texts):
            if not text:
                continue
            match = CLOCK_TIME.fullmatch(text)
            if match is None:
                raise self._stamp_error(table, row, text)
            first, second, third, fraction, half = match.groups()
            if third is None and fraction is None:
                raise InputError(
                    f"{table.path}: line {table.lines[row]}, column {self.name!r}: {show_cell(text)} may be hours "
                    f"and minutes or minutes and seconds; {CURE}"
                )
            parts = [int(first), int(second), int(third)] if third is not None else [0, int(first), int(second)]
            hours = parts[0] % 12 + (12 if half[0] in "pP" else 0) if half else parts[0]
            values[row] = round((hours * 60 + parts[1]) * 60 + parts[2] + float(f"0.{fraction or 0}"), 9)
        return values

    def _parse_dates(self, table: Table, texts: NDArray[Any]) -> Array:
        """Return dates with times of day as seconds: ISO 8601, or day and month in an order that is certain."""
        present = np.flatnonzero([bool(text) for text in texts])
        plain = np.array([to_iso_stamp(texts[row]) for row in present], dtype=object)
        if not len(present):
            return np.full(len(texts), np.nan)
        if not YEAR_FIRST.match(plain[0]):
            return self._day_and_month(table, texts)
        zoned = [bool(ZONE.search(text)) for text in plain]
        if any(zoned) != all(zoned):
            row = int(present[zoned.index(not zoned[0])])
            raise InputError(
                f"{table.path}: line {table.lines[row]}, column {self.name!r}: {show_cell(texts[row])}: some stamps "
                "have a zone and others have none; write all of them with one"
            )
        return self._parse_stamps(table, texts, present, plain, "ISO8601")

    def _day_and_month(self, table: Table, texts: NDArray[Any]) -> Array:
        rows = [row for row, text in enumerate(texts) if text]
        matches = [DAY_MONTH.fullmatch(texts[row]) for row in rows]
        for row, match in zip(rows, matches, strict=True):
            if match is None:
                raise self._stamp_error(table, row, texts[row])
        dates = {match.group(1, 2, 3, 4) for match in matches if match is not None}
        day_first = {
            mark == "." or int(first) > 12 for first, mark, second, _ in dates if mark == "." or int(first) > 12
        }
        month_first = any(int(second) > 12 for _, mark, second, _ in dates if mark != ".")
        if len(dates) > 1 and not day_first and not month_first:
            raise InputError(
                f"{table.path}: column {self.name!r}: {show_cell(texts[rows[0]])} may begin with the day or the month; "
                "state the pattern, such as --time-format '%d/%m/%Y %H:%M:%S.%f'"
            )
        plain = []
        for match in matches:
            if match is None:
                continue
            first, mark, second, year, clock = match.group(1, 2, 3, 4, 5)
            day, month = (second, first) if month_first and mark != "." else (first, second)
            if int(month) > 12:
                day, month = month, day
            seconds = f"{clock.strip()}" if clock else "00:00:00"
            plain.append(
                f"{'20' if len(year) == 2 else ''}{year}-{int(month):02}-{int(day):02} {point_fraction(seconds)}"
            )
        return self._parse_stamps(table, texts, np.array(rows), np.array(plain, dtype=object), "mixed")

    def _parse_pattern(self, table: Table, texts: NDArray[Any], pattern: str) -> Array:
        present = np.flatnonzero([bool(text) for text in texts])
        return self._parse_stamps(table, texts, present, texts[present], pattern)

    def _parse_stamps(
        self, table: Table, texts: NDArray[Any], rows: NDArray[Any], plain: NDArray[Any], pattern: str
    ) -> Array:
        import pandas as pd

        try:
            stamps = pd.to_datetime(plain.tolist(), format=pattern, utc=True, errors="coerce")
        except (ValueError, TypeError) as error:
            raise InputError(f"{table.path}: column {self.name!r}: --time-format {pattern!r}: {error}") from error
        bad = np.flatnonzero(stamps.isna())
        if len(bad):
            raise self._stamp_error(table, int(rows[bad[0]]), texts[rows[bad[0]]])
        counts, is_missing = np.zeros(len(texts), dtype=np.int64), np.ones(len(texts), dtype=bool)
        counts[rows] = stamps.tz_localize(None).to_numpy().astype("datetime64[ns]").astype(np.int64)
        is_missing[rows] = False
        has_date = not pattern.startswith("%") or any(f"%{mark}" in pattern for mark in "dDjFxcsyYmbB")
        has_zone = bool(ZONE.search(str(plain[0]))) if pattern in ("ISO8601", "mixed") else "%z" in pattern.lower()
        return (
            self._elapsed_seconds(counts, is_missing, has_zone=has_zone)
            if has_date
            else np.where(is_missing, np.nan, (counts - counts[rows[0]] // (86400 * 10**9) * (86400 * 10**9)) / 1e9)
        )

    def _stamp_error(self, table: Table, row: int, cell: object) -> InputError:
        zone = find_zone(str(cell))
        usual = number_cure(cell, table.decimal) if THOUSANDS.fullmatch(str(cell)) else f"it is no time; {CURE}"
        cure = (
            f"the zone {zone} has several meanings or is not known: write the offset from UTC, such as +09:00, or give "
            f"--time-format with it, such as '%Y-%m-%d %H:%M:%S.%f {zone}'"
            if zone
            else usual
        )
        return InputError(f"{table.path}: line {table.lines[row]}, column {self.name!r}: {show_cell(cell)}: {cure}")

    def _unwrap_time(self, table: Table, values: Array, wraps: Sequence[float]) -> Array:
        """Return times that go forward: counters and days that begin again go on, anything else is refused."""
        if self.rest_of_second is not None:
            name, parts = self.rest_of_second
            values = values + table.numbers(name) / parts
        raw, values = values, values + self._wrapped_s
        rows = np.flatnonzero(np.isfinite(values))
        if not len(rows):
            return values
        previous_values = np.concatenate(
            [[self._last if np.isfinite(self._last) else values[rows[0]] - 1.0], values[rows[:-1]]]
        )
        steps = values[rows] - previous_values
        positive, negative = steps[steps > 0], steps[steps < 0]
        if len(negative) > MIN_NEW_STAMPS * len(steps):
            raise InputError(
                f"{table.path}: column {self.name!r}: time goes back from line to line; sort the lines by it"
            )
        if len(positive) + len(negative) < MIN_NEW_STAMPS * len(steps):
            raise InputError(
                f"{table.path}: column {self.name!r}: most stamps repeat the one before: its clock is coarser than "
                "the samples; name another column of time, or remove this one and give --sample-rate"
            )
        usual_step = float(np.median(positive)) if len(positive) else 0.0
        for k in np.flatnonzero(steps < 0):
            row, step = int(rows[k]), float(steps[k])
            # Just before the end of the counter, then just behind its beginning
            limits = [MAX_MIDNIGHT_GAP_S if wrap == DAY_S else WITHIN_ONE_SAMPLE * usual_step for wrap in wraps]
            # A signed counter begins again at its lowest number.
            is_wrap = [
                min(abs(raw[row]), abs(raw[row] + wrap / 2)) <= limit and 0 < step + wrap <= limit
                for wrap, limit in zip(wraps, limits, strict=True)
            ]
            matching_wraps = [wrap for wrap, is_match in zip(wraps, is_wrap, strict=True) if is_match]
            if not matching_wraps:
                is_day = wraps == (DAY_S,)
                clock_causes = (
                    cure for back_s, cure in CLOCK_BACK.items() if 0 < step + back_s <= WITHIN_ONE_SAMPLE * usual_step
                )
                cause = next(clock_causes, RESTART_QUESTION) if is_day else RESTART_QUESTION
                raise InputError(
                    f"{table.path}: line {table.lines[row]}, column {self.name!r}: time goes back by {-step:.6g} s; "
                    f"{cause}"
                )
            values[row:] += matching_wraps[0]
            self._wrapped_s += matching_wraps[0]
            event = "midnight passes" if matching_wraps[0] == DAY_S else "the counter of time begins again"
            self.remarks.append(f"line {table.lines[row]}: {event}; time goes on")
        self._last = float(values[rows[-1]])
        return values


def _are_numbers(cells: NDArray[Any], decimal: str) -> bool:
    """Whether most cells are numbers."""
    kinds = [kind for cell in cells if (kind := cell_kind(cell, decimal)) is not Kind.EMPTY]
    return kinds.count(Kind.NUMBER) > len(kinds) / 2


def _are_times_of_day(cells: NDArray[Any]) -> bool:
    """Whether most cells are times of day."""
    if cells.dtype.kind != "O":
        return False
    present = [cell for cell in cells if cell is not None and cell == cell]
    return sum(bool(CLOCK_TIME.fullmatch(normalize_stamp(str(cell)))) for cell in present) > len(present) / 2


def _to_texts(cells: NDArray[Any]) -> NDArray[Any]:
    """Return cells as texts, None for those that are missing; a duration of a sheet with its days."""
    spans = [
        f"{cell.days} days {timedelta(0, cell.seconds, cell.microseconds)}" if isinstance(cell, timedelta) else cell
        for cell in cells
    ]
    return np.array([None if cell is None or cell != cell else str(cell).strip() for cell in spans], dtype=object)


def median_rate_Hz(t_s: Array) -> float:
    """Return the sample rate that time stamps show, rounded to five digits; NaN where they never advance."""
    steps = np.diff(t_s[np.isfinite(t_s)])
    return float(f"{1 / np.median(steps[steps > 0]):.5g}") if np.any(steps > 0) else float("nan")
