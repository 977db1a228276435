"""`softcal init`: what it asks, what it writes, and that nothing is written over."""

import argparse
import io
import tomllib
from pathlib import Path

import pytest

from softcal.app.cli import station as station_commands
from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.line import rig
from softcal.core.errors import InputError
from softcal.core.messages.reason import plain, reason
from softcal.station.bench.catalogue import SECTIONS, list_drivers
from softcal.station.bench.station_file import read_station_file, station_from_table, station_toml
from softcal.station.tasks.identify import DeviceIdentity


def _answers(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_a_lot_by_questions_can_be_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _answers(monkeypatch, "", "S1", "fast", "48.9", "pad", "pressure", "bar", "count", "8", "5%")
    assert main(["init", "lot", str(tmp_path / "lot-7")]) == 0
    (tmp_path / "lot-7/source/S1.csv").write_text("t_s,output,reference\n0,0,0\n")
    lot = open_lot_folder(tmp_path / "lot-7").lot
    assert (lot.id, lot.source, lot.sample_rate_Hz, lot.limit_rmse) == ("lot-7", "S1", 48.9, 0.4)
    assert (lot.sensor_model, lot.reference_quantity, lot.reference_unit, lot.output_unit) == (
        "pad", "pressure", "bar", "count",
    )  # fmt: skip
    assert "'fast'" in capsys.readouterr().err
    assert (tmp_path / "lot-7/units").is_dir()


def test_what_is_given_is_not_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _answers(monkeypatch)
    assert main(["init", "lot", str(tmp_path / "lot"), "--source", "S1", "--yes"]) == 0
    assert tomllib.loads((tmp_path / "lot/lot.toml").read_text())["sample_rate_Hz"] == 50.0


@pytest.mark.parametrize(
    ("answers", "limit"),
    [
        (("3", "y"), 0.3),
        (("3", "12 %"), 0.36),
        (("", "0.25"), 0.25),
        (("3", ""), None),
        (("", "5%", "soon", "0.2"), 0.2),
    ],
)
def test_a_limit_is_asked_for_and_a_proposal_has_to_be_confirmed(
    answers: tuple[str, ...],
    limit: float | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _answers(monkeypatch, "", "S1", "", "", "", "", "", *answers)
    assert main(["init", "lot", str(tmp_path / "lot")]) == 0
    stored_limit = tomllib.loads((tmp_path / "lot/lot.toml").read_text()).get("limit", {}).get("rmse")
    assert stored_limit == (None if limit is None else pytest.approx(limit))
    assert ("no unit can pass" in capsys.readouterr().err) == (limit is None)


def test_without_anybody_to_ask_no_limit_is_stated_and_that_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _answers(monkeypatch)
    assert main(["init", "lot", str(tmp_path / "lot"), "--source", "S1", "--yes"]) == 0
    assert "limit" not in tomllib.loads((tmp_path / "lot/lot.toml").read_text())
    assert "no unit can pass" in capsys.readouterr().err
    assert main(["init", "lot", str(tmp_path / "other"), "--source", "S1", "--yes", "--limit", "5%"]) == 2
    assert not (tmp_path / "other").exists()


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
    station_config = read_station_file(tmp_path / "station.toml")
    assert (station_config.name, station_config.stage.kind, station_config.stage.port) == (
        "line-2",
        "grbl",
        "/dev/ttyACM0",
    )
    assert station_config.force is not None and station_config.force.kind == "mark10"


def test_a_station_without_a_load_cell_asks_who_answers_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    devices = ("", "grbl", "/dev/ttyACM0", "", "", "", "none", "arduino", "/dev/ttyACM1", *[""] * 5)
    _answers(monkeypatch, *devices, *[""] * 20)
    assert main(["init", "station", str(tmp_path / "station.toml")]) == 2
    assert "without_cell" in capsys.readouterr().err and not (tmp_path / "station.toml").exists()


DRIVERS = [offer for offer in list_drivers() if offer.package == "softcal" and offer.driver is not None]
PORTS = {
    "serial": "/dev/tty{}",
    "tcp": "tcp://192.168.0.{}:5025",
    "ble": "ble://AA:BB:CC:DD:EE:0{}",
    "library": "ANY{}",
}


@pytest.mark.parametrize("offer", DRIVERS, ids=lambda offer: f"{offer.role} {offer.kind}")
def test_questions_end_in_a_whole_file_for_every_driver(offer, tmp_path, monkeypatch) -> None:
    """Every key of every section is in it, at its default where only Enter was pressed."""
    kinds = {"stage": "grbl", "cell": "hx711", "readout": "arduino"} | {offer.role: offer.kind}
    lines = [""]
    for k, (role, kind) in enumerate(kinds.items()):
        driver = next(each.driver for each in DRIVERS if (each.role, each.kind) == (role, kind))
        keys = [key for key in driver.keys if key != "kind"]
        lines += [kind, *(PORTS[driver.wires[0]].format(k) if key == "port" else "" for key in keys)]
    _answers(monkeypatch, *lines, *[""] * 3)
    assert main(["init", "station", str(tmp_path / "station.toml")]) == 0
    content = tomllib.loads((tmp_path / "station.toml").read_text())
    assert read_station_file(tmp_path / "station.toml").force is not None
    for role, kind in kinds.items():
        driver = next(each.driver for each in DRIVERS if (each.role, each.kind) == (role, kind))
        assert {**content[SECTIONS[role]], "port": None} == {**driver.keys, "kind": kind, "port": None}


STREAM = DeviceIdentity("/dev/cell", "", "", reason("port.either", largest=8040, rate_Hz=80.0), 80.0, 1)
DEVICES = [
    DeviceIdentity("/dev/stage", "stage", "grbl", plain("Grbl 1.1h")),
    DeviceIdentity("/dev/board", "readout", "arduino", plain("softcal readout 1"), 50.0, 1),
    STREAM,
]


@pytest.mark.parametrize("answers", [["/dev/nothing", "/dev/cell"], []])
def test_a_cell_at_rest_near_8000_counts_is_asked_for_or_marked_in_a_whole_file(
    answers, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(rig, "find_devices", lambda ports: DEVICES)
    monkeypatch.setattr(rig, "open_bench", _no_bench)
    _answers(monkeypatch, *answers)
    file = tmp_path / "station.toml"
    if answers:
        with pytest.raises(_Opened) as opened:
            station_commands.run_check(_check(file))
        assert (opened.value.config.force.port, opened.value.config.force.kind) == ("/dev/cell", "hx711")
        return
    assert station_commands.run_check(_check(file)) == 3
    with pytest.raises(InputError, match="force.*port"):
        read_station_file(file)
    (line,) = [line for line in file.read_text().splitlines() if "CHOOSE" in line]
    assert line.startswith('port = ""') and "/dev/cell" in line
    file.write_text(file.read_text().replace(line, 'port = "/dev/cell"'))
    assert read_station_file(file).force.kind == "hx711"


class _Opened(Exception):
    def __init__(self, config) -> None:
        self.config = config


def _no_bench(config):
    raise _Opened(config)


def _check(file):
    return argparse.Namespace(port=[], station=None, simulated=None, no_motion=True, write=file, json=None)


def test_the_keys_of_a_driver_are_shown_with_type_default_and_unit(capsys) -> None:
    assert main(["station", "drivers", "--kind", "hx711"]) == 0
    rows = ["".join(line.split()) for line in "".join(capsys.readouterr()).splitlines()]
    for texts in (
        ("counts_per_N", "number", "10000.0", "1/N"),
        ("port", "text", "needed"),
        ("capacity_N", "20.0", "N"),
    ):
        assert any(all(word in row for word in texts) for row in rows), texts


def test_the_complete_station_file_of_the_docs_is_whole() -> None:
    text = (Path(__file__).parents[2] / "docs" / "station.md").read_text(encoding="utf-8")
    (block,) = [part.partition("```")[0] for part in text.split("```toml\n")[1:] if "[fixture]" in part]
    content = tomllib.loads(block)
    config = station_from_table(content)
    assert tomllib.loads(station_toml(config)) == content  # No key is missing.
    lines = [line for line in block.splitlines() if " = " in line and not line.startswith("name")]
    assert all("#" in line for line in lines)
