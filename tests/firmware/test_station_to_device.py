"""One walk through the whole chain: pressed at a station, calibrated, drawn, audited, released, run on a device."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.windows import TAPS
from softcal.db.connection import open_registry
from tests.firmware.conftest import Run

SAMPLES = 400
PRESSES = (("source/A0", "source", 11, 40), ("units/A1", "unit", 12, 12))


@pytest.mark.long
def test_a_device_estimates_as_the_registry_does_of_a_unit_that_a_station_pressed(
    run_on_board: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shared = ("--registry", f"sqlite:///{tmp_path / 'registry.db'}")

    def softcal(*arguments: object) -> None:
        assert main([str(word) for word in arguments]) in (0, 1), arguments

    def press(file: str, kind: str, seed: int, seconds: float) -> None:
        serial = file.split("/")[-1]
        rig = ("--simulated", seed, "--spool", "spool", "--seconds", seconds)
        softcal("station", kind, *rig, "--serial", serial, "--out", f"{file}.csv")

    for file, kind, seed, seconds in PRESSES:
        press(f"lot/{file}", kind, seed, seconds)
    toml = tmp_path / "lot" / "lot.toml"
    toml.write_text(toml.read_text() + "\n[limit]\nrmse = 2.0\n")
    softcal("batch", "lot", *shared, "--hidden", "16", "--json", "first.json")
    softcal("lot", "audit-plan", "lot", *shared, "--random", 1)
    # The unit again, beside the load cell, after it was drawn.
    press("measured/source/A1", "source", 12, 20)
    softcal("lot", "audit", "lot", "measured/source/A1.csv")
    softcal("batch", "lot", *shared, "--hidden", "16", "--out", "out", "--json", "report.json")
    (unit,) = json.loads(Path("report.json").read_text())["units"]
    assert (unit["verdict"], unit["audited"], unit["released"]) == ("pass", True, True)

    softcal("export", *shared, "--serial", "A1", "--format", "blob", "--out", "device")
    exported = json.loads(Path("device/manifest.json").read_text())["units"]["A1"]
    files = {path.name.split("-")[0]: path.read_bytes() for path in Path("device").glob("*.ssc")}
    network, device = read_network(files["network"]), read_unit(files["unit"])
    table = pd.read_csv("measured/source/A1.csv")[["t_s", "output"]][:SAMPLES]
    table.to_csv("used.csv", index=False)
    softcal("estimate", *shared, "--serial", "A1", "used.csv", "--out", "estimates.csv")
    expected = pd.read_csv("estimates.csv")["estimate"].to_numpy()

    board = run_on_board(network, device, device.scale.codes(table["output"].to_numpy()))
    value = board.estimates[:, 0] * 10.0**network.network.output_exponent
    rows = np.arange(TAPS - 1, SAMPLES)
    assert board.numbers["status"] == 0 and np.isfinite(expected[rows]).all()
    # What the device's integers cost on the unit's own recording stands in the manifest; another press is not far.
    error = np.abs(value - expected)[rows]
    assert float(np.sqrt(np.mean(error**2))) <= exported["device"]["limit"]
    assert error.max() <= 2 * max(exported["device"]["max_error"], exported["device"]["goal"])
    with open_registry(shared[1]) as registry:
        assert registry.verify() == []
