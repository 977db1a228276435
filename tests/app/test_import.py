"""`softcal import`: tables become a lot folder, or nothing is written and one line says why."""

import io
import json
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.tables.read import read_table
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


def _without_time(folder: Path) -> Path:
    path = _table(folder)
    pd.read_csv(path).drop(columns="t").to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (_broken_excel, "S1.xlsx"),
        (_with_text, "line 42, column 'volts': 'abc'"),
        (_empty, "S1.csv"),
        (_without_time, "or give the sample rate"),
        (lambda folder: folder / "S1.csv", "S1.csv"),
        (lambda folder: _table(folder, rows=10), " 15"),
        (lambda folder: _table(folder, volts=[np.nan] * 60), " 60 rows"),
        (lambda folder: _table(folder, t=np.zeros(60)), "'t'"),
    ],
)
def test_what_cannot_be_used_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make, message: str
) -> None:
    assert _import(make(tmp_path), out=tmp_path / "lot") == 2
    stderr = capsys.readouterr().err.strip()
    assert message in stderr
    assert len(stderr.splitlines()) == 1
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


def test_truth_values_are_no_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pd.DataFrame({"output": [True, False], "day": pd.date_range("2026-01-01", periods=2)}).to_parquet(path)
    for name in ("output", "day"):
        with pytest.raises(InputError, match=f"'{name}'.*number was expected"):
            read_table(path).numbers(name)


def _loggers_table(folder: Path, name: str, rows: int = 60, text: str = "") -> Path:
    """Write semicolons, decimal commas, a preamble and a row of units."""
    t_s, lines = np.arange(rows) / 50, ["Logger 7", "Time;Volts;Force", "(s);(V);(N)"]
    lines += [f"{t:.2f};{0.5 + 0.1 * np.sin(t):.6f};{1 + np.sin(t):.6f}".replace(".", ",") for t in t_s]
    path = folder / f"{name}.csv"
    path.write_text("\n".join(lines) + "\n" + text)
    return path


def _import_loggers(*files: Path, out: Path, extra: tuple[str, ...] = ()) -> int:
    options = ["--output-column", "Volts", "--reference-column", "Force", "--audit"]
    return main(["import", *map(str, files), "--source", "S1", "--out", str(out), *options, *extra])


def test_the_layout_of_a_logger_s_file_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [_loggers_table(tmp_path, "S1"), _loggers_table(tmp_path, "S2")]
    assert _import_loggers(*files, out=tmp_path / "lot", extra=("--json", "-")) == 0
    printed = capsys.readouterr()
    layout = "semicolons; decimal comma; header in line 2; units in line 3"
    assert f"S1.csv and 1 more: {layout}" in printed.err
    content = json.loads(printed.out)
    assert content["layouts"] == {"S1.csv": layout, "S2.csv": layout} and content["audits"] == ["S2"]
    folder = open_lot_folder(tmp_path / "lot")
    assert folder.lot.sample_rate_Hz == 50
    np.testing.assert_allclose(folder.read_unit("S2").output, 0.5 + 0.1 * np.sin(np.arange(60) / 50), atol=1e-6)


def test_stamps_of_a_file_stay_as_they_are_and_the_rate_is_a_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t_s = np.arange(60) / 50
    t_s[30:] += 2.0
    path = _table(tmp_path, t=t_s)
    options = ["--output-column", "volts", "--reference-column", "newton", "--sample-rate"]
    for rate, out in ((50, "lot"), (100, "other")):
        command = ["import", str(path), "--source", "S1", "--out", str(tmp_path / out), *options, str(rate)]
        assert main(command) == (0 if rate == 50 else 2)
    np.testing.assert_array_equal(open_lot_folder(tmp_path / "lot").read_source().unlabelled.t_s, t_s)
    error = capsys.readouterr().err
    assert "50 Hz" in error and "100 Hz" in error and not (tmp_path / "other").exists()


def test_a_file_without_time_gets_stamps_by_the_rate(tmp_path: Path) -> None:
    path = _without_time(tmp_path)
    options = ["--output-column", "volts", "--reference-column", "newton", "--sample-rate", "50"]
    assert main(["import", str(path), "--source", "S1", "--out", str(tmp_path / "lot"), *options]) == 0
    np.testing.assert_allclose(open_lot_folder(tmp_path / "lot").read_source().unlabelled.t_s, np.arange(60) / 50)


def test_missing_cells_stay_missing_in_the_lot_folder(tmp_path: Path) -> None:
    volts = 0.5 + 0.1 * np.sin(np.arange(60) / 50)
    volts[20] = np.nan
    assert _import(_table(tmp_path), _table(tmp_path, "S2", volts=volts), out=tmp_path / "lot") == 0
    table = pd.read_csv(tmp_path / "lot" / "units" / "S2.csv")
    assert len(table) == 60 and np.flatnonzero(table["output"].isna()).tolist() == [20]
    unit = open_lot_folder(tmp_path / "lot").read_unit("S2")
    assert len(unit) == 59 and len(unit.segments) == 2


def test_audits_that_are_not_there_are_counted_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = _table(tmp_path, "S2")
    other.write_text(other.read_text().replace("newton", "Newton"))
    assert _import(_table(tmp_path), other, out=tmp_path / "lot", extra=("--audit",)) == 0
    assert "audits: 0 of 1; S2.csv has no column 'newton', it has 'Newton'" in capsys.readouterr().err


