"""From the rig to verdicts: what a station records is a lot folder that `batch` takes, whatever happened on the way."""

import json
import shutil
import subprocess
import sys
import threading
from itertools import takewhile

import numpy as np
import pytest

from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.line.serve import Serving, serve
from softcal.app.line.station_gate import RIG_ONLY
from softcal.core.messages.reason import Reason
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Order, OrderKind, RunState, StationState
from softcal.db.connection import open_registry
from tests.wait import wait_until

SMALL = ("--hidden", "16")
PRESSES = 4
"""How often a person would try."""
SHORT = {"source": ("--seconds", "40"), "unit": ("--seconds", "12")}


@pytest.fixture
def softcal(tmp_path, monkeypatch, capsys):
    """Run `softcal` in the test's folder, with data of its own, and give back what it said."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)

    def call(*arguments, expected=0):
        capsys.readouterr()
        code, printed = main([str(word) for word in arguments]), capsys.readouterr()
        assert code in ((expected,) if isinstance(expected, int) else expected), printed
        return printed.err

    return call


def press(softcal, kind, serial, seed, path, **more):
    arguments = ("--simulated", seed, "--serial", serial, "--out", path, "--spool", "spool", *SHORT[kind])
    return softcal("station", kind, *arguments, **more)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A lot of one source and three units, pressed on the simulated rig over its serial lines."""
    folder = tmp_path_factory.mktemp("recorded")
    for serial, seed, kind in (("A0", 11, "source"), ("A1", 12, "unit"), ("A2", 13, "unit"), ("A3", 14, "unit")):
        path = folder / "lot-1" / ("source" if kind == "source" else "units") / f"{serial}.csv"
        arguments = ["--simulated", str(seed), "--serial", serial, "--out", str(path), "--spool", str(folder / "spool")]
        assert main(["station", kind, *arguments, *SHORT[kind]]) == 0
    return folder


@pytest.fixture
def pressed_lot(recorded, tmp_path):
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)


def batch(softcal, tmp_path, lot="lot-1", out="out"):
    arguments = ("batch", lot, "--registry", f"sqlite:///{tmp_path / 'r.db'}", "--out", out, "--json", f"{out}.json")
    softcal(*arguments, *SMALL, expected=(0, 1))
    return json.loads((tmp_path / f"{out}.json").read_text())


@pytest.mark.long
def test_a_source_and_three_units_end_in_verdicts_and_import_takes_the_folder_too(softcal, pressed_lot, tmp_path):
    report = batch(softcal, tmp_path)
    assert {unit["serial"] for unit in report["units"]} == {"A1", "A2", "A3"}
    assert all(unit["map"]["sha256"] for unit in report["units"])
    assert not list((tmp_path / "spool").iterdir())
    columns = ("--time-column", "t_s", "--reference-column", "reference", "--stage-column", "stage_mm")
    softcal("import", "lot-1", "--source", "A0", *columns, "--sample-rate", 50, "--out", "lot-2")
    again = open_lot_folder(tmp_path / "lot-2")
    assert (again.lot.source, sorted(again.unit_paths)) == ("A0", ["A1", "A2", "A3"])
    for serial in again.unit_paths:
        first = open_lot_folder(tmp_path / "lot-1").read_unit(serial)
        np.testing.assert_array_equal(again.read_unit(serial).output, first.output)


