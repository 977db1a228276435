"""Whoever asks what calibrates a unit gets one answer, from every command, after any history."""

import json
import os
import shutil
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.batch import guard, lot_work, unit_work
from softcal.app.batch.batch import run_batch
from softcal.app.batch.lot_work import BatchConfig
from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder
from softcal.core.network.training import NetworkConfig
from softcal.db.connection import open_registry

SMALL = ("--hidden", "16,8", "--no-own")


def batch(folder: Path, url: str, *more: str) -> dict:
    report = folder.parent / "report.json"
    report.unlink(missing_ok=True)
    code = main(["batch", str(folder), "--registry", url, "--json", str(report), *SMALL, *more])
    assert code in (0, 1)
    return {unit["serial"]: unit for unit in json.loads(report.read_text())["units"]}


def revision_in_use(url: str, serial: str) -> int:
    with open_registry(url, create=False) as registry:
        return registry.calibrations.get(serial).revision


def other_recording(folder: Path, serial: str = "A1") -> None:
    path = folder / f"units/{serial}.csv"
    table = pd.read_csv(path)
    table.assign(output=table.output * 1.3 + 0.1).to_csv(path, index=False)


def listed(url: str, capsys: pytest.CaptureFixture[str]) -> dict:
    capsys.readouterr()
    assert main(["registry", "list", "--registry", url, "--json", "-"]) == 0
    return {unit["serial"]: unit for unit in json.loads(capsys.readouterr().out)["units"]}


@pytest.mark.long
def test_a_repeated_recording_puts_its_own_map_in_use(lot_folder, registry_url, tmp_path):
    first = (lot_folder / "units/A1.csv").read_bytes()
    assert batch(lot_folder, registry_url)["A1"]["map"]["revision"] == 1
    other_recording(lot_folder)
    assert batch(lot_folder, registry_url)["A1"]["map"]["revision"] == revision_in_use(registry_url, "A1") == 2
    (lot_folder / "units/A1.csv").write_bytes(first)
    stored_map = batch(lot_folder, registry_url, "--out", str(tmp_path / "files"))["A1"]["map"]
    assert stored_map["revision"] == revision_in_use(registry_url, "A1") == 1
    manifest = json.loads((tmp_path / "files/manifest.json").read_text())
    assert manifest["units"]["A1"]["map"] == stored_map["sha256"]


def test_what_a_person_rolled_back_to_stays_until_something_new_is_asked(lot_folder, registry_url):
    batch(lot_folder, registry_url)
    other_recording(lot_folder)
    batch(lot_folder, registry_url)
    with open_registry(registry_url) as registry:
        assert registry.calibrations.rollback("A1", 1, reason="remounted") == 3
    assert batch(lot_folder, registry_url)["A1"]["map"]["revision"] == revision_in_use(registry_url, "A1") == 3


def test_a_limit_that_comes_back_gives_the_same_verdict_everywhere(lot_folder, registry_url, tmp_path, capsys):
    toml = lot_folder / "lot.toml"
    toml_text = toml.read_text()
    for limit, verdict in ((0.002, "fail"), (5.0, "pass"), (0.002, "fail")):
        toml.write_text(toml_text.replace("rmse = 0.16", f"rmse = {limit}"))
        assert batch(lot_folder, registry_url)["A1"]["verdict"] == verdict
        assert listed(registry_url, capsys)["A1"]["verdict"] == verdict
        out = tmp_path / f"files-{limit}-{verdict}"
        main(["export", "--registry", registry_url, "--serial", "A1", "--format", "json", "--out", str(out)])
        assert json.loads((out / "manifest.json").read_text())["units"]["A1"]["verdict"] == verdict


