"""One recording, one calibration: pressed on the line, batched, and batched elsewhere after the registries met."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import softcal
from softcal.app.batch.lot_intake import lot_files
from softcal.app.calibration.comparison import compare_on_lot
from softcal.app.cli.main import main
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.content import build_certificate
from softcal.app.files.anchors import write_anchors
from softcal.app.files.recording_file import write_columns
from softcal.app.line.pressed_run import RunStore
from softcal.app.registry.known_loads import known_loads
from softcal.app.registry.lot_files import write_lot_folder
from softcal.app.registry.lot_recordings import source_model, unlabelled
from softcal.app.registry.reference import lot_reference
from softcal.core.errors import InputError
from softcal.core.maps.config import MapConfig
from softcal.core.maps.interface import Anchors
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Order, OrderKind, Progress
from softcal.core.quality.known_loads import KnownLoad
from softcal.core.quality.line_rules import LineRules
from softcal.core.unit.method import Method
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import stated_limit
from softcal.db.connection import open_registry
from softcal.db.maintenance.sync import synchronise
from softcal.db.registry import Registry
from softcal.station.record.method import METHOD
from softcal.station.record.recording import Alignment, StationRecording
from softcal.station.tasks.at_rest import RestReading

SMALL = ("--hidden", "16,8")
REFERENCE = {"source": "reference", "audit": "reference"}


@pytest.fixture
def registry(registry_url: str) -> Iterator[Registry]:
    with open_registry(registry_url) as registry:
        yield registry


@pytest.fixture
def run_store(registry: Registry) -> RunStore:
    return RunStore(registry, "s1", NetworkConfig(hidden=(16, 8)))


def run_of_file(folder: Path, serial: str) -> StationRecording:
    """Return the run of a unit as a station gives it, made from the lot's own file."""
    table = pd.read_csv(folder / "units" / f"{serial}.csv")
    t_s, output = table["t_s"].to_numpy(), table["output"].to_numpy()
    stage_mm = np.round(np.abs(np.sin(t_s / 3)), 5)
    aligned = Alignment(*[0.0] * len(fields(Alignment)))
    return StationRecording(serial, "unit", t_s, output[:, None], stage_mm, None, 50.0, "V", 0.0, 0.0, 0.0, 0, aligned)


def test_a_recording_says_by_which_method_a_station_proved_it(lot_folder, registry_url, tmp_path, registry, run_store):
    shutil.rmtree(lot_folder / "audit")
    batched(lot_folder, registry_url, tmp_path / "brought.json")
    proven = replace(run_of_file(lot_folder, "A1"), proof_method=METHOD.id)
    proven = replace(proven, output=np.round(1.01 * proven.output, 7))
    run_store.store(Order("o1", "s1", OrderKind.UNIT, "A1", "small"), proven, ignore_progress)
    entries = registry.recordings.of_lot("small", kind="unit")
    assert {(e.serial, e.proof_method) for e in entries if e.proof_method} == {("A1", METHOD.id)}
    assert len(entries) > 1
    assert (
        main(["registry", "history", "--serial", "A1", "--registry", registry_url, "--json", str(tmp_path / "h.json")])
        == 0
    )
    revisions = json.loads((tmp_path / "h.json").read_text())["revisions"]
    assert [revision["proof_method"] for revision in revisions] == [None, METHOD.id]
    pressed_unit, imported_unit = (
        UnitLoader(registry, ExportOptions()).load("A1"),
        UnitLoader(registry, ExportOptions()),
    )
    label = "method that proved the unit's recording"
    assert build_certificate(pressed_unit).provenance.inputs[label] == METHOD.id
    assert label not in build_certificate(imported_unit.load("A2")).provenance.inputs


def batched(folder: Path, url: str, out: Path, *more: str) -> dict[str, dict[str, object]]:
    assert main(["batch", str(folder), "--registry", url, "--json", str(out), *SMALL, *more]) in (0, 1)
    return {unit["serial"]: unit for unit in json.loads(out.read_text())["units"]}


