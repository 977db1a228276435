"""`softcal init`: what it asks, what it writes, and that nothing is written over."""

import io
import tomllib
from pathlib import Path

import pytest

from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder
from softcal.station.config import read_station_file


def _answers(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_a_lot_by_questions_can_be_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _answers(monkeypatch, "", "S1", "fast", "48.9", "pad", "pressure", "bar", "count", "0.3")
    assert main(["init", "lot", str(tmp_path / "lot-7")]) == 0
    (tmp_path / "lot-7/source/S1.csv").write_text("t_s,output,reference\n0,0,0\n")
    lot = open_lot_folder(tmp_path / "lot-7").lot
    assert (lot.id, lot.source, lot.sample_rate_Hz, lot.limit_rmse) == ("lot-7", "S1", 48.9, 0.3)
    assert (lot.sensor_model, lot.reference_quantity, lot.reference_unit, lot.output_unit) == (
        "pad", "pressure", "bar", "count",
    )  # fmt: skip
    assert "'fast'" in capsys.readouterr().err
    assert (tmp_path / "lot-7/units").is_dir()


def test_what_is_given_is_not_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _answers(monkeypatch)
    assert main(["init", "lot", str(tmp_path / "lot"), "--source", "S1", "--yes"]) == 0
    assert tomllib.loads((tmp_path / "lot/lot.toml").read_text())["sample_rate_Hz"] == 50.0


@pytest.mark.parametrize("arguments", [["lot", "new"], ["lot", "new", "--yes"], ["station", "new"]])
def test_without_answers_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    _answers(monkeypatch)
    monkeypatch.chdir(tmp_path)
    assert main(["init", *arguments]) == 2
    assert not (tmp_path / "new").exists()


def test_nothing_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lot.toml").write_text("mine")
    assert main(["init", "lot", str(tmp_path), "--source", "S1", "--yes"]) == 2
    assert main(["init", "station", str(tmp_path / "lot.toml")]) == 2
    assert (tmp_path / "lot.toml").read_text() == "mine"
    assert capsys.readouterr().err.count("\n") == 2


def test_a_station_by_questions_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stage = ("grbl2", "grbl", "/dev/ttyACM0", "", "", "")
    cell = ("mark10", "/dev/ttyUSB0", "", "", "", "0.05", "", "", "", "")
    readout = ("arduino", "/dev/ttyACM1", "", "", "", "", "")
    _answers(monkeypatch, "line-2", *stage, *cell, *readout, "5", "", "", *[""] * 20)
    assert main(["init", "station", str(tmp_path / "station.toml")]) == 0
    assert "grbl2" in capsys.readouterr().err
    made = read_station_file(tmp_path / "station.toml")
    assert (made.name, made.stage.kind, made.stage.port) == ("line-2", "grbl", "/dev/ttyACM0")
    assert made.force is not None and made.force.kind == "mark10"


def test_a_station_without_a_load_cell_asks_who_answers_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    devices = ("", "grbl", "/dev/ttyACM0", "", "", "", "none", "arduino", "/dev/ttyACM1", *[""] * 5)
    _answers(monkeypatch, *devices, *[""] * 20)
    assert main(["init", "station", str(tmp_path / "station.toml")]) == 2
    assert "without_cell" in capsys.readouterr().err and not (tmp_path / "station.toml").exists()