@pytest.mark.long
def test_a_serial_of_two_lots_is_asked_for_with_its_lot(lot_folder, registry_url, tmp_path, capsys):
    second = Path(shutil.copytree(lot_folder, tmp_path / "second"))
    (second / "lot.toml").write_text((second / "lot.toml").read_text().replace('"small"', '"second"'))
    shutil.copy(second / "units/A2.csv", second / "units/A1.csv")
    shutil.rmtree(second / "audit")
    batch(lot_folder, registry_url)
    batch(second, registry_url)
    recording, out = str(lot_folder / "units/A1.csv"), str(tmp_path / "out.csv")
    commands = [
        ["estimate", "--serial", "A1", recording, "--out", out],
        ["adapt", "--serial", "A1", recording, "--out", out],
        ["explain", "--serial", "A1"],
        ["export", "--serial", "A1", "--out", str(tmp_path / "files")],
        ["registry", "history", "--serial", "A1"],
        ["registry", "rollback", "--serial", "A1", "--to", "1", "--reason", "x"],
    ]
    for command in commands:
        capsys.readouterr()
        assert main([*command, "--registry", registry_url]) == 2
        error = capsys.readouterr().err
        assert "second" in error and "small" in error and error.count("\n") == 1, command
    for command in commands[:-1]:
        assert main([*command, "--registry", registry_url, "--lot", "small"]) == 0, command
    maps = {}
    for lot, folder in (("small", lot_folder), ("second", second)):
        report = batch(folder, registry_url, "--out", str(tmp_path / lot), "--release", "conditional")
        maps[lot] = report["A1"]["map"]["sha256"]
    for lot, sha256 in maps.items():
        assert json.loads((tmp_path / lot / "manifest.json").read_text())["units"]["A1"]["map"] == sha256


@pytest.mark.parametrize("way", ["restored", "synchronised"])
def test_a_copy_of_the_registry_knows_every_result(lot_folder, registry_url, tmp_path, way):
    first, copy = batch(lot_folder, registry_url), f"sqlite:///{tmp_path / 'copy.db'}"
    if way == "restored":
        assert main(["registry", "backup", str(tmp_path / "b.db"), "--registry", registry_url]) == 0
        assert main(["registry", "restore", str(tmp_path / "b.db"), "--registry", copy]) == 0
    else:
        open_registry(copy).close()
        assert main(["registry", "sync", "--registry", registry_url, "--with", copy]) == 0
    again = batch(lot_folder, copy)
    assert [unit["is_new"] for unit in again.values()] == [False] * 3
    assert [unit["map"] for unit in again.values()] == [unit["map"] for unit in first.values()]


def test_nothing_in_the_queue_changes_what_is_reported(lot_folder, registry_url, monkeypatch):
    true = batch(lot_folder, registry_url)
    with open_registry(registry_url) as registry:
        names = "lot_id, serial, kind, work_set, input_sha256, state, attempts, owner, lease_until, changed_at"
        rows = [
            ("A1", "failed", 3, None, None),
            ("A2", "claimed", 1, "elsewhere:1:x", "2999-01-01 00:00:00.000000"),
            ("A3", "claimed", -5, "elsewhere:1:x", None),
            ("A9", "queued", 0, None, None),
        ]
        run = lot_work.LotWork.run

        def forged(work: lot_work.LotWork) -> None:
            with registry.database.writing() as connection:
                for serial, state, attempts, owner, lease in rows:
                    values = ("small", serial, "calibrate", work._work.name, "f" * 64, state, attempts, owner, lease)
                    connection.exec_driver_sql(
                        f"INSERT INTO work_items ({names}) VALUES (?,?,?,?,?,?,?,?,?,'2026-01-01 00:00:00')", values
                    )
            run(work)

        monkeypatch.setattr(lot_work.LotWork, "run", forged)
        config = BatchConfig(network=NetworkConfig(hidden=(16, 8)), score_own=False)
        report = run_batch(open_lot_folder(lot_folder), registry, config)
        assert {unit.serial: unit.verdict for unit in report.units} == {s: u["verdict"] for s, u in true.items()}
        assert "A9" not in {unit.serial for unit in registry.lots.units("small")}


def test_a_file_that_is_gone_ends_in_no_defect(lot_folder, registry_url):
    batch(lot_folder, registry_url)
    (lot_folder / "units/A2.csv").unlink()
    assert sorted(batch(lot_folder, registry_url)) == ["A1", "A3"]


def test_nothing_that_lies_in_the_folder_stops_the_lot(lot_folder, registry_url, tmp_path):
    units = lot_folder / "units"
    os.mkfifo(units / "F1.csv")
    os.mkfifo(units / "F7.csv")  # As large as the first: files of one size are compared.
    (units / "F2.csv").mkdir()
    (units / "F3.csv").symlink_to("/dev/zero")
    shutil.copy(units / "A1.csv", tmp_path / "outside.csv")
    (units / "F4.csv").symlink_to(tmp_path / "outside.csv")
    (units / "F5.csv").symlink_to("F5.csv")
    (lot_folder / "audit/A3.csv").unlink()
    os.mkfifo(lot_folder / "audit/A3.csv")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(units / "F6.csv"))
        report = batch(lot_folder, registry_url)
    for serial in ("A3", *(f"F{k}" for k in range(1, 8))):
        assert report[serial]["verdict"] == "retest" and f"{serial}.csv" in report[serial]["reasons"][0]
    assert all(report[serial]["map"] for serial in ("A1", "A2"))


