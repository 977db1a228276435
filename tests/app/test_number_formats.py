"""Numbers in other ways of writing: read where nothing is left open, asked about where two readings are possible."""

from pathlib import Path

import numpy as np
import pytest

from softcal.app.files.recording_file import ColumnNames, FileRecording, inspect_recording
from softcal.app.files.stream_file import Stream
from softcal.core.errors import InputError

ROWS = 240
TIME = np.arange(ROWS) / 50
OUTPUT = np.round(0.52 - 0.05 * np.cos(np.pi * TIME), 5)
COUNTS = np.round(OUTPUT * 20000, 1)
BODY = [f"{t},{v}" for t, v in zip(TIME, OUTPUT, strict=True)]


def _read(path: Path, text: str, output: str = "output") -> FileRecording:
    path = path / "a.csv"
    path.write_text(text, encoding="utf-8")
    file = inspect_recording(path, "U", None, names=ColumnNames(output))
    streamed = np.concatenate([values for _, values in Stream(path, ColumnNames(output)).pieces()])
    np.testing.assert_array_equal(streamed, file.columns["output"])
    return file


@pytest.mark.parametrize(
    ("write", "expected", "word"),
    [
        (lambda v: f"{v - 1:.5f}".replace("-", "\u2212"), OUTPUT - 1, ""),
        (lambda v: f"{v:.6E}".replace("E", "D"), OUTPUT, ""),
        (lambda v: f'"=""{v}"""', OUTPUT, ""),
        (lambda v: f"{v} V", OUTPUT, "'V'"),
        (lambda v: f"{100 * v:.4f}%", 100 * OUTPUT, "'%'"),
        (lambda v: f'"{20000 * v:,.1f}"', COUNTS, "thousands"),
        (lambda v: f"{20000 * v:,.1f}".replace(",", "'"), COUNTS, "thousands"),
        (lambda v: f"{20000 * v:,.1f}".replace(",", "\u202f"), COUNTS, "thousands"),
        (lambda v: f'"{v}"'.replace(".", ","), OUTPUT, "decimal mark"),
    ],
)
def test_a_column_in_another_way_of_writing_is_read_and_reported(write, expected, word, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rows = [f"{t},{write(v)}" for t, v in zip(TIME, OUTPUT, strict=True)]
    file = _read(tmp_path, "\n".join(["t_s,output", *rows]) + "\n")
    np.testing.assert_allclose(file.columns["output"], expected, rtol=1e-9)
    assert word in " ".join(file.reading_remarks) and bool(word) == bool(file.reading_remarks)


@pytest.mark.parametrize(
    ("cells", "word"),
    [
        ([f'"{int(20000 * v):,}"' for v in OUTPUT], "thousands"),
        ([f"{v} V" if k % 2 else f"{1000 * v} mV" for k, v in enumerate(OUTPUT)], "line 2"),
        ([f'"{v}"'.replace(".", ",") if k == 50 else str(v) for k, v in enumerate(OUTPUT)], "line 52.*decimal point"),
        (["?" if k == 50 else str(v) for k, v in enumerate(OUTPUT)], "line 52.*--missing"),
    ],
)
def test_a_column_with_two_readings_is_asked_about(cells: list[str], word: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=word):
        _read(tmp_path, "\n".join(["t_s,output", *(f"{t},{c}" for t, c in zip(TIME, cells, strict=True))]) + "\n")


def test_every_number_may_have_its_unit(tmp_path: Path) -> None:
    rows = [f"{1000 * t:.0f} ms,{v} V" for t, v in zip(TIME, OUTPUT, strict=True)]
    file = _read(tmp_path, "\n".join(["time,output", *rows]) + "\n")
    np.testing.assert_allclose(file.t_s, TIME, atol=1e-9)
    np.testing.assert_array_equal(file.columns["output"], OUTPUT)


def test_a_header_that_comes_again_and_a_summary_are_no_samples_and_are_reported(tmp_path: Path) -> None:
    text = "\n".join(["t_s,output", *BODY[:100], "t_s,output", *BODY[100:], "Mean,0.52", "Std. Dev.,0.03"]) + "\n"
    file = _read(tmp_path, text)
    np.testing.assert_array_equal(file.columns["output"], OUTPUT)
    assert any("line 102" in remark for remark in file.reading_remarks)
    assert any("Mean" in remark for remark in file.reading_remarks)


def test_a_serial_monitor_that_writes_the_time_before_an_arrow_is_read(tmp_path: Path) -> None:
    rows = [f"10:00:{t % 60:06.3f} -> {v},{k}" for k, (t, v) in enumerate(zip(TIME, OUTPUT, strict=True))]
    file = _read(tmp_path, "\n".join(rows) + "\n", "column_2")
    np.testing.assert_allclose(file.recording.t_s - file.recording.t_s[0], TIME, atol=1e-9)
    np.testing.assert_array_equal(file.columns["output"], OUTPUT)


@pytest.mark.parametrize("last_cell", ["0", "0."])
def test_a_last_number_that_lacks_digits_is_no_sample(last_cell: str, tmp_path: Path) -> None:
    body = [f"{t},{v:.5f}" for t, v in zip(TIME, OUTPUT, strict=True)]
    file = _read(tmp_path, "\n".join(["t_s,output", *body[:-1], f"{TIME[-1]},{last_cell}"]))
    assert np.isnan(file.columns["output"][-1]) and len(file.columns["output"]) == ROWS
    whole = _read(tmp_path, "\n".join(["t_s,output", *body]))
    assert np.isfinite(whole.columns["output"]).all() and whole.reading_remarks == ()


def test_stamps_of_windows_and_parts_of_a_second_behind_a_colon_are_read(tmp_path: Path) -> None:
    ticks = [f"{134168184000000000 + round(1e7 * t)},{v}" for t, v in zip(TIME, OUTPUT, strict=True)]
    stamps = [f"03/02/2026 10:00:{int(t):02}:{round(t % 1 * 1000):03},{v}" for t, v in zip(TIME, OUTPUT, strict=True)]
    for rows in (ticks, stamps):
        file = _read(tmp_path, "\n".join(["time,output", *rows]) + "\n")
        np.testing.assert_allclose(file.recording.t_s - file.recording.t_s[0], TIME, atol=1e-4)


def test_a_logger_that_was_started_again_is_refused_where_time_goes_back(tmp_path: Path) -> None:
    text = "\n".join(["t_s,output", *BODY[:120], "t_s,output", *BODY[:120]]) + "\n"
    with pytest.raises(InputError, match="line 123.*started again"):
        _read(tmp_path, text)
