"""A column of time into seconds: what states its unit is read, what does not is asked about."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.files.recording_file import inspect_recording
from softcal.app.tables.read import read_table
from softcal.app.tables.time_column import find_time_column
from softcal.app.tables.timestamps import Clock
from softcal.core.errors import InputError

ROWS = 60
TIME = np.arange(ROWS) / 50


def _at(*parts: int) -> datetime:
    return datetime(*parts, tzinfo=UTC)  # type: ignore[arg-type,misc]


START = _at(2026, 3, 4, 23, 59, 59, 500000)


def _seconds(path: Path, stamps: list[object], name: str = "time", delimiter: str = ";", **clock: object) -> np.ndarray:
    path = path / "a.csv"
    path.write_text("\n".join([f"{name}{delimiter}output", *(f"{stamp}{delimiter}0.5" for stamp in stamps)]) + "\n")
    return Clock(name, **clock).seconds(read_table(path))  # type: ignore[arg-type]


def _stamps(pattern: str, digits: int = 6, start: datetime = START) -> list[object]:
    return [(start + timedelta(milliseconds=20 * k)).strftime(pattern)[: digits - 6 or None] for k in range(ROWS)]


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("t_s", 1),
        ("time", 1),
        ("time_ms", 1e3),
        ("Time (ms)", 1e3),
        ("t [us]", 1e6),
        ("millis", 1e3),
        ("micros", 1e6),
        ("timestamp_ns", 1e9),
        ("elapsed [min]", 1 / 60),
        ("Zeit (s)", 1),
    ],
)
def test_the_heading_states_the_unit(name: str, scale: float, tmp_path: Path) -> None:
    np.testing.assert_allclose(_seconds(tmp_path, list(TIME * scale), name), TIME, rtol=1e-12)


def test_a_row_of_units_states_the_unit(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,output\n(ms),(V)\n" + "\n".join(f"{20 * k},0.5" for k in range(ROWS)))
    np.testing.assert_allclose(Clock("time").seconds(read_table(path)), TIME)


@pytest.mark.parametrize("step", [1, 2, 20, 20_000])
@pytest.mark.parametrize("name", ["time", "t", "t_s"])
def test_numbers_that_may_be_in_milliseconds_are_asked_about(step: int, name: str, tmp_path: Path) -> None:
    stamps: list[object] = [step * k for k in range(ROWS)]
    with pytest.raises(InputError, match="--time-format"):
        _seconds(tmp_path, stamps, name)
    np.testing.assert_allclose(_seconds(tmp_path, stamps, name, time_format="ms"), step * np.arange(ROWS) / 1000)
    np.testing.assert_allclose(_seconds(tmp_path, stamps, name, time_format="s"), step * np.arange(ROWS))


def test_a_declared_rate_tells_the_unit_that_nobody_states(tmp_path: Path) -> None:
    np.testing.assert_allclose(_seconds(tmp_path, [20 * k for k in range(ROWS)], rate_Hz=50.0), TIME)
    with pytest.raises(InputError, match="--time-format"):
        _seconds(tmp_path, [20 * k for k in range(ROWS)], rate_Hz=60.0)


@pytest.mark.parametrize(
    "stamps",
    [
        _stamps("%Y-%m-%dT%H:%M:%S.%f"),
        _stamps("%Y-%m-%d %H:%M:%S.%f", 3),
        _stamps("%Y-%m-%dT%H:%M:%S.%fZ", 6),
        _stamps("%Y-%m-%dT%H:%M:%S.%f+09:00"),
        _stamps("%Y-%m-%d %H:%M:%S,%f"),
        _stamps("%Y/%m/%d %H:%M:%S.%f"),
        _stamps("%Y%m%dT%H%M%S.%f"),
        _stamps("%d.%m.%Y %H:%M:%S.%f"),
        _stamps("%d.%m.%Y %H:%M:%S,%f"),
        _stamps("%H:%M:%S.%f"),
        _stamps("%H:%M:%S.%f", 3),
        _stamps("%H:%M:%S:%f", 3),
        _stamps("%M:%S.%f", start=_at(2026, 1, 1)),
        _stamps("%d/%m/%Y %H:%M:%S.%f", start=_at(2026, 3, 4, 10)),
        _stamps("%m/%d/%Y %H:%M:%S.%f", start=_at(2026, 3, 24, 23, 59, 59)),
        _stamps("%d-%m-%Y %H:%M:%S.%f", start=_at(2026, 3, 14, 23, 59, 59)),
        _stamps("%I:%M:%S.%f %p", start=_at(2026, 3, 4, 11, 59, 59)),
        [1772668799.5 + 0.02 * k for k in range(ROWS)],
        [1772668799500 + 20 * k for k in range(ROWS)],
        [1772668799500000 + 20000 * k for k in range(ROWS)],
    ],
)
def test_dates_and_times_of_day_become_seconds_since_the_first(stamps: list[object], tmp_path: Path) -> None:
    t_s = _seconds(tmp_path, stamps)
    np.testing.assert_allclose(t_s - t_s[0], TIME, atol=1e-6)


def test_a_declared_pattern_is_used(tmp_path: Path) -> None:
    stamps = _stamps("%d/%m/%y %H-%M-%S.%f")
    with pytest.raises(InputError, match="line 2.*--time-format"):
        _seconds(tmp_path, stamps)
    t_s = _seconds(tmp_path, stamps, time_format="%d/%m/%y %H-%M-%S.%f")
    np.testing.assert_allclose(t_s, TIME, atol=1e-9)
    with pytest.raises(InputError, match="line 2"):
        _seconds(tmp_path, stamps, time_format="%H:%M")


def test_a_day_that_may_be_a_month_is_asked_about_where_it_matters(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="day or the month"):
        _seconds(tmp_path, _stamps("%d/%m/%Y %H:%M:%S.%f", start=_at(2026, 3, 4, 23, 59, 59, 500000)))


def test_zones_that_change_are_followed_and_missing_ones_refused(tmp_path: Path) -> None:
    zoned = ["2026-10-25T02:59:59.98+02:00", "2026-10-25T02:00:00.00+01:00", "2026-10-25T02:00:00.02+01:00"]
    np.testing.assert_allclose(_seconds(tmp_path, list(zoned)), [0, 0.02, 0.04])
    with pytest.raises(InputError, match="line 3.*zone"):
        _seconds(tmp_path, [zoned[0], "2026-10-25T02:00:00.00", zoned[2]])


@pytest.mark.parametrize(
    ("name", "counter", "step"), [("millis", 2**32, 20), ("micros", 2**32, 20000), ("t_ms", 2**16, 20)]
)
def test_only_a_counter_that_wraps_within_one_sample_goes_on(
    name: str, counter: int, step: int, tmp_path: Path
) -> None:
    start = counter - 30 * step + 7
    stamps: list[object] = [(start + step * k) % counter for k in range(ROWS)]
    t_s = _seconds(tmp_path, stamps, name)
    np.testing.assert_allclose(np.diff(t_s), np.diff(t_s)[0], rtol=1e-6)
    for late in (stamps[:28] + stamps[35:], [*range(0, 40 * step, step), *range(0, 20 * step, step)]):
        with pytest.raises(InputError, match="line .*goes back"):
            _seconds(tmp_path, list(late), name)


def test_time_that_goes_back_is_refused_with_its_line(tmp_path: Path) -> None:
    stamps: list[object] = list(TIME)
    stamps[30] = 0.1
    with pytest.raises(InputError, match="line 32.*goes back"):
        _seconds(tmp_path, stamps, "t_s")
    with pytest.raises(InputError, match="line 5.*'later'"):
        _seconds(tmp_path, [*_stamps("%H:%M:%S.%f")[:3], "later", *_stamps("%H:%M:%S.%f")[4:]])


def test_empty_stamps_are_missing(tmp_path: Path) -> None:
    stamps: list[object] = list(TIME)
    stamps[5] = ""
    assert np.flatnonzero(np.isnan(_seconds(tmp_path, stamps, "t_s"))).tolist() == [5]
    texts = _stamps("%Y-%m-%dT%H:%M:%S.%f")
    texts[5] = ""
    assert np.flatnonzero(np.isnan(_seconds(tmp_path, texts))).tolist() == [5]


@pytest.mark.parametrize("kind", ["date", "zone", "delta"])
def test_dates_of_other_formats_are_exact(kind: str, tmp_path: Path) -> None:
    stamps = pd.date_range("2026-01-01", periods=ROWS, freq="20ms", tz="Asia/Seoul" if kind == "zone" else None)
    times = stamps - stamps[0] if kind == "delta" else stamps
    pd.DataFrame({"time": times, "output": 0.5}).to_parquet(tmp_path / "a.parquet")
    np.testing.assert_array_equal(Clock("time").seconds(read_table(tmp_path / "a.parquet")), TIME)


def test_dates_of_a_sheet_are_read(tmp_path: Path) -> None:
    times = pd.date_range("2026-01-01 23:59:59.5", periods=ROWS, freq="20ms").to_pydatetime()
    path = tmp_path / "a.xlsx"
    pd.DataFrame({"time": times, "output": 0.5}).to_excel(path, index=False)
    np.testing.assert_allclose(Clock("time").seconds(read_table(path)), TIME, atol=1.1e-3)


@pytest.mark.parametrize(
    ("names", "time_column"),
    [
        (["output", "t_s", "time"], "t_s"),
        (["Time (s)", "output"], "Time (s)"),
        (["Timestamp", "out"], "Timestamp"),
        (["millis", "out"], "millis"),
        (["output", "force_N"], None),
        (["Elapsed time [ms]", "V"], "Elapsed time [ms]"),
        (["t_ms", "s", "min", "output"], "t_ms"),
        (["시간", "출력"], "시간"),
        (["temperature", "timer", "output"], None),
    ],
)
def test_a_column_of_time_is_found_by_its_heading(names: list[str], time_column: str | None) -> None:
    assert find_time_column(names) == time_column


def test_two_columns_of_time_are_asked_about() -> None:
    with pytest.raises(InputError, match="--time-column"):
        find_time_column(["Timestamp", "Elapsed time (s)", "output"])


def test_seconds_since_1904_are_labview_s(tmp_path: Path) -> None:
    path = tmp_path / "S1.csv"
    rows = [f"{3_798_525_599.64 + k / 50:.3f},{0.5 + 0.1 * (k % 40):.3f}" for k in range(60)]
    path.write_text("Time,output\n" + "\n".join(rows) + "\n")
    file = inspect_recording(path, "S1", None)
    assert file.recording.sample_rate_Hz == pytest.approx(50)
    assert file.start is not None and file.start.at.isoformat(timespec="seconds") == "2024-05-14T09:59:59+00:00"
