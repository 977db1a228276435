"""A right-hand side of SciPy and a command that reads and writes CSV are simulators like any other."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softcal.app.gap.adapters import integrate_rhs, run_command, run_fmu
from softcal.core.errors import InputError
from softcal.core.gap.simulator import Simulator, candidate, recorded
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.twin.effects import Parameter

COOLING = candidate("radiation", "surface", Parameter("size", "1/(K·s)", -0.1, 0.1, 0.002, neutral=0.0))
LEAK = candidate("sun", "window", Parameter("size", "K/s", -5.0, 5.0, 0.1, neutral=0.0))
BASE = (Parameter("loss", "1/s", 1e-3, 10.0, 0.2, scale="log"), Parameter("gain", "K/J", 0.0, 10.0, 1.0))


def rates(t, state, inputs, p):
    (warm,) = state
    return [p["gain"] * inputs["power_W"] - p["loss"] * warm - p["radiation.size"] * warm**2 + p["sun.size"]]


WARM = Simulator(
    "plate",
    integrate_rhs(rates, lambda p: [0.0], lambda t_s, state, p: {"warm_K": state[0]}),
    ("power_W",),
    ("warm_K",),
    BASE,
    (COOLING, LEAK),
)


def uneven_run(name, seed, radiation=0.01):
    """A run that another integrator steps: Heun's method, a thousand steps a sample."""
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(np.concatenate([[0.0], rng.uniform(0.1, 0.4, 40)]))
    power = rng.uniform(0.0, 4.0, len(t_s))
    warm, out = 0.0, [0.0]
    slope = lambda w, u: 0.9 * u - 0.3 * w - radiation * w**2  # noqa: E731
    for k in range(len(t_s) - 1):
        h = (t_s[k + 1] - t_s[k]) / 200
        for part in range(200):
            u0, u1 = (np.interp(x, (0, 200), power[k : k + 2]) for x in (part, part + 1))
            first = slope(warm, u0)
            warm += 0.5 * h * (first + slope(warm + h * first, u1))
        out.append(warm)
    return {"t_s": t_s, "power_W": power, "warm_K": np.array(out) + rng.normal(0.0, 0.005, len(t_s))}


def test_a_right_hand_side_is_diagnosed_on_uneven_samples():
    runs = [recorded(WARM, str(k), uneven_run(str(k), k)) for k in (1, 2)]
    clean = WARM(runs[0].columns, {"loss": 0.3, "gain": 0.9, "radiation.size": 0.01, "sun.size": 0.0})["warm_K"]
    assert np.max(np.abs(clean - runs[0].columns["warm_K"])) < 0.03
    diagnosis = diagnose_simulator(WARM, runs)
    assert (diagnosis.verdict, diagnosis.best.ids) == ("explained", ("radiation",))
    assert diagnosis.report()["parameters"]["radiation.size"] == pytest.approx(0.01, rel=0.05)


def test_a_right_hand_side_that_explodes_fails_in_one_line():
    run = integrate_rhs(lambda t, y, u, p: [y[0] ** 2 * 1e6], lambda p: [1.0], lambda t, y, p: {"y": y[0]})
    one = Simulator("bomb", run, (), ("y",), BASE, (LEAK,))
    with pytest.raises(InputError, match="bomb.*(does not get beyond|stopped at|is inf|is nan)"):
        one({"t_s": np.linspace(0.0, 1.0, 20)}, {"loss": 1.0, "gain": 1.0, "sun.size": 0.0})


PROGRAM = """
import csv, json, sys
given, said, out = sys.argv[1:]
p = json.load(open(said))
if p["slope"] > 90: sys.exit("slope is out of the model's range")
with open(out, "w") as file:
    print("y", file=file)
    for row in csv.DictReader(open(given)):
        x = float(row["x"])
        print(repr(p["slope"] * x + p["bend.size"] * x * x), file=file)
"""


