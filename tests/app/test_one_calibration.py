"""One recording, one calibration: pressed on the line, batched, and batched elsewhere after the registries met."""

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.files.recording_file import write_columns
from softcal.app.line.pressed_run import RunKeeper
from softcal.app.registry.known_loads import known_loads
from softcal.app.registry.laid_out import write_lot_folder
from softcal.app.registry.reference import lot_reference
from softcal.app.registry.source import source_model, unlabelled
from softcal.core.errors import InputError
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Order, OrderKind
from softcal.core.quality.known_loads import KnownLoad
from softcal.core.quality.line_rules import LineRules
from softcal.core.unit.calibrate import UnitProblem
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import stated_limit
from softcal.db.connection import open_registry
from softcal.db.sync import synchronise
from softcal.station.at_rest import RestReading
from softcal.station.recording import Alignment, StationRecording

SMALL = ("--hidden", "16,8")


def pressed(folder: Path, serial: str) -> StationRecording:
    """Return the run of a unit as a station gives it, made from the lot's own file."""
    table = pd.read_csv(folder / "units" / f"{serial}.csv")
    t_s, output = table["t_s"].to_numpy(), table["output"].to_numpy()
    stage_mm = np.round(np.abs(np.sin(t_s / 3)), 5)
    aligned = Alignment(*[0.0] * len(fields(Alignment)))
    return StationRecording(serial, "unit", t_s, output[:, None], stage_mm, None, 50.0, "V", 0.0, 0.0, 0.0, 0, aligned)


def batched(folder: Path, url: str, out: Path) -> dict[str, dict[str, object]]:
    assert main(["batch", str(folder), "--registry", url, "--json", str(out), *SMALL]) in (0, 1)
    return {unit["serial"]: unit for unit in json.loads(out.read_text())["units"]}


def test_a_unit_pressed_on_the_line_and_batched_anywhere_has_one_calibration(
    lot_folder: Path, registry_url: str, tmp_path: Path
) -> None:
    shutil.rmtree(lot_folder / "audit")
    runs = {serial: pressed(lot_folder, serial) for serial in ("A1", "A2", "A3")}
    with open_registry(registry_url) as registry:
        keeper = RunKeeper(registry, "s1", NetworkConfig(hidden=(16, 8)))
        for serial, run in runs.items():
            keeper.keep(Order(f"o{serial}", "s1", OrderKind.UNIT, serial, "small"), run, lambda progress: None)
        made = {serial: registry.calibration(serial) for serial in runs}
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
        for serial, stored in made.items():
            (only,) = registry.history(serial)
            assert (only.revision, only.record.input_sha256) == (1, stored.record.input_sha256)
            assert only.record.fit_s and only.record.fit_s > 0
            for report in (here, there):
                assert not report[serial]["is_new"]
                assert report[serial]["map"] == {
                    "family": stored.record.family,
                    "revision": 1,
                    "sha256": stored.record.map_sha256,
                }
                assert report[serial]["verdict"] == stored.record.verdict


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
    lot_folder: Path, registry_url: str, tmp_path: Path
) -> None:
    shutil.rmtree(lot_folder / "audit")
    rest, pressed_level = levels(lot_folder, "A1")
    say = lambda progress: None  # noqa: E731
    with open_registry(registry_url) as registry:
        registry.set_line_rules("small", LOADS, reason="two weights")
        keeper = RunKeeper(registry, "s1", NetworkConfig(hidden=(16, 8)))
        run = keeper.keep(Order("o", "s1", OrderKind.UNIT, "A1", "small"), pressed(lot_folder, "A1"), say)
        assert run.message[0].code == "load.wanted" and not run.verdict
        assert registry.units(serial="A1")[0].revision is None, "judged before its loads were read"
        first = keeper.keep(*reading("A1", 1, 0.0, rest), say)
        assert first.message[0].code == "load.read" and not first.verdict
        done = keeper.keep(*reading("A1", 2, 2.0, pressed_level), say)
        assert done.verdict
        (stored,) = registry.history("A1")
        (kept,) = known_loads(registry, "small").values()
        np.testing.assert_allclose(kept.loads.output, [rest, pressed_level], atol=1e-5)
        # The owner of anchors makes the same of them: one input, one calibration.
        model = source_model(registry, stored.record.network_id, Method())
        unit = registry.recording(stored.record.recording_sha256)
        limit = stated_limit("N", registry.lot("small").limit_rmse)
        alone = UnitProblem(model, unlabelled(unit), limit, reference=lot_reference(registry, "small"))
        assert stored.record.input_sha256 == replace(alone, anchors=kept.loads).input_sha256 != alone.input_sha256
        laid_out = tmp_path / "laid-out"
        write_lot_folder(registry, "small", laid_out)
    columns = [(name, pd.read_csv(laid_out / "units" / "A1.csv")[name].to_numpy()) for name in ("t_s", "output")]
    assert columns and (laid_out / "anchors.csv").is_file()
    # Laid out with its loads, or beside them without: the registry knows them, and the revision stays the only one.
    batched(laid_out, registry_url, tmp_path / "with.json")
    (laid_out / "anchors.csv").unlink()
    batched(laid_out, registry_url, tmp_path / "without.json")
    with open_registry(registry_url) as registry:
        assert [one.revision for one in registry.history("A1")] == [stored.revision]


