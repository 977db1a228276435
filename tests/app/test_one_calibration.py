"""One recording, one calibration: pressed on the line, batched, and batched elsewhere after the registries met."""

import json
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd

from softcal.app.cli.main import main
from softcal.app.files.recording_file import write_columns
from softcal.app.line.pressed_run import RunKeeper
from softcal.core.network.training import NetworkConfig
from softcal.core.orders import Order, OrderKind
from softcal.db.connection import open_registry
from softcal.db.sync import synchronise
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
