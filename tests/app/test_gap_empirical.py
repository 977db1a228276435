"""What no cause explains, from the command line to the twin's file and the page."""

import json
from functools import partial

import numpy as np
import pandas as pd
import pytest

from softcal.app.charts.gap_page import gap_page
from softcal.app.cli.main import main
from softcal.app.gap.diagnose import read_twin
from softcal.app.texts.catalogue import text
from softcal.app.views.gap import residual_rows
from softcal.core import profiles
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import Twin, simulate

READOUT = ReadoutMetadata(3.3, 14, 10.0, 50.0)
METADATA = {"vref_V": 3.3, "adc_bits": 14, "r_series_ohm": 10.0, "sample_rate_Hz": 50.0, "serial": "G1"}
DRAG_N_per_mm = 0.06
ENGLISH = partial(text, "en")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A cable that pulls at the load cell in proportion to the travel: no effect of the catalogue."""
    folder = tmp_path_factory.mktemp("drag")
    press_profiles = (profiles.ramps([3.0] * 2, 0.6), profiles.ramps([3.0] * 5, 4.0), profiles.rate_sweep(2.8))
    for k, profile in enumerate(press_profiles, 1):
        t_s, stage_mm = profile.sample(50.0)
        twin = Twin(BaseParameters(kappa_per_N=0.06), (), READOUT)
        force_N, output_V = simulate(twin, t_s, stage_mm, np.random.default_rng(k))
        columns = {"t_s": t_s, "stage_mm": stage_mm, "force_N": force_N + DRAG_N_per_mm * stage_mm}
        (folder / f"runs/{k}").mkdir(parents=True)
        pd.DataFrame(columns | {"output_V": output_V}).to_csv(folder / f"runs/{k}/recording.csv", index=False)
        (folder / f"runs/{k}/recording.json").write_text(json.dumps(METADATA))
    return folder


@pytest.fixture(scope="module")
def report(case, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "g.json"
    assert main(["gap", "diagnose", str(case), "--json", str(out), "--page", str(out.with_suffix(".html"))]) == 0
    return out


def test_the_report_describes_what_is_left_and_calls_it_empirical(report):
    content = json.loads(report.read_text())
    assert content["verdict"] == "unknown"
    residual = content["residual"]
    assert residual["kind"] == "empirical" and residual["shrink"]["low"] > 0.0
    (term, *_) = residual["terms"]
    assert (term["place"], term["variable"], term["unit"]) == ("force_N", "position", "N")
    assert term["coefficient"] == pytest.approx(DRAG_N_per_mm * residual["depth_mm"], abs=4 * term["standard_error"])
    page = report.with_suffix(".html").read_text()
    assert ENGLISH("gap.left") in page and "force_N += " in page


def test_the_twin_holds_the_terms_only_where_they_are_asked_for(report, tmp_path, capsys):
    plain, described = tmp_path / "plain.json", tmp_path / "described.json"
    assert main(["gap", "apply", "--report", str(report), "--out", str(plain)]) == 0
    assert main(["gap", "apply", "--report", str(report), "--empirical", "--out", str(described)]) == 0
    assert "force_N += " in capsys.readouterr().err
    assert read_twin(plain).empirical == () and read_twin(described).empirical
    stage_mm = np.linspace(0.0, 2.5, 200)
    t_s = np.arange(200) / 50.0
    truth = simulate(Twin(BaseParameters(kappa_per_N=0.06), (), READOUT), t_s, stage_mm)[0] + DRAG_N_per_mm * stage_mm
    errors = [np.sqrt(np.mean((simulate(read_twin(f), t_s, stage_mm)[0] - truth) ** 2)) for f in (plain, described)]
    assert errors[1] < 0.2 * errors[0]


def test_a_report_without_terms_gives_no_described_twin(report, tmp_path):
    content = json.loads(report.read_text()) | {"residual": None}
    bare = tmp_path / "bare.json"
    bare.write_text(json.dumps(content))
    assert main(["gap", "apply", "--report", str(bare), "--empirical", "--out", str(tmp_path / "t.json")]) == 2
    assert not (tmp_path / "t.json").exists()


def test_a_report_without_terms_has_no_section(report):
    content = json.loads(report.read_text()) | {"residual": None}
    assert ENGLISH("gap.left") not in gap_page(content, [], "G1", ENGLISH)
    assert residual_rows(content, ENGLISH) == [] and residual_rows({}, ENGLISH) == []
    assert residual_rows(json.loads(report.read_text()), ENGLISH)[0]["term"].startswith("force_N += ")
