"""`softcal gap diagnose` and `softcal gap apply` on case folders, good and broken."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.files.case_folder import open_case
from softcal.app.gap.diagnose import read_twin, run_views, write_twin
from softcal.app.texts.catalogue import text
from softcal.core import profiles
from softcal.core.errors import InputError
from softcal.core.gap.twin import diagnose
from softcal.core.simulated_lot import draw_twins
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate
from softcal.db.provenance import record_provenance

READOUT = ReadoutMetadata(3.3, 12, 10.0, 50.0)
METADATA = {"vref_V": 3.3, "adc_bits": 12, "r_series_ohm": 10.0, "sample_rate_Hz": 50.0, "serial": "G1"}


def write_run(folder, profile, effects=(), seed=1, drop=(), **metadata):
    t_s, stage_mm = profile.sample(50.0)
    twin = Twin(BaseParameters(kappa_per_N=0.06), effects, READOUT)
    force_N, output_V = simulate(twin, t_s, stage_mm, np.random.default_rng(seed))
    table = pd.DataFrame({"t_s": t_s, "stage_mm": stage_mm, "force_N": force_N, "output_V": output_V})
    folder.mkdir(parents=True)
    table.drop(columns=list(drop)).to_csv(folder / "recording.csv", index=False)
    (folder / "recording.json").write_text(json.dumps(METADATA | metadata))


@pytest.fixture
def case(tmp_path):
    write_run(tmp_path / "case/runs/1", profiles.ramps([3.0] * 2, 0.8), (LAG,), 1)
    write_run(tmp_path / "case/runs/2", profiles.ramps([3.0] * 5, 4.0), (LAG,), 2)
    return tmp_path / "case"


LAG = EffectSetting("readout_lag", {"tau": 0.1})


def test_diagnose_writes_the_report_and_the_page(case, tmp_path, capsys):
    report, page = tmp_path / "g.json", tmp_path / "g.html"
    assert main(["gap", "diagnose", str(case), "--json", str(report), "--page", str(page)]) == 0
    content = json.loads(report.read_text())
    assert content["schema"] == "softcal.gap/1" and content["causes"][0]["effect"] == "readout_lag"
    assert "readout_lag" in capsys.readouterr().out
    assert "<html" in page.read_text()


def test_check_says_what_the_runs_identify_and_diagnoses_nothing(case, tmp_path, capsys):
    out = tmp_path / "c.json"
    assert main(["gap", "check", str(case), "--json", str(out)]) == 0
    printed = capsys.readouterr()
    assert "told        5 of 5 base parameters" in printed.out and "jointly" not in printed.err
    causes = json.loads(out.read_text())["identifiability"]["causes"]
    assert causes["readout_lag"]["is_told"] and causes["frame_compliance"]["hidden"] > 0.99
    # A ceiling that the output never reaches changes no sample; a resistor in place of the sensor would reach it.
    assert not causes["adc_saturation"]["is_told"] and causes["adc_saturation"]["by"] == ["dummy_resistor"]


def test_check_names_a_mistake_and_nothing_else(case, capsys):
    (case / "runs/2/recording.json").write_text(json.dumps(METADATA | {"sample_rate_Hz": 25.0}))
    assert main(["gap", "check", str(case)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("data") and "told" not in out


def test_a_mistake_is_reported_before_anything_else_and_gives_no_twin(case, tmp_path, capsys):
    described = case / "runs/2/recording.json"
    described.write_text(json.dumps(METADATA | {"sample_rate_Hz": 25.0}))
    report, page = tmp_path / "g.json", tmp_path / "g.html"
    assert main(["gap", "diagnose", str(case), "--json", str(report), "--page", str(page)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("data") and all(rate_text in out.splitlines()[0] for rate_text in ("50 Hz", "25 Hz"))
    content = json.loads(report.read_text())
    assert content["verdict"] == "data" and content["twin"] is None
    assert [(d["what"], d["runs"]) for d in content["data"]] == [("rate", [2])]
    assert text("en", "gap.data") in page.read_text()
    for source in ([str(case)], ["--report", str(report)]):
        assert main(["gap", "apply", *source, "--out", str(tmp_path / "twin.json")]) == 2
        assert not (tmp_path / "twin.json").exists()


def test_apply_writes_a_twin_that_can_be_loaded(case, tmp_path):
    out = tmp_path / "twin.json"
    assert main(["gap", "apply", str(case), "--out", str(out)]) == 0
    twin = read_twin(out)
    assert [s.effect_id for s in twin.effects] == ["readout_lag"]
    assert twin.effects[0].values["tau"] == pytest.approx(0.1, rel=0.05)
    assert twin.parameters.kappa_per_N == pytest.approx(0.06, rel=0.01)


def test_a_twin_survives_its_file(tmp_path):
    settings = (LAG, EffectSetting("intermittent_contact", {"dR": 0.2}, ((1.0, 2.0),)))
    write_twin(tmp_path / "t.json", Twin(BaseParameters(), settings, READOUT), record_provenance("m", {}, "kim"))
    assert read_twin(tmp_path / "t.json") == Twin(BaseParameters(), settings, READOUT)


def test_what_is_no_twin_is_refused(tmp_path):
    (tmp_path / "t.json").write_text('{"schema": "softcal.twin/1"}')
    for name in ("t.json", "none.json"):
        with pytest.raises(InputError, match=name):
            read_twin(tmp_path / name)


def test_a_run_without_time_or_stage_is_read_at_the_declared_rate(tmp_path):
    write_run(tmp_path / "one", profiles.random_presses(np.random.default_rng(1), 20, 3), drop=("t_s", "stage_mm"))
    case = open_case(tmp_path / "one")
    assert case.missing_channels == ("stage_mm", "temperature_C")
    np.testing.assert_allclose(np.diff(case.runs[0].t_s), 0.02)
    diagnosis = diagnose(case)
    assert [m.name for m in diagnosis.where.maps] == ["force→output"]
    assert run_views(diagnosis)[0].channels["output_V"].measured.shape == case.runs[0].t_s.shape


def described(**change):
    """A run whose description says something else."""

    def describe(run):
        path = run / "recording.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | change))

    return describe


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda run: (run / "recording.json").unlink(), "recording.json"),
        (lambda run: (run / "recording.csv").unlink(), "recording.csv"),
        (lambda run: (run / "recording.csv").write_text(""), "recording.csv"),
        (lambda run: (run / "recording.csv").write_text("a,b\n" + "1,2\n" * 50), "t_s"),
        (lambda run: shutil.rmtree(run.parent), "case"),
        (described(vref_V=None), "vref_V"),
        (described(vref_V="3.3 V"), "'3.3 V'"),
        (described(adc_bits=11.5), "11.5"),
        (described(vref_V=5.0), "5.0"),
        (described(serial="G2"), "G2"),
        (described(kind="smash"), "'smash'"),
    ],
)
def test_a_broken_case_ends_with_one_clear_line(case, damage, message, capsys, tmp_path):
    damage(case / "runs/2")
    assert main(["gap", "diagnose", str(case), "--json", str(tmp_path / "g.json")]) == 2
    stderr = capsys.readouterr().err.strip().splitlines()
    assert len(stderr) == 1 and message in stderr[0]
    assert not (tmp_path / "g.json").exists()


def test_a_report_is_applied_without_diagnosing_again(case, tmp_path):
    report, out = tmp_path / "g.json", tmp_path / "t.json"
    assert main(["gap", "diagnose", str(case), "--json", str(report)]) == 0
    assert main(["gap", "apply", "--report", str(report), "--out", str(out)]) == 0
    assert [s.effect_id for s in read_twin(out).effects] == ["readout_lag"]
    assert read_twin(report) == read_twin(out)
    assert read_twin(report, "base_twin").effects == ()


def test_apply_takes_either_a_case_or_a_report(case, tmp_path, capsys):
    for options in ([], ["--report", str(tmp_path / "g.json"), str(case)]):
        assert main(["gap", "apply", *options, "--out", str(tmp_path / "t.json")]) == 2
        assert "--report" in capsys.readouterr().err


@pytest.mark.long
def test_the_simulated_station_presses_the_twin_of_a_diagnosis(tmp_path):
    twin = Twin(BaseParameters(r0_ohm=6.0), (LAG,), READOUT)
    write_twin(tmp_path / "t.json", twin, record_provenance("m", {}, "kim"))
    press = ["station", "unit", "--simulated", "--serial", "A1", "--seconds", "3", "--spool", str(tmp_path / "spool")]
    assert main([*press, "--twin", str(tmp_path / "t.json"), "--out", str(tmp_path / "A1.csv")]) == 0
    output_V = np.loadtxt(tmp_path / "A1.csv", delimiter=",", skiprows=1)[:, 1]
    assert output_V[:20] == pytest.approx(READOUT.vref_V * 6.0 / (6.0 + READOUT.r_series_ohm), abs=0.01)
    assert main([*press[:2], "--serial", "A1", "--twin", str(tmp_path / "t.json"), "--out", "x.csv"]) == 2


def test_a_lot_can_be_simulated_around_a_twin():
    twin = Twin(BaseParameters(r0_ohm=9.0), (LAG,), READOUT)
    units = draw_twins(np.random.default_rng(1), 20, twin=twin)
    assert np.mean([u.parameters.r0_ohm for u in units]) == pytest.approx(9.0, rel=0.1)
    assert {s.effect_id for u in units for s in u.effects} == {"readout_lag"} and units[0].metadata == READOUT


def test_a_plain_table_is_diagnosed_with_its_electronics_given(case, tmp_path, capsys):
    table = pd.read_csv(case / "runs/2/recording.csv")[["force_N", "output_V"]]
    table.rename(columns={"force_N": "reference", "output_V": "output"}).to_csv(tmp_path / "S1.csv", index=False)
    electronics = ["--vref-V", "3.3", "--adc-bits", "12", "--rate-Hz", "50"]
    assert main(["gap", "diagnose", str(tmp_path / "S1.csv"), *electronics, "--json", str(tmp_path / "r.json")]) == 0
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["missing_channels"] == ["stage_mm", "temperature_C"]
    assert report["unseen_stages"] == ["motion", "mechanics"]
    assert "motion, mechanics" in capsys.readouterr().out


@pytest.mark.parametrize("options", [[], ["--vref-V", "3.3"]])
def test_a_plain_table_without_its_electronics_is_refused(case, options, capsys):
    assert main(["gap", "diagnose", str(case / "runs/2/recording.csv"), *options]) == 2
    error = capsys.readouterr().err.replace("-", "_")
    assert all(name in error for name in ("vref_V", "adc_bits", "rate_Hz"))


def test_what_the_gap_costs_a_calibration_is_printed_reported_and_drawn(case, tmp_path, capsys):
    report, page = tmp_path / "g.json", tmp_path / "g.html"
    write_run(case / "runs/3", profiles.ramps([2.0, 3.0, 2.5], 3.0), (LAG,), 3)
    assert main(["gap", "diagnose", str(case), "--calibration", "--json", str(report), "--page", str(page)]) == 0
    errors = json.loads(report.read_text())["calibration"]
    assert errors["run"] == "3"
    # What a lag of 0.1 s costs is nearly all gone once the twin has it.
    assert abs(errors["repaired"] - errors["rig"]) < 0.3 * (errors["base"] - errors["rig"])
    sentence = f"base twin {errors['base']:.3g} N, repaired twin {errors['repaired']:.3g} N, rig {errors['rig']:.3g} N"
    printed = capsys.readouterr().out
    assert f"trained on: {sentence.split(', rig')[0]}" in printed.replace("\n", " ") and sentence in printed
    assert f"<b>{errors['repaired']:.3g} N</b> on the repaired twin" in page.read_text()


def test_a_calibration_needs_another_run_and_a_force(case, capsys):
    assert main(["gap", "diagnose", str(case / "runs/2"), "--calibration"]) == 2
    assert "one run is pressed" in capsys.readouterr().err
    assert main(["gap", "diagnose", str(case), "--calibration", "--simulator", "nowhere:NOTHING"]) == 2
    assert "leave --calibration out" in capsys.readouterr().err


def test_a_cause_that_is_named_is_not_said_to_show_nothing(case, tmp_path):
    """A small level cuts off where the usual one would not: what was found shows."""
    out = tmp_path / "g.json"
    cut = EffectSetting("adc_saturation", {"V_max": 1.15})
    for number, speed in (("1", 0.8), ("2", 4.0)):
        shutil.rmtree(case / "runs" / number)
        write_run(case / "runs" / number, profiles.ramps([3.0] * 3, speed), (cut,), int(number))
    assert main(["gap", "diagnose", str(case), "--json", str(out)]) == 0
    content = json.loads(out.read_text())
    causes = [cause["effect"] for cause in content["causes"] if cause["probability"] > 0.5]
    assert causes == ["adc_saturation"]
    identifiability = content["identifiability"]
    assert identifiability["causes"]["adc_saturation"]["is_told"]
    assert not any(
        "adc_saturation" in json.dumps(line) and "alike" not in json.dumps(line) for line in identifiability["untold"]
    )