def test_a_unit_pressed_on_the_line_and_batched_anywhere_has_one_calibration(
    lot_folder, registry_url, tmp_path, registry, run_store
):
    shutil.rmtree(lot_folder / "audit")
    runs = {serial: run_of_file(lot_folder, serial) for serial in ("A1", "A2", "A3")}
    for serial, run in runs.items():
        run_store.store(Order(f"o{serial}", "s1", OrderKind.UNIT, serial, "small"), run, ignore_progress)
    calibrations = {serial: registry.calibrations.get(serial) for serial in runs}
    for serial, run in runs.items():
        unit = run.output_recording()
        columns = [("t_s", unit.t_s), ("output", unit.output), ("stage_mm", unit.stage_mm)]
        write_columns(lot_folder / "units" / f"{serial}.csv", columns)  # type: ignore[arg-type]
    here = batched(lot_folder, registry_url, tmp_path / "here.json")
    other_url = f"sqlite:///{tmp_path / 'other.db'}"
    with open_registry(registry_url) as one, open_registry(other_url) as other:
        synchronise(one, other)
    there = batched(lot_folder, other_url, tmp_path / "there.json")
    with open_registry(other_url) as registry:
        for serial, stored in calibrations.items():
            (only,) = registry.calibrations.history(serial)
            assert (only.revision, only.input_sha256) == (1, stored.input_sha256)
            assert only.state.fit.fit_s and only.state.fit.fit_s > 0
            for report in (here, there):
                assert not report[serial]["is_new"]
                map_ = {"family": stored.state.fit.family, "revision": 1, "sha256": stored.state.map_sha256}
                # Three units that were pressed apart share no load: the batch makes no lot fit of them.
                assert report[serial]["map"] == map_ | {"lot_fit": None}
                assert report[serial]["verdict"] == stored.state.verdict


ADDED_KNOWLEDGE = ("nothing", "spread of the line", "audit", "loads", "golden run", "another source")


def add_to_folder(what: str, folder: Path, press_unit) -> None:
    """Leave in a lot folder unit A1 and one kind of fact about it."""
    for serial in ("A2", "A3"):
        (folder / "units" / f"{serial}.csv").unlink()
    if what != "audit":
        shutil.rmtree(folder / "audit")
    toml = folder / "lot.toml"
    if what == "spread of the line":
        toml.write_text(toml.read_text() + "[line]\nload_spread = 0.05\n")
    if what == "loads":
        rest, full = levels(folder, "A1")
        write_anchors(folder / "anchors.csv", {"A1": Anchors(np.array([rest, full]), np.array([0.0, 2.0]))})
    if what == "golden run":
        (folder / "golden").mkdir()
        press_unit(1500, 1.0, 0.5, 11).to_csv(folder / "golden/A0.csv", index=False)
    if what == "another source":
        toml.write_text(toml.read_text().replace("[lot]\n", '[lot]\nmore_sources = ["S9"]\n'))
        press_unit(1500, 1.2, 0.55, 12).to_csv(folder / "source/S9.csv", index=False)


@pytest.mark.parametrize("what", ADDED_KNOWLEDGE)
def test_whoever_calibrates_a_recording_starts_from_the_same(
    what, lot_folder, registry_url, registry, run_store, press_unit, tmp_path
):
    add_to_folder(what, lot_folder, press_unit)
    run = run_of_file(lot_folder, "A1")
    unit = run.output_recording()
    columns = [("t_s", unit.t_s), ("output", unit.output), ("stage_mm", unit.stage_mm)]
    write_columns(lot_folder / "units/A1.csv", columns)  # type: ignore[arg-type]
    batched(lot_folder, registry_url, tmp_path / "batch.json")
    (calibration,) = (one for one in registry.calibrations.history("A1") if one.revision == 1)
    run_store.store(Order("o", "s1", OrderKind.UNIT, "A1", "small"), run, ignore_progress)
    assert [one.input_sha256 for one in registry.calibrations.history("A1")] == [calibration.input_sha256]
    request = {
        "lot": "small",
        "networks": [calibration.state.fit.network_id],
        "families": [MapConfig().family],
        "units": 1,
    }
    (row,) = compare_on_lot(registry, request, lambda *_: None)
    assert (row["predicted"], row["after"]) == (
        calibration.state.predicted_rmse,
        calibration.state.errors["after_rmse"],
    )
    with lot_files(registry, "small", lambda *_: None) as folder:
        again = batched(folder.root, registry_url, tmp_path / "again.json")
    assert not again["A1"]["is_new"]


