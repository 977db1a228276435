"""A simulator as a plain function and dictionaries: what is stated of it, calls in processes, and how long it takes."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.app.cli.main import main
from softcal.app.gap.simulator import foretell_duration, in_processes, load_simulator, read_runs, simulator_of
from softcal.core.errors import InputError
from softcal.core.gap.simulator_model import diagnose_simulator

MODULE = """
import os
import numpy as np

def simulate(inputs, p):
    t_s, push_N = inputs["t_s"], inputs["push_N"]
    sunk = p["soft"] * push_N * (1.0 + p["toe.size"] * push_N) + p["creep.rate"] * np.log1p(t_s - t_s[0]) * push_N
    if p["soft"] > 40.0:
        raise ValueError("too soft")
    return {"sunk_mm": p["start"] + sunk, "process": 0.0 * t_s + os.getpid()}

SIMULATOR = {
    "run": simulate,
    "inputs": ["push_N"],
    "channels": ["sunk_mm"],
    "base": {"soft": (0.0, 50.0, 1.0, "mm/N")},
    "run_parameters": {"start": (-5.0, 5.0, 0.5)},
    "candidates": {
        "toe": {"size": (-1.0, 1.0, 0.1)},
        "creep": {"place": "foot", "rate": {"low": 0.0, "high": 1.0, "usual": 0.1}},
    },
    "priors": {"soft": (2.0, 0.1)},
    "noise": {"sunk_mm": 0.02},
    "skip_s": 0.5,
    "experiments": {"hard": {"inputs": {"t_s": [0.1 * k for k in range(60)], "push_N": [k % 9 for k in range(60)]}}},
}
"""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A rig that creeps, its first half second spoilt, and `my_foot.py` beside it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_foot.py").write_text(MODULE)
    rng = np.random.default_rng(7)
    for number in (1, 2):
        t_s = 0.05 * np.arange(120)
        push_N = 2.0 + 2.0 * np.sin((0.7 + 0.5 * number) * t_s)
        sunk = number + 2.0 * push_N + 0.2 * np.log1p(t_s) * push_N + rng.normal(0.0, 0.02, len(t_s))
        sunk[t_s < 0.5] += 3.0
        folder = tmp_path / "rig" / "runs" / str(number)
        folder.mkdir(parents=True)
        table = np.column_stack([t_s, push_N, sunk])
        np.savetxt(folder / "recording.csv", table, delimiter=",", header="t_s,push_N,sunk_mm", comments="", fmt="%.6f")
    return tmp_path / "rig"


def test_a_dictionary_is_diagnosed_applied_and_read(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--simulator", "my_foot:SIMULATOR"]
    assert main(["gap", "diagnose", str(rig), *arguments, "--json", "r.json"]) == 0
    report = json.loads(Path("r.json").read_text())
    assert report["verdict"] == "explained" and report["causes"][0]["effect"] == "creep"
    assert report["where"][0]["stage"] == "foot" and report["simulator"] == "my_foot"
    assert report["parameters"]["start@2"] == pytest.approx(2.0, abs=0.02)
    assert report["gap"]["sunk_mm"]["noise_floor"] == 0.02
    assert "prior       soft = 2 ± 0.1, fitted" in capsys.readouterr().out
    assert main(["gap", "apply", "--report", "r.json", "--out", "p.json", *arguments]) == 0


def test_processes_give_the_same_report(rig: Path) -> None:
    reports = []
    for count in ("1", "2"):
        case = ["gap", "diagnose", str(rig), "--simulator", "my_foot:SIMULATOR", "--processes", count]
        assert main([*case, "--json", f"{count}.json"]) == 0
        reports.append(json.loads(Path(f"{count}.json").read_text()))
    assert reports[0]["parameters"] == reports[1]["parameters"] and reports[0]["causes"] == reports[1]["causes"]


def test_calls_are_made_in_other_processes_and_may_fail_there(rig: Path) -> None:
    declared = load_simulator("my_foot:SIMULATOR")
    runs, _ = read_runs(rig, declared)
    with in_processes("my_foot:SIMULATOR", declared, 2) as simulator:
        assert simulator.run_many is not None
        calls = [
            (runs[0].driving(("push_N",)), {"soft": s, "start": 0, "toe.size": 0, "creep.rate": 0}) for s in (1, 45)
        ]
        good, bad = simulator.run_many(calls)
        assert isinstance(good, dict) and good["process"][0] != os.getpid()
        assert "ValueError: too soft" in str(bad)
        diagnosis = diagnose_simulator(simulator, runs)
    assert diagnosis.best.ids == ("creep",)
    with pytest.raises(InputError, match="--processes 0"), in_processes("my_foot:SIMULATOR", declared, 0):
        pass


def slow_clock(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """A clock that goes on by so much at every look."""
    now = iter(np.arange(0.0, 1e6, seconds))
    monkeypatch.setattr("softcal.app.gap.simulator.perf_counter", lambda: float(next(now)))


def test_the_time_of_a_diagnosis_is_foretold_from_the_first_calls(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    declared = load_simulator("my_foot:SIMULATOR")
    runs, _ = read_runs(rig, declared)
    slow_clock(monkeypatch, 2.0)
    message = foretell_duration(declared, runs)
    # Four parameters, two runs of 1 s each: 30 and 350 rounds of calls a parameter.
    assert message.startswith("one call takes 1 s: about 4 minutes where nothing is missing, up to 47 where structure")
    assert "about 2 minutes" in foretell_duration(declared, runs, processes=2)
    slow_clock(monkeypatch, 0.01)
    assert foretell_duration(declared, runs) == ""


def test_a_simulator_that_fails_at_its_usual_values_is_left_to_the_diagnosis(rig: Path) -> None:
    def fails(inputs: Any, p: Any) -> Any:
        raise ValueError("never")

    declared = load_simulator("my_foot:SIMULATOR")
    runs, _ = read_runs(rig, declared)
    broken = simulator_of({**plain(), "run": fails}, "broken")
    assert foretell_duration(broken, runs) == ""


def plain() -> dict[str, Any]:
    return {
        "run": lambda inputs, p: {"sunk_mm": p["soft"] * inputs["push_N"] * (1.0 + p["toe.size"])},
        "inputs": ["push_N"],
        "channels": ["sunk_mm"],
        "base": {"soft": (0.0, 50.0, 1.0)},
        "candidates": {"toe": {"size": (-1.0, 1.0, 0.1)}},
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"chanels": ()}, "chanels missing or unknown"),
        ({"base": {"soft": (0.0, 1.0)}}, r"soft is \(0.0, 1.0\); \(low, high, usual\)"),
        ({"base": {"soft": {"low": 0.0, "hihg": 1.0}}}, "low, high, usual"),
        ({"base": {"soft": (5.0, 1.0, 2.0)}}, "the smaller first"),
    ],
)
def test_a_dictionary_that_says_something_else_is_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simulator_of({**plain(), **change}, "foot")


def test_a_dictionary_that_lacks_its_candidates_is_refused() -> None:
    lacking = plain()
    del lacking["candidates"]
    with pytest.raises(InputError, match="candidates missing"):
        simulator_of(lacking, "foot")