@pytest.mark.parametrize(
    ("levels_read", "codes"),
    [
        ((0.0, 0.0), ["load.read", "load.unloaded"]),
        ((0.0, 1.0), ["load.read", ""]),
        ((0.0, -0.3), ["load.read", "load.contradict"]),
    ],
    ids=["the second weight was not put on", "good", "against the direction of the source"],
)
def test_loads_that_cannot_be_calibrate_nothing(
    levels_read: tuple[float, float], codes: list[str], lot_folder: Path, registry_url: str
) -> None:
    rest, full = levels(lot_folder, "A1")
    say = lambda progress: None  # noqa: E731
    with open_registry(registry_url) as registry:
        registry.set_line_rules("small", LOADS, reason="two weights")
        keeper = RunKeeper(registry, "s1", NetworkConfig(hidden=(16, 8)))
        keeper.keep(Order("o", "s1", OrderKind.UNIT, "A1", "small"), pressed(lot_folder, "A1"), say)
        for step, (load, share, code) in enumerate(zip((0.0, 2.0), levels_read, codes, strict=True), 1):
            said = keeper.keep(*reading("A1", step, load, rest + share * (full - rest)), say)
            assert (said.message[0].code == code and not said.verdict) if code else said.verdict
        is_good = not codes[-1]
        assert (registry.units(serial="A1")[0].revision is not None) == is_good
        assert bool(known_loads(registry, "small")) == is_good


@pytest.mark.parametrize(
    "order",
    [
        Order("x", "s1", OrderKind.LOAD, "A1", "small", reason="2: 2.0"),
        Order("x", "s1", OrderKind.LOAD, "A2", "small", reason="1: 0.0"),
        Order("x", "s1", OrderKind.LOAD, "A1", "other", reason="1: 0.0"),
        Order("x", "s1", OrderKind.LOAD, "A1", "small", reason="1: 2.0"),
        Order("x", "s1", OrderKind.LOAD, "A1", "small", reason="the second"),
    ],
    ids=["not due yet", "another unit", "another lot", "another load", "names none"],
)
def test_a_reading_that_is_not_due_is_refused_before_it_begins(
    order: Order, lot_folder: Path, registry_url: str
) -> None:
    with open_registry(registry_url) as registry:
        registry.set_line_rules("small", LOADS, reason="two weights")
        keeper = RunKeeper(registry, "s1", NetworkConfig(hidden=(16, 8)))
        say = lambda progress: None  # noqa: E731
        keeper.keep(Order("o", "s1", OrderKind.UNIT, "A1", "small"), pressed(lot_folder, "A1"), say)
        with pytest.raises(InputError):
            keeper.check(order)
        keeper.check(Order("x", "s1", OrderKind.LOAD, "A1", "small", reason="1: 0.0"))


@pytest.mark.parametrize(
    ("loads", "said"),
    [
        (((0.0, 0.0), (4000.0, 0.0)), "another unit"),
        (((0.0, 0.0), (2.0, 1.0)), "better weight"),
    ],
    ids=["in the wrong unit", "not known well enough"],
)
def test_loads_that_no_calibration_can_use_stop_the_unit_before_anything_moves(
    loads: tuple[tuple[float, float], ...], said: str, lot_folder: Path, registry_url: str
) -> None:
    with open_registry(registry_url) as registry:
        registry.set_line_rules("small", LineRules(loads=loads), reason="weights")  # type: ignore[arg-type]
        keeper = RunKeeper(registry, "s1", NetworkConfig(hidden=(16, 8)))
        with pytest.raises(InputError, match=said):
            keeper.check(Order("o", "s1", OrderKind.UNIT, "A1", "small"))