@pytest.mark.long
@pytest.mark.parametrize("what", ADDED_KNOWLEDGE)
def test_a_worker_and_python_start_from_the_same(what, lot_folder, registry_url, press_unit, tmp_path):
    add_to_folder(what, lot_folder, press_unit)
    shutil.copy(lot_folder / "units/A1.csv", lot_folder / "units/A4.csv")
    batched(lot_folder, registry_url, tmp_path / "one.json")
    elsewhere = f"sqlite:///{shutil.copy(tmp_path / 'registry.db', tmp_path / 'two.db')}"
    batched(lot_folder, elsewhere, tmp_path / "two.json", "--jobs", "2", "--refit")
    with open_registry(registry_url) as one, open_registry(elsewhere) as two:
        by_line, by_worker = one.calibrations.history("A1")[0], two.calibrations.history("A1")[-1]
        network = one.networks.get(by_line.state.fit.network_id)
    assert by_worker.input_sha256 == by_line.input_sha256
    if what not in ("nothing", "audit", "loads"):
        return
    files = {"source": "source/A0.csv", "unit": "units/A1.csv", "audit": "audit/A1.csv"}
    read = {
        name: softcal.Recording.from_frame(
            table, time_s="t_s", serial="A0" if name == "source" else "A1", reference=REFERENCE.get(name)
        )
        for name, file in files.items()
        if (lot_folder / file).exists() and (table := pd.read_csv(lot_folder / file)) is not None
    }
    source = softcal.fit_network(read["source"], hidden=(16, 8))
    anchors = pd.read_csv(lot_folder / "anchors.csv") if what == "loads" else None
    in_python = softcal.fit_map(source, read["unit"], anchors=anchors, audit=read.get("audit"))
    assert source.network.id == network.id
    assert in_python.state.map_sha256 == by_line.state.map_sha256


def ignore_progress(progress: Progress) -> None:
    return None


LOADS = LineRules(loads=(KnownLoad(0.0), KnownLoad(2.0, 0.002)))


def reading(serial: str, step: int, load: float, level: float) -> tuple[Order, RestReading]:
    """Return one reading at rest as the line orders it and a station gives it."""
    noise = np.random.default_rng(step).normal(0.0, 1e-5, (150, 1))
    order = Order(f"l{step}{serial}", "s1", OrderKind.LOAD, serial, "small", reason=f"{step}: {load!r}")
    return order, RestReading(serial, level + noise, "V")


