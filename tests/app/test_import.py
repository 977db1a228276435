"""`softcal import`: tables become a lot folder, or nothing is written and one line says why."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.files.importing import median_rate_Hz
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.files.recording_file import column, read_table
from softcal.core.errors import InputError
from softcal.core.lot import check_serial


def _table(folder: Path, name: str = "S1", rows: int = 60, **columns: object) -> Path:
    t_s = np.arange(rows) / 50
    table = pd.DataFrame({"t": t_s, "volts": 0.5 + 0.1 * np.sin(t_s), "newton": 1 + np.sin(t_s)} | columns)
    path = folder / f"{name}.csv"
    table.to_csv(path, index=False)
    return path


def _import(*files: Path, out: Path, source: str = "S1", extra: tuple[str, ...] = ()) -> int:
    options = ["--output-column", "volts", "--reference-column", "newton", "--time-column", "t"]
    return main(["import", *map(str, files), "--source", source, "--out", str(out), *options, *extra])


def test_files_become_source_units_and_audit(tmp_path: Path) -> None:
    files = [_table(tmp_path, "S1"), _table(tmp_path, "S2")]
    assert _import(*files, out=tmp_path / "lot", extra=("--audit",)) == 0
    folder = open_lot_folder(tmp_path / "lot")
    assert folder.lot.sample_rate_Hz == 50
    assert list(folder.unit_paths) == ["S2"]
    assert "reference" not in pd.read_csv(folder.unit_paths["S2"]).columns
    audit = folder.read_audit("S2")
    assert audit is not None
    np.testing.assert_allclose(audit.reference, 1 + np.sin(np.arange(60) / 50))


def test_a_wide_table_becomes_a_unit_per_column(tmp_path: Path) -> None:
    path = _table(tmp_path, "wide", x_1=np.linspace(0, 1, 60), x_2=np.linspace(1, 2, 60))
    options = ["--output-column", "x_*", "--reference-column", "newton", "--sample-rate", "50"]
    assert main(["import", str(path), "--source", "x_1", "--out", str(tmp_path / "lot"), *options]) == 0
    folder = open_lot_folder(tmp_path / "lot")
    assert list(folder.unit_paths) == ["x_2"]
    np.testing.assert_allclose(folder.read_unit("x_2").output, np.linspace(1, 2, 60))


@pytest.mark.parametrize("suffix", [".parquet", ".xlsx"])
def test_other_formats_read_like_csv(tmp_path: Path, suffix: str) -> None:
    table = pd.read_csv(_table(tmp_path))
    other = tmp_path / f"S9{suffix}"
    table.to_parquet(other) if suffix == ".parquet" else table.to_excel(other, index=False)
    assert _import(other, out=tmp_path / "lot", source="S9") == 0
    np.testing.assert_allclose(open_lot_folder(tmp_path / "lot").read_source().reference, table["newton"])


def _broken_excel(folder: Path) -> Path:
    path = folder / "S1.xlsx"
    path.write_bytes(b"PK\x03\x04 this is no archive")
    return path


def _with_text(folder: Path) -> Path:
    path = _table(folder)
    lines = path.read_text().splitlines()
    lines[41] = lines[41].split(",")[0] + ",abc,1.0"
    path.write_text("\n".join(lines))
    return path


def _empty(folder: Path) -> Path:
    path = folder / "S1.csv"
    path.touch()
    return path


def _of_another_country(folder: Path) -> Path:
    path = _table(folder)
    path.write_text(path.read_text().replace(",", ";").replace(".", ","))
    return path


def _without_time(folder: Path) -> Path:
    path = _table(folder)
    pd.read_csv(path).drop(columns="t").to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (_broken_excel, "S1.xlsx"),
        (_with_text, "line 42, column 'volts': 'abc'"),
        (_empty, "S1.csv"),
        (_of_another_country, "separated by ';'"),
        (_without_time, "or give the sample rate"),
        (lambda folder: folder / "S1.csv", "S1.csv"),
        (lambda folder: _table(folder, rows=10), " 15"),
        (lambda folder: _table(folder, volts=[np.nan] * 60), "(60 "),
        (lambda folder: _table(folder, t=np.zeros(60)), "'t'"),
    ],
)
def test_what_cannot_be_used_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make, says: str
) -> None:
    assert _import(make(tmp_path), out=tmp_path / "lot") == 2
    said = capsys.readouterr().err.strip()
    assert says in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "lot").exists()


def test_a_declared_rate_that_the_time_stamps_deny_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _import(_table(tmp_path), out=tmp_path / "lot", extra=("--sample-rate", "100")) == 2
    error = capsys.readouterr().err
    assert "50 Hz" in error and "100 Hz" in error


def test_a_serial_given_twice_and_one_that_leaves_the_folder_are_refused(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    assert _import(_table(tmp_path), _table(tmp_path / "b"), out=tmp_path / "lot") == 2
    assert _import(_table(tmp_path), out=tmp_path / "lot", source="../S1", extra=("--serial", "../S1")) == 2
    assert not (tmp_path / "lot").exists()


def test_a_folder_that_is_there_already_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "lot").mkdir()
    (tmp_path / "lot" / "mine.txt").write_text("keep")
    assert _import(_table(tmp_path), out=tmp_path / "lot") == 2
    assert [p.name for p in (tmp_path / "lot").iterdir()] == ["mine.txt"]


def test_rows_choose_what_fits_and_what_scores(tmp_path: Path) -> None:
    files = [_table(tmp_path, "S1"), _table(tmp_path, "S2")]
    extra = ("--audit", "--rows", "0:40", "--audit-rows", "40:60")
    assert _import(*files, out=tmp_path / "lot", extra=extra) == 0
    folder = open_lot_folder(tmp_path / "lot")
    audit = folder.read_audit("S2")
    assert (len(folder.read_unit("S2")), len(audit) if audit else None) == (40, 20)


def test_a_serial_that_windows_cannot_write_is_refused() -> None:
    for serial in ("CON", "con", "Lpt1", "nul.v2", "A1."):
        with pytest.raises(InputError):
            check_serial(serial)


def test_truth_values_days_and_milliseconds_are_no_numbers_of_seconds(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pd.DataFrame({"t": pd.date_range("2026-01-01", periods=5, freq="20ms")}).to_parquet(path)
    with pytest.raises(InputError):
        column(read_table(path), "t", path)
    mixed = pd.DataFrame({"output": pd.Series([1.0, True, 2.0], dtype=object)})
    with pytest.raises(InputError, match="'True'"):
        column(mixed, "output", path)
    for name, message in (("t_ms", "ms"), ("t", "0.05 Hz")):
        pd.DataFrame({name: np.arange(50) * 20.0}).to_csv(tmp_path / "b.csv", index=False)
        with pytest.raises(InputError, match=message):
            median_rate_Hz(tmp_path / "b.csv", name)
    pd.DataFrame({"time_s": np.arange(50) * 0.02}).to_csv(tmp_path / "c.csv", index=False)
    assert median_rate_Hz(tmp_path / "c.csv", "time_s") == pytest.approx(50)
