"""The column of time where its heading does not say so, and where date and time of day stand in two columns."""

import re
from datetime import date, datetime, time, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import softcal
from softcal.app.files.import_plan import Columns, ImportPlan
from softcal.app.files.importing import import_lot
from softcal.app.files.recording_file import ColumnNames, inspect_recording
from softcal.app.files.stream_file import Stream
from softcal.app.tables.options import TableOptions
from softcal.core.errors import InputError
from softcal.core.lot import Lot

ROWS = 200
TIME = np.arange(ROWS) / 50
OUTPUT = np.round(0.5 - 0.3 * np.cos(2 * np.pi * TIME / 2), 5)
FORCE = np.round(5 * OUTPUT, 4)
START = datetime(2026, 3, 2, 23, 59, 58)  # noqa: DTZ001 - loggers write no zone


def _write(path: Path, headings: str, *columns: object) -> Path:
    rows = zip(*columns, OUTPUT, strict=True)  # type: ignore[call-overload]
    path.write_text("\n".join([f"{headings},output", *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def _times(path: Path, *, rate_Hz: float | None = None, time: str | None = None, **layout: object) -> np.ndarray:
    names = ColumnNames("output", time, rate_Hz=rate_Hz, table=TableOptions(**layout))  # type: ignore[arg-type]
    recording = inspect_recording(path, "U", None, names=names).recording
    pieces = [t_s for t_s, _ in Stream(path, names).pieces()]
    np.testing.assert_allclose(np.concatenate(pieces), recording.t_s, atol=1e-9)
    return recording.t_s - recording.t_s[0]


def _stamps(pattern: str, gap_days: int = 0) -> list[str]:
    stamps = [START + timedelta(milliseconds=20 * k, days=gap_days * (k >= ROWS // 2)) for k in range(ROWS)]
    return [stamp.strftime(pattern) for stamp in stamps]


@pytest.mark.parametrize("day", ["%Y-%m-%d", "%d.%m.%Y", "%Y/%m/%d", "%m/%d/%Y"])
@pytest.mark.parametrize("days", [0, 1])
def test_a_date_beside_a_time_of_day_is_joined_to_it(day: str, days: int, tmp_path: Path) -> None:
    if day == "%m/%d/%Y" and days == 0:
        return  # The second and the third of March, or the third of February and of March: asked below.
    path = _write(tmp_path / "a.csv", "Date,Time", _stamps(day, 20 * days), _stamps("%H:%M:%S.%f", 20 * days))
    stamps = TIME + 86400 * 20 * days * (np.arange(ROWS) >= ROWS // 2)
    np.testing.assert_allclose(_times(path), stamps, atol=1e-6)
    np.testing.assert_allclose(_times(path, time="Time"), stamps, atol=1e-6)
    np.testing.assert_allclose(_times(path, time_format=f"{day} %H:%M:%S.%f"), stamps, atol=1e-6)


def test_rows_lost_over_midnight_leave_a_gap(tmp_path: Path) -> None:
    kept_rows = np.delete(np.arange(ROWS), range(90, 130))
    stamps = np.array(_stamps("%H:%M:%S.%f"))[kept_rows]
    path = tmp_path / "a.csv"
    rows = [f"{stamp},{OUTPUT[k]}" for stamp, k in zip(stamps, kept_rows, strict=True)]
    path.write_text("\n".join(["time,output", *rows]) + "\n")
    np.testing.assert_allclose(_times(path), TIME[kept_rows], atol=1e-6)


def test_a_date_whose_day_and_month_nobody_can_tell_is_asked_about(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", "Datum,Uhrzeit", _stamps("%m/%d/%Y"), _stamps("%H:%M:%S.%f"))
    with pytest.raises(InputError, match="day or the month.*--time-format"):
        _times(path)
    np.testing.assert_allclose(_times(path, time_format="%m/%d/%Y %H:%M:%S.%f"), TIME, atol=1e-6)


def test_dates_and_times_of_a_workbook_are_joined(tmp_path: Path) -> None:
    stamps = [START + timedelta(milliseconds=20 * k, days=2 * (k >= 100)) for k in range(ROWS)]
    days, times = [stamp.date() for stamp in stamps], [stamp.time() for stamp in stamps]
    pd.DataFrame({"Date": days, "Time": times, "output": OUTPUT}).to_excel(tmp_path / "a.xlsx", index=False)
    t_s = _times(tmp_path / "a.xlsx")
    assert t_s[100] - t_s[99] == pytest.approx(2 * 86400 + 0.02) and t_s[-1] == pytest.approx(2 * 86400 + TIME[-1])


def test_a_date_beside_seconds_from_the_start_is_not_added(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", "Date,Time", [date(2026, 3, 2)] * ROWS, TIME)
    np.testing.assert_allclose(_times(path), TIME, atol=1e-9)


@pytest.mark.parametrize(
    ("heading", "cells"),
    [
        ("Ablauf [s]", TIME),
        ("Laufzeit_ms", np.round(TIME * 1000)),
        ("moment (us)", np.round(TIME * 1e6)),
        ("measured at", _stamps("%Y-%m-%dT%H:%M:%S.%f")),
        ("when", [time(10, 0, 1 + k // 50, 20000 * (k % 50)).isoformat("microseconds") for k in range(ROWS)]),
        ("clk", np.round(TIME, 3)),
        ("clk", np.round(TIME + 0.001 * (np.arange(ROWS) % 3), 4)),
    ],
)
def test_a_time_under_another_heading_is_found_and_reported(heading: str, cells: object, tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", f"temperature,{heading}", np.round(20 + 0.1 * OUTPUT, 2), cells)
    np.testing.assert_allclose(_times(path), TIME, atol=0.0021)
    file = inspect_recording(path, "U", None, names=ColumnNames("output"))
    assert any(heading.split()[0] in remark for remark in file.remarks)
    np.testing.assert_allclose(softcal.Recording.read(path).unlabelled.t_s, file.recording.t_s)


def test_the_declared_rate_tells_unit_and_column(tmp_path: Path) -> None:
    hole = np.delete(np.arange(ROWS), range(80, 120))
    rows = zip(hole, np.round(TIME[hole] * 1000).astype(int), OUTPUT[hole], strict=True)
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["n,tick,output", *(",".join(map(str, row)) for row in rows)]) + "\n")
    np.testing.assert_allclose(_times(path, rate_Hz=50.0), TIME[hole])


def test_a_column_that_counts_samples_keeps_a_hole_open(tmp_path: Path) -> None:
    hole = np.delete(np.arange(ROWS), range(80, 120))
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["Sample,output", *(f"{k + 1},{OUTPUT[k]}" for k in hole)]) + "\n")
    np.testing.assert_allclose(_times(path, rate_Hz=50.0), TIME[hole])


@pytest.mark.parametrize(
    ("headings", "columns"),
    [
        ("clk,other", [TIME, 2 * TIME]),
        ("no", [np.arange(ROWS)]),
        ("tick", [np.arange(ROWS) * 20]),
        ("first at [s],second at [s]", [TIME, TIME + 0.3]),
    ],
)
def test_where_two_readings_are_possible_the_line_asks(headings: str, columns: list[object], tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", headings, *columns)
    with pytest.raises(InputError) as refusal:
        _times(path)
    assert "--time-column" in str(refusal.value) or "--time-format" in str(refusal.value)
    assert headings.split(",")[0] in str(refusal.value)


def test_what_rises_in_a_pull_is_no_time(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["Extension,output", *(f"{k / 100},{k / 400 + 0.1}" for k in range(ROWS))]) + "\n")
    with pytest.raises(InputError, match="'Extension'.*--time-column"):
        _times(path)
    path.write_text(path.read_text().replace("Extension", "Extension [mm]"))
    with pytest.raises(InputError, match=re.compile("no column of time")):
        _times(path)


def test_an_import_takes_a_time_under_another_heading_and_a_date(tmp_path: Path) -> None:
    clocks = {"S1": ("clk", [TIME]), "U1": ("Date,Time", [_stamps("%Y-%m-%d", 2), _stamps("%H:%M:%S.%f", 2)])}
    for serial, (headings, columns) in clocks.items():
        _write(tmp_path / f"{serial}.csv", f"force,{headings}", FORCE, *columns)
    files = [tmp_path / f"{serial}.csv" for serial in clocks]
    import_lot(ImportPlan(files, Columns("output", "force"), Lot("L", "S1", 50.0)), tmp_path / "lot")
    unit = pd.read_csv(tmp_path / "lot" / "units" / "U1.csv")
    assert unit["t_s"].iloc[-1] == pytest.approx(2 * 86400 + TIME[-1])
    assert pd.read_csv(tmp_path / "lot" / "source" / "S1.csv")["t_s"].iloc[-1] == pytest.approx(TIME[-1])


def test_a_wide_table_takes_neither_date_nor_time_for_a_unit(tmp_path: Path) -> None:
    table = pd.DataFrame({"Date": _stamps("%Y-%m-%d"), "clock": _stamps("%H:%M:%S.%f"), "S1": OUTPUT, "U1": OUTPUT / 2})
    table.assign(force=FORCE).to_csv(tmp_path / "a.csv", index=False)
    plan = ImportPlan([tmp_path / "a.csv"], Columns("*", "force"), Lot("L", "S1", 50.0))
    assert import_lot(plan, tmp_path / "lot").units == ("U1",)