def levels(folder: Path, serial: str) -> tuple[float, float]:
    """Return the unit's own outputs with nothing on it and well pressed: what a reading under two loads may give."""
    output = pd.read_csv(folder / "units" / f"{serial}.csv")["output"].to_numpy()
    start, ends = float(np.median(output[: len(output) // 100])), np.quantile(output, [0.02, 0.85])
    return start, float(ends[int(np.argmax(np.abs(ends - start)))])


def test_known_loads_of_the_line_are_those_of_every_later_calibration(
    lot_folder, registry_url, tmp_path, registry, run_store
):
    shutil.rmtree(lot_folder / "audit")
    rest, pressed_level = levels(lot_folder, "A1")
    registry.lots.set_line_rules("small", LOADS, reason="two weights")
    run = run_store.store(
        Order("o", "s1", OrderKind.UNIT, "A1", "small"), run_of_file(lot_folder, "A1"), ignore_progress
    )
    assert run.message[0].code == "load.wanted" and not run.verdict
    assert registry.lots.units(serial="A1")[0].revision is None, "judged before its loads were read"
    first = run_store.store(*reading("A1", 1, 0.0, rest), ignore_progress)
    assert first.message[0].code == "load.read" and not first.verdict
    progress = run_store.store(*reading("A1", 2, 2.0, pressed_level), ignore_progress)
    assert progress.verdict
    (stored,) = registry.calibrations.history("A1")
    (loads,) = known_loads(registry, "small").values()
    np.testing.assert_allclose(loads.loads.output, [rest, pressed_level], atol=1e-5)
    # The owner of anchors makes the same of them: one input, one calibration.
    model = source_model(registry, stored.state.fit.network_id, Method())
    unit = registry.recordings.get(stored.state.fit.recording_sha256)
    limit = stated_limit("N", registry.lots.get("small").limit_rmse)
    alone = UnitProblem(model, unlabelled(unit), limit, reference=lot_reference(registry, "small"))
    assert stored.input_sha256 == replace(alone, anchors=loads.loads).input_sha256 != alone.input_sha256
    laid_out = tmp_path / "laid-out"
    write_lot_folder(registry, "small", laid_out)
    assert {"t_s", "output"} <= set(pd.read_csv(laid_out / "units" / "A1.csv"))
    # Laid out with its loads or without them: the registry knows them, and the revision stays the only one.
    batched(laid_out, registry_url, tmp_path / "with.json")
    (laid_out / "anchors.csv").unlink()
    batched(laid_out, registry_url, tmp_path / "without.json")
    assert [one.revision for one in registry.calibrations.history("A1")] == [stored.revision]


@pytest.mark.parametrize(
    ("levels_read", "codes"),
    [
        ((0.0, 0.0), ["load.read", "load.unloaded"]),
        ((0.0, 1.0), ["load.read", ""]),
        ((0.0, -0.3), ["load.read", "load.contradict"]),
    ],
    ids=["the second weight was not put on", "good", "against the direction of the source"],
)
def test_loads_that_cannot_be_calibrate_nothing(levels_read, codes, lot_folder, registry, run_store):
    rest, full = levels(lot_folder, "A1")
    registry.lots.set_line_rules("small", LOADS, reason="two weights")
    run_store.store(Order("o", "s1", OrderKind.UNIT, "A1", "small"), run_of_file(lot_folder, "A1"), ignore_progress)
    for step, (load, share, code) in enumerate(zip((0.0, 2.0), levels_read, codes, strict=True), 1):
        progress = run_store.store(*reading("A1", step, load, rest + share * (full - rest)), ignore_progress)
        assert (progress.message[0].code == code and not progress.verdict) if code else progress.verdict
    is_good = not codes[-1]
    assert (registry.lots.units(serial="A1")[0].revision is not None) == is_good
    assert bool(known_loads(registry, "small")) == is_good


def test_a_reading_that_is_not_due_is_refused_before_it_begins(lot_folder, registry, run_store):
    due = Order("x", "s1", OrderKind.LOAD, "A1", "small", reason="1: 0.0")
    registry.lots.set_line_rules("small", LOADS, reason="two weights")
    run_store.store(Order("o", "s1", OrderKind.UNIT, "A1", "small"), run_of_file(lot_folder, "A1"), ignore_progress)
    reasons = ({"reason": text} for text in ("2: 2.0", "1: 2.0", "the second"))
    for changes in ({"serial": "A2"}, {"lot_id": "other"}, *reasons):
        with pytest.raises(InputError):
            run_store.check(replace(due, **changes))
    run_store.check(due)


@pytest.mark.parametrize(
    "loads",
    [((0.0, 0.0), (4000.0, 0.0)), ((0.0, 0.0), (2.0, 1.0))],
    ids=["in the wrong unit", "not known well enough"],
)
def test_loads_that_no_calibration_can_use_stop_the_unit_before_anything_moves(loads, registry, run_store):
    registry.lots.set_line_rules("small", LineRules(loads=loads), reason="weights")  # type: ignore[arg-type]
    with pytest.raises(InputError):
        run_store.check(Order("o", "s1", OrderKind.UNIT, "A1", "small"))
