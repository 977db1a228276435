"""The source pressed as the golden unit of a sitting: units of that sitting are calibrated over it, by everybody."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from softcal.app.batch.lot_intake import lot_files
from softcal.app.calibration.audit_evidence import AuditReader
from softcal.app.calibration.comparison import compare_on_lot
from softcal.app.cli.main import main
from softcal.app.files.recording_file import write_columns
from softcal.app.line.pressed_run import RunStore
from softcal.app.registry.golden import find_golden_runs
from softcal.app.registry.lot_files import write_lot_folder
from softcal.core.errors import InputError
from softcal.core.maps.config import MapConfig
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Order, OrderKind, Progress
from softcal.core.unit.method import Method
from softcal.db.connection import open_registry
from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry
from softcal.station.record.recording import Alignment, StationRecording
from tests.layers import layered

DAY_GAIN, DAY_ZERO_V = 1.06, 0.01
SMALL = ("--hidden", "16,8")


def quiet(progress: Progress) -> None:
    return None


@pytest.fixture
def registry(registry_url: str) -> Iterator[Registry]:
    with open_registry(registry_url) as registry:
        # Beyond it the golden unit itself would close the gate; the day is well within.
        registry.lots.set_limit("small", 0.5, reason="test")
        yield registry


@pytest.fixture
def run_store(registry: Registry) -> RunStore:
    return RunStore(registry, "s1", NetworkConfig(hidden=(16, 8)))


def press_run(press_unit, serial, gain=1.0, offset_V=0.5, seed=70, is_golden=False):
    """A run on another day, by a programme that the source never had; golden unit and units share it."""
    table = press_unit(1500, gain, offset_V, seed)
    output = offset_V + DAY_GAIN * (table["output"].to_numpy() - offset_V) + DAY_ZERO_V
    aligned = Alignment(*[0.0] * len(fields(Alignment)))
    force_N = table["reference"].to_numpy() if is_golden else None
    t_s = table["t_s"].to_numpy()
    measured = (t_s, output[:, None], np.zeros(len(t_s)), force_N)
    return StationRecording(serial, "unit", *measured, 50.0, "V", 0.0, 0.0, 0.0, 0, aligned)


def press_golden(run_store, press_unit, run=None):
    order = Order("g", "s1", OrderKind.GOLDEN, "A0")
    run_store.check(order)
    return run_store.store(order, run or press_run(press_unit, "A0", is_golden=True), quiet)


def press_product(run_store, press_unit, serial="B1"):
    run = press_run(press_unit, serial, gain=1.2, offset_V=0.6)
    return run_store.store(Order(f"o{serial}", "s1", OrderKind.UNIT, serial, "small"), run, quiet)


def correction_codes(stored: StoredCalibration) -> set[str]:
    return {why.code for why in stored.state.decision.reasons if why.code.startswith("bridge.")}


def batched(folder: Path, url: str, out: Path) -> dict[str, dict[str, object]]:
    assert main(["batch", str(folder), "--registry", url, "--json", str(out), *SMALL]) in (0, 1)
    return {unit["serial"]: unit for unit in json.loads(out.read_text())["units"]}


def test_a_unit_is_calibrated_over_the_golden_run_of_its_sitting(registry, run_store, press_unit):
    press_product(run_store, press_unit, "B0")
    assert not correction_codes(registry.calibrations.get("B0"))
    assert press_golden(run_store, press_unit).verdict == "pass"
    press_product(run_store, press_unit)
    calibration = registry.calibrations.get("B1")
    assert correction_codes(calibration) == {"bridge.measured"}
    (golden,) = registry.recordings.of_lot("small", "A0", "audit")
    assert find_golden_runs(registry, "small", ["B0", "B1"]) == {
        calibration.state.fit.recording_sha256: ("B1", golden.sha256)
    }
    assert registry.stations.golden_runs()[-1].recording_sha256 == golden.sha256


def test_a_later_calibration_of_that_recording_has_the_same_day_correction(
    registry, registry_url, run_store, press_unit, tmp_path
):
    press_golden(run_store, press_unit)
    press_product(run_store, press_unit)
    state = registry.calibrations.get("B1").state
    with lot_files(registry, "small", lambda done, of: None) as folder:
        again = batched(folder.root, registry_url, tmp_path / "again.json")
    assert (again["B1"]["is_new"], again["B1"]["map"]["sha256"]) == (False, state.map_sha256)
    assert [one.revision for one in registry.calibrations.history("B1")] == [1]


@pytest.mark.long
def test_a_lot_that_is_laid_out_takes_its_golden_run_along(registry, run_store, press_unit, tmp_path):
    press_golden(run_store, press_unit)
    press_product(run_store, press_unit)
    state = registry.calibrations.get("B1").state
    folder = write_lot_folder(registry, "small", tmp_path / "one")
    assert folder["golden"] == ["A0"] and folder["audit"] == []
    elsewhere = f"sqlite:///{tmp_path / 'elsewhere.db'}"
    there = batched(tmp_path / "one", elsewhere, tmp_path / "there.json")
    assert there["B1"]["verdict"] == state.verdict
    with open_registry(elsewhere) as other:
        assert correction_codes(other.calibrations.get("B1")) == {"bridge.measured"}
        # The folder told it, and the registry knows it from now on.
        assert {serial for serial, _ in find_golden_runs(other, "small", ["B1"]).values()} == {"B1"}
    # A unit of another sitting: one folder cannot say which belongs to which.
    press_product(RunStore(registry, "s2", NetworkConfig(hidden=(16, 8))), press_unit, "B2")
    assert "golden" not in write_lot_folder(registry, "small", tmp_path / "two")


@pytest.mark.parametrize("why", ["another station", "an earlier sitting", "it failed"])
def test_a_golden_run_of_elsewhere_or_that_failed_carries_no_unit(why, registry, run_store, press_unit):
    run = press_run(press_unit, "A0", is_golden=True)
    if why == "it failed":
        run = replace(run, force_N=1.5 * run.force_N)
    progress = press_golden(run_store, press_unit, run)
    assert progress.verdict == ("fail" if why == "it failed" else "pass")
    station = "s2" if why == "another station" else "s1"
    sitting = timedelta(0) if why == "an earlier sitting" else timedelta(hours=8)
    other = RunStore(registry, station, NetworkConfig(hidden=(16, 8)), sitting=sitting)
    press_product(other, press_unit)
    assert find_golden_runs(registry, "small", ["B1"]) == {}
    assert not correction_codes(registry.calibrations.get("B1"))


def test_a_golden_run_that_no_day_explains_fails_and_says_so(registry, run_store, press_unit):
    run = press_run(press_unit, "A0", is_golden=True)
    progress = press_golden(run_store, press_unit, replace(run, force_N=9.81 * run.force_N))
    golden, correction, hold = progress.message
    assert (progress.verdict, golden.code, hold.code) == ("fail", "golden.error", "golden.held") and str(correction)


def test_golden_runs_of_the_source_show_how_days_differ(registry, run_store, press_unit):
    press_golden(run_store, press_unit)
    gains = AuditReader(registry, Method())._gains_by_day("small", "A0", datetime.now(UTC))
    assert gains == [pytest.approx(DAY_GAIN, abs=0.04)]


def test_a_serial_that_is_neither_source_nor_calibrated_is_no_golden_unit(run_store):
    with pytest.raises(InputError):
        run_store.check(Order("g", "s1", OrderKind.GOLDEN, "Z9"))


def test_a_golden_run_that_lay_in_a_lot_folder_is_known_when_the_registry_lays_it_out(
    registry, registry_url, lot_folder, press_unit, tmp_path
):
    shutil.rmtree(lot_folder / "audit")
    (lot_folder / "golden").mkdir()
    table = press_unit(1500, 1.0, 0.5, 11)
    table.to_csv(lot_folder / "golden/A0.csv", index=False)
    batched(lot_folder, registry_url, tmp_path / "first.json")
    with lot_files(registry, "small", lambda done, of: None) as folder:
        again = batched(folder.root, registry_url, tmp_path / "again.json")
    assert {serial for serial, unit in again.items() if unit["is_new"]} == set()


@pytest.mark.parametrize(
    "golden_source",
    layered(("no golden run", "under the load cell", "without the load cell"), ("under the load cell",)),
)
@pytest.mark.parametrize("is_pressed_first", [True, False])
def test_line_batch_and_comparison_calibrate_a_recording_over_one_golden_run(
    golden_source, is_pressed_first, registry, registry_url, run_store, lot_folder, press_unit, tmp_path
):
    """Whatever lies in the folder, whoever was first: what the batch decided with is what everybody has after it."""
    run = press_run(press_unit, "B1", gain=1.2, offset_V=0.6)
    order = Order("o", "s1", OrderKind.UNIT, "B1", "small")
    for part in ("units", "audit"):
        shutil.rmtree(lot_folder / part)
    unit = run.output_recording()
    write_columns(
        lot_folder / "units/B1.csv", [("t_s", unit.t_s), ("output", unit.output), ("stage_mm", unit.stage_mm)]
    )
    if golden_source != "no golden run":
        golden = press_unit(1500, 1.0, 0.5, 11)
        golden = golden if golden_source == "under the load cell" else golden.drop(columns="reference")
        (lot_folder / "golden").mkdir()
        golden.to_csv(lot_folder / "golden/A0.csv", index=False)
    press_golden(run_store, press_unit)
    if is_pressed_first or golden_source != "under the load cell":
        run_store.store(order, run, quiet)
    batched(lot_folder, registry_url, tmp_path / "batch.json")
    calibration = registry.calibrations.get("B1")
    # The sitting goes on: a newer golden run is none of this recording's.
    newer = press_run(press_unit, "A0", seed=71, is_golden=True)
    run_store.store(Order("g2", "s1", OrderKind.GOLDEN, "A0"), newer, quiet)
    run_store.store(order, run, quiet)
    again = batched(lot_folder, registry_url, tmp_path / "again.json")
    with lot_files(registry, "small", lambda done, of: None) as folder:
        laid_out = batched(folder.root, registry_url, tmp_path / "laid_out.json")
    assert not again["B1"]["is_new"] and not laid_out["B1"]["is_new"]
    now = registry.calibrations.get("B1")
    assert (now.input_sha256, now.state.map_sha256) == (calibration.input_sha256, calibration.state.map_sha256)
    request = {
        "lot": "small",
        "networks": [calibration.state.fit.network_id],
        "families": [MapConfig().family],
        "units": 1,
    }
    (row,) = compare_on_lot(registry, request, lambda *_: None)
    assert row["predicted"] == calibration.state.predicted_rmse