def test_a_file_that_grows_while_it_is_read_is_a_retest(lot_folder, registry_url, monkeypatch):
    read, path = os.read, lot_folder / "units/A2.csv"

    def growing(handle: int, size: int) -> bytes:
        if os.path.samestat(os.fstat(handle), path.stat()):
            with path.open("a") as file:
                file.write("30.0,0.5\n")
        return read(handle, size)

    monkeypatch.setattr("softcal.app.files.regular.os.read", growing)
    units = batch(lot_folder, registry_url)
    monkeypatch.undo()
    assert units["A2"]["verdict"] == "retest" and units["A3"]["map"]
    assert batch(lot_folder, registry_url)["A2"]["map"], "what passes is tried again"


@pytest.mark.parametrize("size", [1e155, 1.7e308])
def test_a_value_no_sensor_gives_is_left_out_and_named_with_its_line(lot_folder, registry_url, size):
    path = lot_folder / "units/A2.csv"
    table = pd.read_csv(path)
    table.loc[700, "output"] = size
    table.to_csv(path, index=False)
    np.testing.assert_equal(pd.read_csv(path).output.max(), size)
    units = batch(lot_folder, registry_url)
    assert any("line 702" in why for why in units["A2"]["reasons"]) and sum(units["A2"]["missing"].values()) >= 1
    assert units["A1"]["map"] and units["A3"]["map"]
    assert batch(lot_folder, registry_url)["A2"]["verdict"] == units["A2"]["verdict"]


@pytest.mark.parametrize("error", [MemoryError(), KeyError("\x1b[31mred")])
def test_whatever_a_unit_s_work_raises_is_that_unit_s_result(lot_folder, registry_url, monkeypatch, capsys, error):
    work = unit_work._work_on_unit

    def failing(shared, task):
        if task.serial == "A2":
            raise error
        return work(shared, task)

    monkeypatch.setattr(unit_work, "_work_on_unit", failing)
    units = batch(lot_folder, registry_url)
    assert units["A2"]["verdict"] == "retest" and type(error).__name__ in units["A2"]["reasons"][0]
    assert units["A1"]["map"] and units["A3"]["map"] and "\x1b" not in "".join(capsys.readouterr())
    monkeypatch.undo()
    assert batch(lot_folder, registry_url)["A2"]["map"], "what passes is tried again"


@pytest.mark.long
def test_a_unit_that_takes_too_long_is_broken_off(lot_folder, registry_url, monkeypatch):
    work = unit_work._work_on_unit

    def endless(shared, task):
        while task.serial == "A2":
            pass
        return work(shared, task)

    monkeypatch.setattr(unit_work, "_work_on_unit", endless)
    # Long enough for the other two on a machine that is busy.
    config = BatchConfig(network=NetworkConfig(hidden=(16, 8)), score_own=False, unit_limit_s=10.0)
    with open_registry(registry_url) as registry:
        report = {unit.serial: unit for unit in run_batch(open_lot_folder(lot_folder), registry, config).units}
    assert not report["A2"].calibration and "10 s" in str(report["A2"].reasons[0])
    assert report["A1"].calibration and report["A3"].calibration


def test_an_end_in_time_is_never_broken_off_later():
    for _ in range(2000):
        with guard.time_limit(60.0):
            pass
    for _ in range(200):
        with suppress(guard.UnitTimeout), guard.time_limit(1e-4):
            sum(range(2000))
        # A limit that fired at the end of the block must not reach this line.
        sum(range(500))


def test_a_limit_that_was_not_reached_hangs_under_no_profiler():
    code = (
        "import cProfile\nfrom softcal.app.batch.guard import UnitTimeout, time_limit\n"
        "def under(limit_s):\n"
        "    with time_limit(limit_s):\n"
        "        return sum(len(str(k)) for k in range(200_000))\n"
        "profile = cProfile.Profile()\n"
        "print(profile.runcall(under, 60.0))\n"
        "try:\n    profile.runcall(under, 1e-3)\nexcept UnitTimeout:\n    print('broken off')\n"
        "print(profile.runcall(under, 60.0))\n"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert process.stdout.split("\n")[:3] == ["1088890", "broken off", "1088890"], process.stderr
