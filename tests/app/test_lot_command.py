"""`softcal lot`: recordings are taken when they have landed whole, and a limit has a version and a reason."""

import json
from itertools import count

import pytest

from softcal.app.batch import watch
from softcal.app.batch.lot_work import BatchConfig, Callbacks
from softcal.app.batch.watch import watch_lot
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


@pytest.fixture
def registry_with_lot(tmp_path):
    url = f"sqlite:///{tmp_path / 'r.db'}"
    with open_registry(url) as registry:
        registry.lots.add(Lot("L1", "S0", 50.0, limit_rmse=0.2))
    return url


@pytest.mark.parametrize(
    ("writes", "batches"),
    [
        ({1: ("A1", ROWS[:200]), 2: ("A1", ROWS), 5: ("A2", ROWS)}, [["A1"], ["A2"]]),
        ({0: ("A1", ROWS), 3: ("A1", ROWS + "2.0,1\n")}, [["A1"], ["A1"]]),
    ],
    ids=["once, when it has stopped growing", "again, when it was replaced"],
)
def test_a_recording_is_taken(folder, monkeypatch, writes, batches):
    taken_files, looks = [], count()
    monkeypatch.setattr(watch, "run_batch", lambda lot, *_: taken_files.append(sorted(lot.unit_paths)))

    def act(_: float) -> None:
        serial, rows = writes.get(next(looks), ("", ""))
        if serial:
            (folder / "units" / f"{serial}.csv").write_text(rows)

    act(0.0)
    list(watch_lot(folder, None, BatchConfig(), Callbacks(), 1.0, idle_s=3.0, sleep=act))
    assert taken_files == batches


def test_a_folder_that_is_no_lot_is_named(tmp_path, capsys):
    assert main(["lot", "watch", str(tmp_path), "--registry", f"sqlite:///{tmp_path / 'r.db'}"]) == 2
    assert "lot.toml" in capsys.readouterr().err


def test_a_limit_needs_a_reason_and_keeps_its_versions(registry_with_lot, capsys):
    common = ["lot", "limit", "L1", "--registry", registry_with_lot]
    assert main([*common, "--rmse", "0.1"]) == 2 and "--reason" in capsys.readouterr().err
    assert main([*common, "--rmse", "0.1", "--reason", "drawing C", "--yes", "--json", "-"]) == 0
    versions = json.loads(capsys.readouterr().out)["versions"]
    assert [(v["version"], v["rmse"]) for v in versions] == [(1, 0.2), (2, 0.1)]
    assert main([*common, "--rmse", "0.3", "--reason", "late", "--yes", "--expect", "1"]) == 2
    assert "0.1" in capsys.readouterr().err


def test_rules_of_a_lot_are_set_with_a_reason_and_shown_with_their_versions(registry_with_lot, capsys):
    change = ["--target", "6", "--retests", "fail=0", "--reason", "customer allows no second try"]
    assert main(["lot", "rules", "L1", "--registry", registry_with_lot, *change, "--json", "-"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["now"]["target"], content["now"]["retests"]["fail"], content["now"]["retests"]["retest"]) == (
        6,
        0,
        3,
    )
    assert [entry["reason"] for entry in content["versions"]] == ["customer allows no second try"]


@pytest.mark.parametrize(
    "wrong", [["--target", "6"], ["--retests", "fail=x", "--reason", "why"], ["--serial-pattern", "A["]]
)
def test_senseless_rules_of_a_lot_change_nothing(registry_with_lot, wrong):
    assert main(["lot", "rules", "L1", "--registry", registry_with_lot, *wrong]) == 2
    with open_registry(registry_with_lot) as registry:
        assert registry.lots.line_rules_versions("L1") == []
