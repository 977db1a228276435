"""`softcal gap diagnose` and `softcal gap apply` on case folders, good and broken."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.files.case_folder import open_case
from softcal.app.gap.diagnose import read_twin, run_views, write_twin
from softcal.core import profiles
from softcal.core.errors import InputError
from softcal.core.gap.diagnosis import diagnose
from softcal.core.simulated_lot import draw_twins
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

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


def test_a_mistake_is_said_before_anything_else_and_gives_no_twin(case, tmp_path, capsys):
    described = case / "runs/2/recording.json"
    described.write_text(json.dumps(METADATA | {"sample_rate_Hz": 25.0}))
    report, page = tmp_path / "g.json", tmp_path / "g.html"
    assert main(["gap", "diagnose", str(case), "--json", str(report), "--page", str(page)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("data        rate of time, runs 2: the time stamps show 50 Hz, sample_rate_Hz says 25 Hz")
    content = json.loads(report.read_text())
    assert content["verdict"] == "data" and content["twin"] is None
    assert [(d["what"], d["runs"]) for d in content["data"]] == [("rate", [2])]
    assert "The recordings hold a mistake" in page.read_text()
    for source in ([str(case)], ["--report", str(report)]):
        assert main(["gap", "apply", *source, "--out", str(tmp_path / "twin.json")]) == 2
        assert "the recordings hold a mistake" in capsys.readouterr().err
        assert not (tmp_path / "twin.json").exists()


def test_json_on_standard_output_is_nothing_but_json(case, capsys):
    assert main(["gap", "diagnose", str(case / "runs/2"), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] in ("explained", "ambiguous")


def test_apply_writes_a_twin_that_can_be_loaded(case, tmp_path):
    out = tmp_path / "twin.json"
    assert main(["gap", "apply", str(case), "--out", str(out)]) == 0
    twin = read_twin(out)
    assert [s.effect_id for s in twin.effects] == ["readout_lag"]
    assert twin.effects[0].values["tau"] == pytest.approx(0.1, rel=0.05)
    assert twin.parameters.kappa_per_N == pytest.approx(0.06, rel=0.01)


def test_a_twin_survives_its_file(tmp_path):
    settings = (LAG, EffectSetting("intermittent_contact", {"dR": 0.2}, ((1.0, 2.0),)))
    write_twin(tmp_path / "t.json", Twin(BaseParameters(), settings, READOUT))
    assert read_twin(tmp_path / "t.json") == Twin(BaseParameters(), settings, READOUT)


def test_what_is_no_twin_is_refused(tmp_path):
    (tmp_path / "t.json").write_text('{"schema": "softcal.twin/1"}')
    with pytest.raises(InputError, match="does not describe a twin"):
        read_twin(tmp_path / "t.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_twin(tmp_path / "none.json")


def test_a_run_without_time_or_stage_is_read_at_the_declared_rate(tmp_path):
    write_run(tmp_path / "one", profiles.random_presses(np.random.default_rng(1), 20, 3), drop=("t_s", "stage_mm"))
    case = open_case(tmp_path / "one")
    assert case.missing_channels == ("stage_mm", "temperature_C")
    np.testing.assert_allclose(np.diff(case.runs[0].t_s), 0.02)
    diagnosis = diagnose(case)
    assert [m.name for m in diagnosis.maps] == ["force→output"]
    assert run_views(diagnosis)[0].channels["output_V"].measured.shape == case.runs[0].t_s.shape


def _break(case, what):
    runs = case / "runs"
    metadata = json.loads((runs / "2/recording.json").read_text())
    recording = runs / "2/recording.csv"
    if what == "no metadata":
        (runs / "2/recording.json").unlink()
    elif what == "no recording":
        recording.unlink()
    elif what == "empty recording":
        recording.write_text("")
    elif what == "text in a number":
        lines = recording.read_text().splitlines()
        lines[40] = lines[40].replace(lines[40].split(",")[1], "abc")
        recording.write_text("\n".join(lines))
    elif what == "other columns":
        recording.write_text("a,b\n" + "1,2\n" * 50)
    elif what == "no runs":
        shutil.rmtree(runs)
    else:
        change = {
            "no vref": {"vref_V": None},
            "vref in words": {"vref_V": "3.3 V"},
            "half a bit": {"adc_bits": 11.5},
            "another reference": {"vref_V": 5.0},
            "another unit": {"serial": "G2"},
            "unknown kind": {"kind": "smash"},
        }[what]
        (runs / "2/recording.json").write_text(json.dumps(metadata | change))


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("no metadata", "recording.json: missing"),
        ("no recording", "there is no recording.csv"),
        ("empty recording", "the file is empty"),
        ("text in a number", "line 41, column 'stage_mm'"),
        ("other columns", "none of t_s"),
        ("no runs", "this is no case"),
        ("no vref", "vref_V missing"),
        ("vref in words", "vref_V is '3.3 V'"),
        ("half a bit", "adc_bits is 11.5"),
        ("another reference", "vref_V is 5.0, but 3.3"),
        ("another unit", "runs of several units"),
        ("unknown kind", "kind 'smash' is not known"),
    ],
)
def test_a_broken_case_ends_with_one_clear_line(case, what, message, capsys, tmp_path):
    _break(case, what)
    assert main(["gap", "diagnose", str(case), "--json", str(tmp_path / "g.json")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and message in said[0]
    assert not (tmp_path / "g.json").exists()


def test_a_report_is_applied_without_diagnosing_again(case, tmp_path):
    report, out = tmp_path / "g.json", tmp_path / "t.json"
    assert main(["gap", "diagnose", str(case), "--json", str(report)]) == 0
    assert main(["gap", "apply", "--report", str(report), "--out", str(out)]) == 0
    assert [s.effect_id for s in read_twin(out).effects] == ["readout_lag"]
    assert read_twin(report) == read_twin(out)
    assert read_twin(report, "base_twin").effects == ()


@pytest.mark.parametrize("given", [[], ["--report", "REPORT", "CASE"]])
def test_apply_takes_either_a_case_or_a_report(case, tmp_path, given, capsys):
    given = [{"REPORT": str(tmp_path / "g.json"), "CASE": str(case)}.get(word, word) for word in given]
    assert main(["gap", "apply", *given, "--out", str(tmp_path / "t.json")]) == 2
    assert "either a case" in capsys.readouterr().err


def test_the_simulated_station_presses_the_twin_of_a_diagnosis(tmp_path):
    twin = Twin(BaseParameters(r0_ohm=6.0), (LAG,), READOUT)
    write_twin(tmp_path / "t.json", twin)
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
    assert "motion, mechanics: these recordings cannot show them" in capsys.readouterr().out


@pytest.mark.parametrize("options", [[], ["--vref-V", "3.3"]])
def test_a_plain_table_without_its_electronics_is_refused(case, options, capsys):
    assert main(["gap", "diagnose", str(case / "runs/2/recording.csv"), *options]) == 2
    error = capsys.readouterr().err.replace("-", "_")
    assert all(name in error for name in ("vref_V", "adc_bits", "rate_Hz"))
