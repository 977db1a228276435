"""A simulator of one's own on the command line: check, page, and parameters that it reads back."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from softcal.app.cli.main import main
from softcal.app.gap.simulator import load_simulator, read_parameters, with_written_terms
from softcal.core.errors import InputError

MODULE = """
import numpy as np
from softcal.core.gap.simulator import Simulator, candidate
from softcal.core.twin.effects import Parameter


def simulate(inputs, p):
    load = inputs["load_N"]
    return {"place_mm": p["zero"] + p["softness"] * load + p["stiffens.a"] * load**3 + p["worn.a"] * inputs["t_s"]}


SIMULATOR = Simulator(
    "a foot",
    simulate,
    ("load_N",),
    ("place_mm",),
    (Parameter("zero", "mm", -9.0, 9.0, 1.0), Parameter("softness", "mm/N", 0.0, 9.0, 1.0)),
    (
        candidate("stiffens", "foot", Parameter("a", "mm/N³", -1.0, 1.0, 0.01, neutral=0.0)),
        candidate("worn", "foot", Parameter("a", "mm/s", -1.0, 1.0, 0.01, neutral=0.0)),
    ),
    per_run={"place_mm": {"zero": 0.5}},
)
"""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> str:
    """Two runs that stiffen, long enough to be thinned; returns how the simulator is named."""
    monkeypatch.chdir(tmp_path)
    name = re.sub(r"\W", "_", f"foot_{request.node.name}")
    Path(f"{name}.py").write_text(MODULE)
    rng, t_s = np.random.default_rng(1), np.arange(0.0, 60.0, 0.01)
    for run in (1, 2):
        load_N = run * np.abs(np.sin(0.3 * run * t_s))
        place_mm = 0.7 + 0.1 * run + 1.3 * load_N - 0.05 * load_N**3 + rng.normal(0.0, 0.01, len(t_s))
        folder = Path("rig/runs") / str(run)
        folder.mkdir(parents=True)
        table = np.column_stack([t_s, load_N, place_mm])
        np.savetxt(folder / "recording.csv", table, delimiter=",", header="t_s,load_N,place_mm", comments="")
    return f"{name}:SIMULATOR"


def test_the_page_shows_measured_simulator_and_explained_simulator(rig: str) -> None:
    assert main(["gap", "diagnose", "rig", "--simulator", rig, "--page", "p.html", "--json", "r.json"]) == 0
    page, report = Path("p.html").read_text(), json.loads(Path("r.json").read_text())
    assert Path("p.html").stat().st_size < 1_000_000
    assert not re.search(r"<script[^>]*>[^<]|src=|https?:", page.replace("http://www.w3.org", ""))
    # Of the worst run, then of both: three lines on one another, and what is left before and after.
    assert page.count("<polyline") == (1 + 2) * (3 + 2)
    gap = report["gap"]["place_mm"]
    assert all(f"{gap[key]:.3g} mm (" in page for key in ("rmse_before", "rmse_after", "noise_floor"))
    visible_text = re.sub(r"<(style|script).*?</\1>|<[^>]*>", " ", page, flags=re.DOTALL)
    assert "twin" not in visible_text and "stiffens" in visible_text and "zero" in visible_text


def test_apply_writes_parameters_that_the_simulator_reads_back(rig: str) -> None:
    assert main(["gap", "diagnose", "rig", "--simulator", rig, "--json", "r.json"]) == 0
    assert main(["gap", "apply", "--report", "r.json", "--out", "a.json"]) == 0
    assert main(["gap", "apply", "rig", "--simulator", rig, "--out", "b.json"]) == 0
    simulator = load_simulator(rig)
    parameters = read_parameters("a.json", simulator)
    assert parameters == read_parameters("b.json", simulator)
    assert parameters["stiffens.a"] == pytest.approx(-0.05, abs=2e-3) and parameters["worn.a"] == 0.0
    measured = np.loadtxt("rig/runs/2/recording.csv", delimiter=",", skiprows=1)
    predicted = simulator({"t_s": measured[:, 0], "load_N": measured[:, 1]}, parameters)["place_mm"]
    # What a run may have of its own is no parameter.
    assert np.std(measured[:, 2] - predicted) == pytest.approx(0.01, rel=0.1)


def test_empirical_terms_are_written_beside_parameters_and_read_back(rig: str) -> None:
    module = Path(rig.replace(":SIMULATOR", ".py"))
    # Without its cause the simulator is left with what a term can describe.
    cause = re.search(r"^ *candidate\(\"stiffens\".*\n", MODULE, re.MULTILINE)
    assert cause is not None
    module.write_text(MODULE.replace(' + p["stiffens.a"] * load**3', "").replace(cause[0], ""))
    assert main(["gap", "diagnose", "rig", "--simulator", rig, "--json", "r.json", "--page", "p.html"]) == 0
    report = json.loads(Path("r.json").read_text())
    assert report["verdict"] == "unknown" and report["residual"]["shrink"]["held_out"] > 0.9
    assert all(one["variable"] in Path("p.html").read_text() for one in report["residual"]["terms"])
    assert main(["gap", "apply", "--report", "r.json", "--out", "bare.json"]) == 0
    assert main(["gap", "apply", "--report", "r.json", "--empirical", "--out", "terms.json"]) == 0
    measured = np.loadtxt("rig/runs/2/recording.csv", delimiter=",", skiprows=1)
    residuals = {}
    for name in ("bare", "terms"):
        simulator = with_written_terms(f"{name}.json", load_simulator(rig))
        inputs = {"t_s": measured[:, 0], "load_N": measured[:, 1]}
        residuals[name] = np.std(
            measured[:, 2] - simulator(inputs, read_parameters(f"{name}.json", simulator))["place_mm"]
        )
    assert residuals["terms"] == pytest.approx(0.01, rel=0.1) and residuals["bare"] > 3 * residuals["terms"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"verdict": "data", "simulator": "a foot"}, "mistake"),
        ({"verdict": "explained", "simulator": "a foot"}, "holds no parameters"),
        ({"verdict": "explained", "simulator": "a foot", "parameters": {"zero": "high"}}, "holds no parameters"),
    ],
)
def test_a_report_without_parameters_is_refused(content, message: str, tmp_path: Path, capsys) -> None:
    (tmp_path / "r.json").write_text(json.dumps(content))
    assert main(["gap", "apply", "--report", str(tmp_path / "r.json"), "--out", str(tmp_path / "o.json")]) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "o.json").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "holds no parameters"),
        ({"schema": "softcal.simulator/1", "simulator": "an arm", "parameters": {}}, "an arm"),
        ({"schema": "softcal.simulator/1", "simulator": "a foot", "parameters": {"zero": 1.0}}, "softness"),
    ],
)
def test_parameters_of_another_simulator_are_refused(rig: str, content, message: str) -> None:
    Path("p.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        read_parameters("p.json", load_simulator(rig))


def test_check_says_what_the_runs_identify_and_searches_nothing(rig: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gap", "check", "rig", "--simulator", rig, "--json", "c.json"]) == 0
    printed = capsys.readouterr()
    assert "told        2 of 2 base parameters" in printed.out and "jointly" not in printed.err
    content = json.loads(Path("c.json").read_text())
    assert content["data"] == [] and content["identifiability"]["causes"]["stiffens"]["is_told"]


def test_a_mistake_stops_the_command_with_its_repair(rig: str, capsys: pytest.CaptureFixture[str]) -> None:
    table = Path("rig/runs/2/recording.csv")
    values = np.loadtxt(table, delimiter=",", skiprows=1)
    values[:, 2] = 3.0
    np.savetxt(table, values, delimiter=",", header="t_s,load_N,place_mm", comments="")
    assert main(["gap", "diagnose", "rig", "--simulator", rig, "--page", "p.html"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("data        constant of place_mm, runs 2") and "verdict     data" in out
    assert "place_mm" in Path("p.html").read_text()
