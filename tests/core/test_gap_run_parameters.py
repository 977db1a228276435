"""What each run has of its own and a simulator must be told: where it begins."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.gap.simulator import Simulator, candidate, check_calls, recorded
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.twin.effects import Parameter


def level(inputs, p):
    """A tank that empties: level · exp(−t/τ), with a leak that falls straight."""
    t_s = inputs["t_s"]
    return {"level": p["start"] * np.exp(-t_s / p["tau"]) - p["leak.rate"] * t_s + p["haze.size"] * np.sin(3.0 * t_s)}


TANK = Simulator(
    "tank",
    level,
    (),
    ("level",),
    base=(Parameter("tau", "s", 0.1, 100.0, 3.0, scale="log"),),
    candidates=(
        candidate("leak", "wall", Parameter("rate", "1/s", -1.0, 1.0, 0.05, neutral=0.0)),
        candidate("haze", "sensor", Parameter("size", "", -1.0, 1.0, 0.1, neutral=0.0)),
    ),
    run_parameters=(Parameter("start", "", 0.0, 20.0, 4.0),),
)
STARTS = {"1": 2.0, "2": 5.0, "3": 8.0}


def runs_of(leak):
    rng, t_s = np.random.default_rng(3), np.linspace(0.0, 8.0, 200)
    truth = {"tau": 2.5, "leak.rate": leak, "haze.size": 0.0}
    out = []
    for name, start in STARTS.items():
        clean = level({"t_s": t_s}, truth | {"start": start})["level"]
        out.append(recorded(TANK, name, {"t_s": t_s, "level": clean + rng.normal(0.0, 0.01, len(t_s))}))
    return out


@pytest.mark.parametrize(("leak", "verdict", "causes"), [(0.0, "no_gap", ()), (0.06, "explained", ("leak",))])
def test_runs_from_different_levels_are_fitted_from_their_own(leak, verdict, causes):
    diagnosis = diagnose_simulator(TANK, runs_of(leak))
    assert (diagnosis.verdict, diagnosis.best.ids) == (verdict, causes)
    parameters = diagnosis.report()["parameters"]
    for name, start in STARTS.items():
        assert parameters[f"start@{name}"] == pytest.approx(start, abs=0.02)
    assert parameters["leak.rate"] == pytest.approx(leak, abs=0.003)
    predicted = TANK({"t_s": np.array([0.0, 1.0])}, parameters, "3")["level"]
    assert predicted[0] == pytest.approx(8.0, abs=0.02)


def test_a_parameter_of_runs_has_bounds_and_a_name_of_its_own():
    with pytest.raises(InputError, match="one name"):
        Simulator("tank", level, (), ("level",), TANK.base, TANK.candidates, run_parameters=TANK.base)
    reversed_ = (Parameter("start", "", 20.0, 0.0, 4.0),)
    with pytest.raises(InputError, match="bounds"):
        Simulator("tank", level, (), ("level",), TANK.base, TANK.candidates, run_parameters=reversed_)


def test_a_misspelt_cause_is_refused_though_every_run_has_its_own_start():
    def misspelt(inputs, p):
        return level(inputs, {"tau": p["tau"], "start": p["start"], "leak.rate": p["leak.rate"], "haze.size": 0.0})

    with pytest.raises(InputError, match=r"haze\.size is never read"):
        check_calls(replace(TANK, run=misspelt), runs_of(0.0))
    check_calls(TANK, runs_of(0.0))
