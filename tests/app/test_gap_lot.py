"""`softcal gap lot` on folders with one case per unit, good and broken."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.core import profiles
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(3.3, 12, 10.0, 50.0)
METADATA = {"vref_V": 3.3, "adc_bits": 12, "r_series_ohm": 10.0, "sample_rate_Hz": 50.0}


def write_run(folder, profile, tau_s, seed, **metadata):
    t_s, stage_mm = profile.sample(50.0)
    twin = Twin(BaseParameters(kappa_per_N=0.06), (EffectSetting("readout_lag", {"tau": tau_s}),), READOUT)
    force_N, output_V = simulate(twin, t_s, stage_mm, np.random.default_rng(seed))
    folder.mkdir(parents=True)
    table = pd.DataFrame({"t_s": t_s, "stage_mm": stage_mm, "force_N": force_N, "output_V": output_V})
    table.to_csv(folder / "recording.csv", index=False)
    (folder / "recording.json").write_text(json.dumps(METADATA | metadata))


@pytest.fixture
def lot(tmp_path):
    for k, tau_s in enumerate((0.08, 0.12), start=1):
        unit = tmp_path / f"lot/u{k}"
        write_run(
            unit / "runs/1", profiles.random_presses(np.random.default_rng(k), 30.0, 3.0), tau_s, k, serial=f"U{k}"
        )
        write_run(unit / "runs/2", profiles.ramps([3.0] * 5, 4.0), tau_s, 10 + k, serial=f"U{k}")
    audit = profiles.random_presses(np.random.default_rng(9), 30.0, 3.0)
    write_run(tmp_path / "lot/u1/audit", audit, 0.08, 20, serial="U1")
    return tmp_path / "lot"


@pytest.mark.long
def test_the_lot_shares_a_lag_and_its_twin_beats_the_one_without(lot, tmp_path, capsys):
    report = tmp_path / "lot.json"
    assert main(["gap", "lot", str(lot), "--json", str(report)]) == 0
    assert "readout_lag" in capsys.readouterr().out
    content = json.loads(report.read_text())
    assert content["schema"] == "softcal.gap_lot/1" and content["causes"][0]["effect"] == "readout_lag"
    sizes = [unit["sizes"]["readout_lag"]["tau"] for unit in content["units"]]
    for size, tau_s in zip(sizes, (0.08, 0.12), strict=True):
        assert size["low"] <= size["value"] <= size["high"] and abs(size["value"] - tau_s) < 0.01
    (worth,) = content["calibration"]
    assert worth["unit"] == "u1" and worth["explained"] < worth["nominal"] and len(worth["rig"]) == 2


def error_line(folder, capsys):
    assert main(["gap", "lot", str(folder)]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    return error[0]


def test_a_folder_without_cases_is_reported(tmp_path, capsys):
    assert str(tmp_path) in error_line(tmp_path, capsys)
    assert str(tmp_path / "none") in error_line(tmp_path / "none", capsys)


def test_one_case_twice_is_reported(lot, capsys):
    shutil.copytree(lot / "u1", lot / "u3")
    error = error_line(lot, capsys)
    assert all(name in error for name in ("u1", "u3", "U1"))


def test_cases_of_different_protocols_are_reported(lot, capsys):
    write_run(lot / "u2/runs/3", profiles.ramps([3.0] * 2, 0.8), 0.1, 5, serial="U2")
    assert error_line(lot, capsys)