def test_a_command_gets_inputs_and_parameters_and_gives_channels(tmp_path: Path):
    program = tmp_path / "model.py"
    program.write_text(PROGRAM)
    line = Simulator(
        "line",
        run_command([sys.executable, str(program)], ("y",)),
        ("x",),
        ("y",),
        (Parameter("slope", "", -100.0, 100.0, 1.0),),
        (candidate("bend", "line", Parameter("size", "", -5.0, 5.0, 0.2, neutral=0.0)),),
    )
    x = np.linspace(-1.0, 2.0, 31) / 3.0
    inputs = {"t_s": np.arange(31.0), "x": x}
    output = line(inputs, {"slope": 0.1 + 0.2, "bend.size": -1.0 / 3.0})["y"]
    assert output.tolist() == [(0.1 + 0.2) * v + (-1.0 / 3.0) * v * v for v in x.tolist()]
    with pytest.raises(InputError, match="exit code 1: slope is out of the model's range"):
        line(inputs, {"slope": 95.0, "bend.size": 0.0})


def test_a_command_is_diagnosed_from_its_files(tmp_path: Path):
    """The rig is computed here, by another formula than the program's."""
    program = tmp_path / "model.py"
    program.write_text(PROGRAM)
    line = Simulator(
        "line",
        run_command([sys.executable, "-S", "-E", str(program)], ("y",)),
        ("x",),
        ("y",),
        (Parameter("slope", "", -80.0, 80.0, 1.0),),
        (candidate("bend", "line", Parameter("size", "", -5.0, 5.0, 0.2, neutral=0.0)),),
    )
    x = np.linspace(-1.0, 2.0, 90)
    y = np.polyval([0.4, 1.7, 0.0], x) + np.random.default_rng(1).normal(0.0, 0.01, len(x))
    diagnosis = diagnose_simulator(line, [recorded(line, "1", {"t_s": np.arange(90.0), "x": x, "y": y})])
    assert (diagnosis.verdict, diagnosis.best.ids) == ("explained", ("bend",))
    assert diagnosis.report()["parameters"]["bend.size"] == pytest.approx(0.4, abs=0.01)


def stub_of_fmpy(variables):
    """A module that takes what fmpy takes: a unit that turns its input into gain times it, one row a step."""

    def simulate_fmu(folder, *, start_values, input, output, stop_time, step_size, **_):  # noqa: A002
        time = np.arange(0.0, stop_time + 0.5 * step_size, step_size)
        rows = np.zeros(len(time), dtype=[("time", float), *((name, float) for name in output)])
        rows["time"] = time
        drive = np.interp(time, input["time"], input["drive.f"])
        for name in output:
            rows[name] = start_values["spring.k"] * drive + start_values.get("stop", 0.0)
        return rows

    described = SimpleNamespace(modelVariables=[SimpleNamespace(name=name) for name in variables])
    return SimpleNamespace(
        read_model_description=lambda path: described, extract=lambda path: "folder", simulate_fmu=simulate_fmu
    )


def test_a_functional_mock_up_unit_is_a_simulator_on_uneven_samples(monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", stub_of_fmpy(["drive.f", "mass.s", "spring.k", "stop"]))
    run = run_fmu("unit.fmu", {"place": "mass.s"}, {"push": "drive.f"}, {"softness": "spring.k"}, max_step_s=0.01)
    t_s = 7.0 + np.array([0.0, 0.1, 0.25, 0.3, 0.55])
    push = np.array([0.0, 1.0, 2.5, 3.0, 5.5])
    inputs = {"t_s": t_s, "push": push}
    np.testing.assert_allclose(run(inputs, {"softness": 2.0, "stop": np.inf})["place"], 2.0 * push, atol=1e-9)
    np.testing.assert_allclose(run(inputs, {"softness": 2.0, "stop": 1.0})["place"], 2.0 * push + 1.0, atol=1e-9)


def test_a_unit_without_a_variable_and_a_missing_package_are_refused_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", stub_of_fmpy(["drive.f"]))
    with pytest.raises(InputError, match="has no variable mass.s; it has drive.f"):
        run_fmu("unit.fmu", {"place": "mass.s"}, {"push": "drive.f"})
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(InputError, match=r"pip install 'softcal\[fmu\]'"):
        run_fmu("unit.fmu", {"place": "mass.s"})
