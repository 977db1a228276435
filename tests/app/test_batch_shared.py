"""Several batches share a lot; a batch or a worker that is killed loses nothing and repeats nothing that was kept."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.batch import lot_work, unit_work
from softcal.app.batch.batch import run_batch
from softcal.app.batch.claims import Claims
from softcal.app.batch.engine import EngineChoice
from softcal.app.batch.lot_work import BatchConfig
from softcal.app.calibration import lot_fit
from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.files.regular import read_regular
from softcal.core.lot import Lot
from softcal.core.network.config import NetworkConfig
from softcal.db.connection import open_registry
from softcal.db.queues.work_queue import WorkSet
from softcal.db.registry import Registry
from softcal.db.repositories.calibrations import CalibrationTables
from tests.wait import wait_until

UNITS = 16
SHARING = ["A1", *(f"A{k}" for k in range(4, UNITS + 1))]
"""The units that were pressed by one load at once: copies of A1. A2 and A3 were pressed apart."""

SMALL = ("--hidden", "16,8")


@pytest.fixture
def folder(lot_folder: Path) -> Path:
    """The small lot with more units: each its neighbour with another gain."""
    unit = pd.read_csv(lot_folder / "units/A1.csv")
    for k in range(4, UNITS + 1):
        unit.assign(output=unit.output * (1 + 0.01 * k)).to_csv(lot_folder / f"units/A{k}.csv", index=False)
    return lot_folder


def start(folder: Path, url: str, *more: str) -> subprocess.Popen[bytes]:
    python = [sys.executable, "-m", "softcal.app.cli.main"]
    command = [*python, "batch", str(folder), "--registry", url, *SMALL, "--no-own", *more]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(command, **quiet, env=os.environ | {"OMP_NUM_THREADS": "1"})


def fits(url: str) -> list[tuple[str, bool]]:
    """Every fit of a unit, and whether it came of a lot fit: a fit keeps how long it took, so no two are one."""
    with open_registry(url, create=False) as registry, registry.database.reading() as connection:
        rows = connection.exec_driver_sql("SELECT serial, content FROM fits").all()
    return [(str(serial), json.loads(content)["lot_fit"] is not None) for serial, content in rows]


def count_fits(url: str) -> dict[str, int]:
    """How often every unit was fitted by itself."""
    return Counter(serial for serial, is_of_lot in fits(url) if not is_of_lot)


def assert_one_lot_fit(url: str) -> None:
    """One lot fit was made: it fitted each unit that shares a load once, and is the one in force."""
    assert Counter(serial for serial, is_of_lot in fits(url) if is_of_lot) == dict.fromkeys(SHARING, 1)
    with open_registry(url, create=False) as registry:
        fit = decision_in_force(registry, "small").fit
        parts = [registry.calibrations.get(serial).state.fit.lot_fit for serial in SHARING]
        assert registry.verify() == []
    assert fit.number == 1 and [sorted(sitting) for sitting in fit.sittings] == [sorted(SHARING)]
    assert [part and part.number for part in parts] == [1] * len(SHARING)


def children_of(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_a_batch_that_is_killed_goes_on_at_once_and_repeats_nothing(folder: Path, registry_url: str) -> None:
    process = start(folder, registry_url, "--jobs", "2")
    wait_until(lambda: len(count_fits(registry_url)) >= 2)
    workers = children_of(process.pid)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = count_fits(registry_url)
    assert workers and len(before) < UNITS
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers), within_s=10.0)
    report = folder.parent / "report.json"
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL, "--no-own", "--json", str(report)]) in (0, 1)
    units = json.loads(report.read_text())["units"]
    assert [unit["is_new"] for unit in units].count(False) == len(before)
    assert count_fits(registry_url) == {f"A{k}": 1 for k in range(1, UNITS + 1)}
    assert_one_lot_fit(registry_url)


@pytest.mark.parametrize(
    "where", ["calibration.lot_fit.LotFitDecision", "batch.batch.decide_lot"], ids=["as it is stored", "after it"]
)
def test_a_batch_that_is_killed_at_its_lot_fit_makes_one_all_the_same(
    where: str, folder: Path, registry_url: str
) -> None:
    command = ["batch", str(folder), "--registry", registry_url, *SMALL, "--no-own"]
    package, module, name = where.split(".")
    lines = f"""