@pytest.mark.long
def test_an_interrupted_unit_leaves_a_folder_that_batch_takes_and_can_be_pressed_again(softcal, pressed_lot, tmp_path):
    (tmp_path / "lot-1" / "units" / "A2.csv").unlink()
    (tmp_path / "lot-1" / "units" / "A3.csv").unlink()
    arguments = ["station", "unit", "--simulated", "13", "--serial", "A2", "--out", "lot-1/units/A2.csv"]
    command = [sys.executable, "-m", "softcal.app.cli.main", *arguments, "--spool", "spool", "--seconds", "3000"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    next(line for line in process.stderr if "pressing" in line)
    process.kill()
    process.communicate()
    assert [path.name for path in (tmp_path / "lot-1" / "units").iterdir()] == ["A1.csv"]
    assert [unit["serial"] for unit in batch(softcal, tmp_path)["units"]] == ["A1"]
    softcal("station", "recover", "--spool", "spool", "--out", "recovered")
    assert [path.suffixes for path in (tmp_path / "recovered").iterdir()][0][-2:] == [".aborted", ".csv"]
    press(softcal, "unit", "A2", 13, "lot-1/units/A2.csv")
    assert {unit["serial"] for unit in batch(softcal, tmp_path)["units"]} == {"A1", "A2"}


@pytest.mark.long
def test_a_second_source_run_is_used_or_reported(softcal, pressed_lot, tmp_path):
    toml = tmp_path / "lot-1" / "lot.toml"
    toml.write_text(toml.read_text() + "\n[limit]\nrmse = 0.7\n")
    first = batch(softcal, tmp_path)
    press(softcal, "source", "A0", 11, "lot-1/source/A0.csv")
    assert "rmse = 0.7" in toml.read_text()
    other = press(softcal, "source", "B0", 21, "lot-1/source/B0.csv")
    assert "A0" in other and "B0" in other
    assert batch(softcal, tmp_path)["network"] == first["network"]
    toml.write_text(toml.read_text().replace('source = "A0"', 'source = "B0"').replace('"lot-1"', '"lot-1b"'))
    assert batch(softcal, tmp_path)["network"] != first["network"]


def test_what_the_lot_folder_could_not_use_is_refused_before_anything_moves(softcal, pressed_lot, tmp_path):
    shutil.rmtree(tmp_path / "lot-1" / "units")
    same = press(softcal, "unit", "A0", 12, "lot-1/units/A0.csv", expected=2)
    assert "A0" in same and same.count("\n") == 1
    toml = tmp_path / "lot-1" / "lot.toml"
    toml.write_text(toml.read_text().replace("50.0", "80.0"))
    rate = press(softcal, "unit", "A1", 12, "lot-1/units/A1.csv", expected=2)
    assert "80 Hz" in rate and "50 Hz" in rate
    assert not (tmp_path / "lot-1" / "units").exists()


@pytest.mark.long
def test_orders_end_in_a_lot_folder_of_which_batch_computes_nothing_again(softcal, tmp_path):
    url = f"sqlite:///{tmp_path / 'r.db'}"
    orders = [("A0", OrderKind.SOURCE), ("A1", OrderKind.UNIT), ("A2", OrderKind.UNIT)]
    with open_registry(url) as registry:
        queue, over = registry.order_queue, threading.Event()

        def order_all() -> None:
            try:
                wait_until(
                    lambda: (heartbeat := queue.heartbeat("s1")) and heartbeat.state is not StationState.STARTING
                )
                for serial, kind in orders:
                    queue.place(Order(serial, "s1", kind, serial, "L1"))
                    wait_until(lambda serial=serial: not queue.progress(serial).state.is_active)
            finally:
                over.set()

        network = NetworkConfig(hidden=(16,))
        serving = Serving("s1", None, 3, 1000.0, source_s=40.0, unit_s=12.0, rules=RIG_ONLY, network=network)
        person = threading.Thread(target=order_all)
        person.start()
        serve(registry, serving, tmp_path / "spool", lambda: not over.is_set())
        person.join()
        assert {queue.progress(serial).state for serial, _ in orders} == {RunState.DONE}
        before = {serial: registry.calibrations.get(serial).state for serial in ("A1", "A2")}
    softcal("lot", "folder", "L1", "--registry", url, "--out", "lot-1")
    folder = open_lot_folder(tmp_path / "lot-1")
    assert (folder.lot.id, folder.lot.source, sorted(folder.unit_paths)) == ("L1", "A0", ["A1", "A2"])
    report = {unit["serial"]: unit for unit in batch(softcal, tmp_path)["units"]}
    assert {s: unit["map"]["sha256"] for s, unit in report.items()} == {s: r.map_sha256 for s, r in before.items()}
    with open_registry(url) as registry:
        # The files hold what the registry holds, to the last digit.
        assert len(registry.recordings.of_lot("L1")) == 3 and len(registry.networks.all()) == 1
    refused = softcal("lot", "folder", "L1", "--registry", url, "--out", "lot-1", expected=2)
    assert "lot-1" in refused


RIG = """
import sys
from dataclasses import replace
import numpy as np
from softcal.core.simulated_lot import draw_lot
from softcal.station.bench.bench import simulated_config
from softcal.station.bench.station_file import station_toml
from softcal.station.bench.simulated_station import SimulatedStation

units = draw_lot(np.random.default_rng(5), 4)
rig = SimulatedStation(units[0], np.random.default_rng(5))
with rig.world.in_background():
    print(station_toml(replace(simulated_config(rig), name="bench")), "end", sep="\\n", flush=True)
    for line in sys.stdin:
        rig.mount(units[int(line)])
        print("mounted", flush=True)
rig.close()
"""
"""A rig that lives in real time, as a process of its own: it must not wait for the station's interpreter."""


@pytest.mark.long
def test_the_same_from_a_station_file_over_serial_lines_in_real_time(softcal, tmp_path):
    rig = subprocess.Popen([sys.executable, "-c", RIG], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with rig:
        assert rig.stdin is not None and rig.stdout is not None
        (tmp_path / "station.toml").write_text("".join(takewhile(lambda line: line != "end\n", rig.stdout)))
        arguments = ("--station", "station.toml", "--spool", "spool")
        for k, (kind, folder) in enumerate([("source", "source"), *[("unit", "units")] * 3]):
            rig.stdin.write(f"{k}\n")
            rig.stdin.flush()
            assert rig.stdout.readline() == "mounted\n"
            path = tmp_path / "lot-1" / folder / f"A{k}.csv"
            for _ in range(PRESSES):
                order = ("--serial", f"A{k}", "--out", path, *SHORT[kind])
                printed = softcal("station", kind, *arguments, *order, expected=(0, 3))
                if path.exists():
                    break
                # A machine that is busy otherwise reads late; then the run is aborted, as it must be.
                assert str(Reason("left.lifted")) in printed
        rig.stdin.close()
    report = batch(softcal, tmp_path)
    assert {unit["serial"] for unit in report["units"]} == {"A1", "A2", "A3"}
    assert open_lot_folder(tmp_path / "lot-1").reference is not None
