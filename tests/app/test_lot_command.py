"""`softcal lot`: recordings are taken when they have landed whole, and a limit has a version and a reason."""

import json

import pytest

from softcal.app.batch import watch
from softcal.app.batch.lot_work import BatchConfig, Watch
from softcal.app.batch.watch import WatchConfig, watch_lot
from softcal.app.cli.main import main
from softcal.core.lot import Lot
from softcal.db.connection import open_registry

ROWS = "t_s,output\n" + "".join(f"{k / 50},{k % 7}\n" for k in range(60))
LOT = 'sample_rate_Hz = 50.0\nsource = "S0"\n[lot]\nid = "L1"\n[reference]\nunit = "N"\n[output]\nunit = "V"\n'


@pytest.fixture
def folder(tmp_path):
    for name in ("source", "units"):
        (tmp_path / name).mkdir()
    (tmp_path / "lot.toml").write_text(LOT)
    (tmp_path / "source" / "S0.csv").write_text("t_s,output,reference\n")
    return tmp_path


def test_a_recording_is_taken_once_when_it_has_stopped_growing(folder, monkeypatch):
    taken, looks = [], []
    monkeypatch.setattr(watch, "run_batch", lambda lot, *_: taken.append(sorted(lot.unit_paths)))

    def act(_: float) -> None:
        looks.append(1)
        file = folder / "units" / "A1.csv"
        if len(looks) == 1:
            file.write_text(ROWS[:200])
        if len(looks) == 2:
            file.write_text(ROWS)
        if len(looks) == 5:
            (folder / "units" / "A2.csv").write_text(ROWS)

    list(watch_lot(folder, None, BatchConfig(), WatchConfig(1.0, idle_s=3.0, sleep=act), Watch()))
    assert taken == [["A1"], ["A2"]]


def test_a_replaced_recording_is_calibrated_again(folder, monkeypatch):
    taken, looks = [], []
    monkeypatch.setattr(watch, "run_batch", lambda lot, *_: taken.append(sorted(lot.unit_paths)))
    (folder / "units" / "A1.csv").write_text(ROWS)

    def act(_: float) -> None:
        looks.append(1)
        if len(looks) == 3:
            (folder / "units" / "A1.csv").write_text(ROWS + "2.0,1\n")

    list(watch_lot(folder, None, BatchConfig(), WatchConfig(1.0, idle_s=3.0, sleep=act), Watch()))
    assert taken == [["A1"], ["A1"]]


def test_a_folder_that_is_no_lot_is_named(tmp_path, capsys):
    assert main(["lot", "watch", str(tmp_path), "--registry", f"sqlite:///{tmp_path / 'r.db'}"]) == 2
    assert "lot.toml" in capsys.readouterr().err


def test_a_limit_needs_a_reason_and_keeps_its_versions(tmp_path, capsys):
    url = f"sqlite:///{tmp_path / 'registry.db'}"
    with open_registry(url) as registry:
        registry.add_lot(Lot("L1", "S0", 50.0, limit_rmse=0.2))
    common = ["lot", "limit", "L1", "--registry", url]
    assert main([*common, "--rmse", "0.1"]) == 2 and "needs --reason" in capsys.readouterr().err
    assert main([*common, "--rmse", "0.1", "--reason", "drawing C", "--json", "-"]) == 0
    versions = json.loads(capsys.readouterr().out)["versions"]
    assert [(v["version"], v["rmse"]) for v in versions] == [(1, 0.2), (2, 0.1)]
    assert main([*common, "--rmse", "0.3", "--reason", "late", "--expect", "1"]) == 2
    assert "changed to 0.1" in capsys.readouterr().err


@pytest.fixture
def known_lot(tmp_path):
    url = f"sqlite:///{tmp_path / 'r.db'}"
    with open_registry(url) as registry:
        registry.add_lot(Lot("L1", "S0", 50.0))
    return url


def test_rules_of_a_lot_are_set_with_a_reason_and_shown_with_their_versions(known_lot, capsys):
    change = ["--target", "6", "--retests", "fail=0", "--reason", "customer allows no second try"]
    assert main(["lot", "rules", "L1", "--registry", known_lot, *change, "--json", "-"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["now"]["target"], shown["now"]["retests"]["fail"], shown["now"]["retests"]["retest"]) == (6, 0, 3)
    assert [entry["reason"] for entry in shown["versions"]] == ["customer allows no second try"]


@pytest.mark.parametrize(
    "wrong", [["--target", "6"], ["--retests", "fail=x", "--reason", "why"], ["--serial-pattern", "A["]]
)
def test_senseless_rules_of_a_lot_change_nothing(known_lot, wrong):
    assert main(["lot", "rules", "L1", "--registry", known_lot, *wrong]) == 2
    with open_registry(known_lot) as registry:
        assert registry.line_rules_versions("L1") == []