import os, signal
from softcal.app.{package} import {module} as module
from softcal.app.cli.main import main
module.{name} = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
main({command})
"""
    for _ in range(2):
        dead = subprocess.run([sys.executable, "-c", lines], capture_output=True, check=False)
        assert dead.returncode == -signal.SIGKILL, dead.stderr.decode()
        assert count_fits(registry_url) == {f"A{k}": 1 for k in range(1, UNITS + 1)}
        if module == "lot_fit":
            assert not any(is_of_lot for _, is_of_lot in fits(registry_url)), "half a lot fit was kept"
    for _ in range(2):
        assert main(command) in (0, 1)
        assert_one_lot_fit(registry_url)
    assert count_fits(registry_url) == {f"A{k}": 1 for k in range(1, UNITS + 1)}


def test_a_batch_goes_on_where_another_made_the_lot_fit_meanwhile(
    folder: Path, registry_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def plan_late(registry: Registry, lot_id: str) -> lot_fit.LotFitPlan:
        late = plan(registry, lot_id)
        if decision_in_force(registry, lot_id).fit.number == 0:
            lot_fit.store_lot_fit(registry, plan(registry, lot_id))
        return late

    plan = lot_fit.plan_lot_fit
    monkeypatch.setattr(lot_fit, "plan_lot_fit", plan_late)
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL, "--no-own"]) in (0, 1)
    assert_one_lot_fit(registry_url)


def test_only_work_of_a_process_of_this_machine_that_died_comes_free_before_its_lease(registry_url: str) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    here, work = socket.gethostname(), WorkSet("L1", "a" * 64)
    with open_registry(registry_url) as registry:
        registry.lots.add(Lot("L1", "S0", 50.0))
        queue = registry.work_queue
        queue.enqueue(work, {f"A{k}": f"{k:064x}" for k in (1, 2, 3)})
        for owner in (f"{here}:{ended.pid}:x", f"{here}:{os.getpid()}:x", f"not-{here}:{ended.pid}:x"):
            assert len(queue.claim(owner, work, 1, 60.0)) == 1
        with Claims(registry, work) as claims:
            assert [item.serial for item in claims.take(3)] == ["A1"]


@pytest.mark.long
def test_two_batches_share_a_lot(folder: Path, registry_url: str, tmp_path: Path) -> None:
    reports = [tmp_path / f"{k}.json" for k in range(2)]
    processes = [start(folder, registry_url, "--json", str(report)) for report in reports]
    assert all(process.wait(120) in (0, 1) for process in processes)
    first, second = (json.loads(report.read_text())["units"] for report in reports)
    assert count_fits(registry_url) == {f"A{k}": 1 for k in range(1, UNITS + 1)}
    assert_one_lot_fit(registry_url)
    assert [unit["map"] for unit in first] == [unit["map"] for unit in second]
    assert all(a["is_new"] != b["is_new"] for a, b in zip(first, second, strict=True))


@pytest.mark.long
def test_a_network_that_another_process_trains_is_waited_for(folder: Path, tmp_path: Path) -> None:
    url, reports = f"sqlite:///{tmp_path / 'new.db'}", [tmp_path / f"{k}.json" for k in range(2)]
    open_registry(url).close()
    processes = [start(folder, url, "--json", str(report)) for report in reports]
    assert all(process.wait(120) in (0, 1) for process in processes)
    is_new = sorted(json.loads(report.read_text())["network_is_new"] for report in reports)
    assert is_new == [False, True]


def _die_at(serial: str):
    work = unit_work._work_on_unit

    def work_or_die(shared, task):
        if task.serial == serial:
            os.kill(os.getpid(), signal.SIGKILL)
        return work(shared, task)

    return work_or_die


def deadly_work(shared, chunk):
    """`work_on` in a worker that dies at unit A5; a function of a module, so that it travels."""
    unit_work._work_on_unit = _die_at("A5")
    return unit_work.work_on(shared, chunk)


@pytest.mark.long
def test_a_unit_that_kills_its_worker_is_named_and_the_rest_is_done(
    folder: Path, registry_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softcal.app.batch.lot_work.work_on", deadly_work)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    config = BatchConfig(network=NetworkConfig(hidden=(16, 8)), engine=EngineChoice(jobs=2), score_own=False)
    with open_registry(registry_url) as registry:
        report = run_batch(open_lot_folder(folder), registry, config)
        assert registry.verify() == []
    uncalibrated = {unit.serial: unit.reasons for unit in report.units if unit.calibration is None}
    assert list(uncalibrated) == ["A5"] and len(uncalibrated["A5"]) == 1
    assert len(count_fits(registry_url)) == UNITS - 1


def test_a_result_that_comes_after_the_lease_ran_out_is_dropped(
    folder: Path, registry_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = BatchConfig(network=NetworkConfig(hidden=(16, 8)), score_own=False)
    claims: list[int] = []
    with open_registry(registry_url) as registry, open_registry(registry_url) as other:

        def steal(shared, chunk):
            # Somebody else holds the items by the time the result is there.
            if not claims:
                with other.database.writing() as connection:
                    claims.append(connection.exec_driver_sql("UPDATE work_items SET owner = 'x:1:y'").rowcount)
            outcome = unit_work.work_on(shared, chunk)
            if len(claims) == 1:
                with other.database.writing() as connection:
                    connection.exec_driver_sql("UPDATE work_items SET state = 'queued' WHERE owner = 'x:1:y'")
                claims.append(0)
            return outcome

        monkeypatch.setattr("softcal.app.batch.lot_work.work_on", steal)
        report = run_batch(open_lot_folder(folder), registry, config)
    assert len(report.units) == UNITS
    assert count_fits(registry_url) == {f"A{k}": 1 for k in range(1, UNITS + 1)}
    assert_one_lot_fit(registry_url)


def test_every_file_is_read_once_and_nothing_made_is_read_back(
    folder: Path, registry_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    golden = folder / "golden"
    golden.mkdir()
    source = pd.read_csv(folder / "source/A0.csv")
    source.assign(output=1.01 * source.output).to_csv(golden / "A0.csv", index=False)
    read: list[str] = []

    def counted(path: Path, *arguments, **more) -> bytes:
        read.append(f"{path.parent.name}/{path.name}")
        return read_regular(path, *arguments, **more)

    monkeypatch.setattr(lot_work, "read_regular", counted)
    monkeypatch.setattr(CalibrationTables, "get", lambda *_, **__: pytest.fail("a calibration was read back"))
    config = BatchConfig(network=NetworkConfig(hidden=(16, 8)), score_own=False)
    with open_registry(registry_url) as registry:
        # What the audits then say of the lot is another matter.
        monkeypatch.setattr("softcal.app.batch.batch.decide_lot", lambda *_: None)
        run_batch(open_lot_folder(folder), registry, config)
    files = [f"units/A{k}.csv" for k in range(1, UNITS + 1)] + [f"audit/A{k}.csv" for k in (1, 2, 3)]
    assert sorted(read) == sorted(files)
    assert len(count_fits(registry_url)) == UNITS


def test_a_lot_that_is_not_held_whole_is_calibrated_whole(
    folder: Path, registry_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lot_work, "MAX_UNREAD_BYTES", 1)
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL, "--no-own"]) in (0, 1)
    assert count_fits(registry_url) == {f"A{k}": 1 for k in range(1, UNITS + 1)}
    assert_one_lot_fit(registry_url)


def test_files_that_change_become_new_work(folder: Path, registry_url: str) -> None:
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL, "--no-own"]) in (0, 1)
    unit = pd.read_csv(folder / "units/A2.csv")
    unit.to_csv(folder / "units/A3.csv", index=False, float_format="%.17g")
    np.testing.assert_array_equal(pd.read_csv(folder / "units/A3.csv").output, unit.output)
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL, "--no-own"]) in (0, 1)
    counts = count_fits(registry_url)
    assert counts == {f"A{k}": 1 + (k == 3) for k in range(1, UNITS + 1)}
    assert_one_lot_fit(registry_url)
    with open_registry(registry_url, create=False) as registry:
        assert registry.work_queue.counts("small") == {"queued": 0, "claimed": 0, "failed": 0}