def test_serials_are_given_by_the_names_of_files_and_columns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = _table(tmp_path, "run 1"), _table(tmp_path, "run 2")
    extra = ("--serial", "run 1=S1", "--serial", "run 2=S2")
    assert _import(first, second, out=tmp_path / "lot", extra=extra) == 0
    assert list(open_lot_folder(tmp_path / "lot").unit_paths) == ["S2"]
    wide = _table(tmp_path, "wide", **{"pad 1": np.linspace(0, 1, 60), "pad 2": np.linspace(1, 2, 60)})
    options = ["--output-column", "pad *", "--reference-column", "newton", "--source", "P1"]
    renames = ["--serial", "pad 1=P1", "--serial", "pad 2=P2"]
    assert main(["import", str(wide), "--out", str(tmp_path / "w"), *options, *renames]) == 0
    np.testing.assert_allclose(open_lot_folder(tmp_path / "w").read_unit("P2").output, np.linspace(1, 2, 60))
    assert main(["import", str(wide), "--out", str(tmp_path / "x"), *options, *renames, "--serial", "pad 9=P9"]) == 2
    assert "'pad 9'" in capsys.readouterr().err
    # A name that is no serial stops nothing: the batch gives its unit a row, and the import says what renames it.
    assert main(["import", str(wide), "--out", str(tmp_path / "x"), *options, *renames[:2]]) == 0
    err = capsys.readouterr().err
    assert "column pad 2 of wide.csv: " in err and "--serial 'pad 2=pad_2' gives" in err
    # What the line names works as it stands, of a source and of a file too.
    assert main(["import", str(wide), "--out", str(tmp_path / "y"), *options[:-1], "pad 1"]) == 2
    refused = capsys.readouterr().err
    (cure,) = [line.partition("another serial: ")[2] for line in refused.splitlines()]
    assert cure == "--source pad_1 --serial 'pad 1=pad_1'"
    again = ["import", str(wide), "--out", str(tmp_path / "y"), *options[:-2], *shlex.split(cure)]
    assert main(again) == 0
    cure = capsys.readouterr().err.partition("note: --serial")[2].partition(" gives")[0]
    again[3] = str(tmp_path / "z")
    assert main([*again, *shlex.split(f"--serial{cure}")]) == 0
    assert (
        list(open_lot_folder(tmp_path / "z").unit_paths) == ["pad_2"]
        and "note: --serial" not in capsys.readouterr().err
    )
    assert _import(first, second, out=tmp_path / "v", extra=("--serial", "run 1=S1")) == 0
    assert "--serial 'run 2=run_2' gives" in capsys.readouterr().err


def test_an_option_reads_what_is_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = _table(tmp_path, t=np.arange(60) * 20)
    assert _import(path, out=tmp_path / "lot") == 2
    assert "--time-format" in capsys.readouterr().err
    assert _import(path, out=tmp_path / "lot", extra=("--time-format", "ms")) == 0
    assert open_lot_folder(tmp_path / "lot").lot.sample_rate_Hz == 50


@pytest.mark.parametrize(("limit_option", "limit"), [("0.4", 0.4), ("5%", 0.1), ("", None)])
def test_a_limit_is_stated_in_the_unit_or_as_a_share_of_the_range_or_its_absence_is_reported(
    limit_option: str, limit: float | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = 400  # sin(t) over 8 s: the reference runs from 0 to 2
    files = [_table(tmp_path, name, rows) for name in ("S1", "S2")]
    assert _import(*files, out=tmp_path / "lot", extra=("--limit", limit_option) if limit_option else ()) == 0
    stored_limit = open_lot_folder(tmp_path / "lot").lot.limit_rmse
    assert stored_limit == (None if limit is None else pytest.approx(limit, rel=1e-3))
    assert ("no unit can pass" in capsys.readouterr().err) == (limit is None)


def test_on_a_terminal_a_tenth_of_the_range_is_proposed_and_has_to_be_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [_table(tmp_path, name, 400) for name in ("S1", "S2")]
    for answer, limit in (("y", 0.2), ("", None), ("3 %", 0.06)):
        terminal = io.StringIO(f"{answer}\n")
        monkeypatch.setattr(terminal, "isatty", lambda: True)
        monkeypatch.setattr("sys.stdin", terminal)
        out = tmp_path / f"lot-{answer[:1]}"
        assert _import(*files, out=out) == 0
        assert "proposed: 0.2 N, 10% of the range" in capsys.readouterr().err
        stored_limit = open_lot_folder(out).lot.limit_rmse
        assert stored_limit == (None if limit is None else pytest.approx(limit, rel=1e-3))


def test_a_source_that_trains_nothing_is_imported_with_a_note_and_its_limit(
    tmp_path: Path, press_unit, capsys: pytest.CaptureFixture[str]
) -> None:
    source = press_unit(1200, 1.0, 0.5, 4)
    source.loc[600:, "reference"] -= 1.5
    source.to_csv(tmp_path / "S1.csv", index=False)
    press_unit(1200, 1.1, 0.5, 5).to_csv(tmp_path / "S2.csv", index=False)
    files, options = (
        [str(tmp_path / f"S{k}.csv") for k in (1, 2)],
        ["--source", "S1", "--reference-column", "reference"],
    )
    assert main(["import", *files, *options, "--limit", "5%", "--out", str(tmp_path / "lot")]) == 0
    assert "S1.csv: line 602" in capsys.readouterr().err
    assert open_lot_folder(tmp_path / "lot").lot.limit_rmse == pytest.approx(0.05 * np.ptp(source["reference"]))
    assert main(["train", str(tmp_path / "lot"), "--registry", f"sqlite:///{tmp_path / 'r.db'}"]) == 2
    assert "S1.csv: line 602" in capsys.readouterr().err
