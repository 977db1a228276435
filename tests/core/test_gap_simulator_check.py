"""A simulator that cannot be fitted is refused before the fit, in one line that says why."""

import copy
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from operator import itemgetter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.gap.simulator import Columns, Simulator, SimulatorRun, candidate, check_calls, recorded
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.twin.effects import Parameter

T_S = np.arange(0.0, 4.0, 0.02)


def press(inputs: Columns, p: Mapping[str, float]) -> dict[str, np.ndarray]:
    load_N = inputs["load_N"]
    return {"sunk_mm": p["softness"] * load_N + p["bottoming.a"] * load_N**2 + p["creep.rate"] * inputs["t_s"]}


PAD = Simulator(
    name="foot",
    run=press,
    inputs=("load_N",),
    channels=("sunk_mm",),
    base=(Parameter("softness", "mm/N", 0.01, 10.0, 0.1),),
    candidates=(
        candidate("bottoming", "foot", Parameter("a", "mm/N²", -1.0, 1.0, 0.01, neutral=0.0)),
        candidate("creep", "rubber", Parameter("rate", "mm/s", 0.0, 1.0, 0.05, neutral=0.0)),
    ),
)


def runs_of(simulator: Simulator = PAD) -> tuple[SimulatorRun, ...]:
    rng, out = np.random.default_rng(3), []
    values = {"softness": 0.12, "bottoming.a": 0.02, "creep.rate": 0.0}
    for name, speed in (("one", 2.0), ("two", 3.1)):
        load_N = 5.0 * np.abs(np.sin(speed * T_S))
        sunk_mm = press({"t_s": T_S, "load_N": load_N}, values)["sunk_mm"] + rng.normal(0.0, 0.003, len(T_S))
        out.append(recorded(simulator, name, {"t_s": T_S, "load_N": load_N, "sunk_mm": sunk_mm}))
    return tuple(out)


class Faults:
    """What simulators do wrong, each as the function that a person would write."""

    def __init__(self) -> None:
        self.rng, self.rest = np.random.default_rng(8), 0.0

    def noisy(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        return {"sunk_mm": press(inputs, p)["sunk_mm"] + self.rng.normal(0.0, 1e-6, len(inputs["t_s"]))}

    def leaks_state(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        sunk_mm = press(inputs, p)["sunk_mm"] + 0.01 * self.rest
        self.rest = float(sunk_mm[-1])
        return {"sunk_mm": sunk_mm}

    def remembers_parameters(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        self.rest = max(self.rest, p["bottoming.a"])
        return press(inputs, {**p, "bottoming.a": self.rest})

    def writes_into_input(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        load_N = inputs["load_N"]
        load_N *= 0.9
        return press(inputs, p)

    def writes_into_parameters(self, inputs: Columns, p: Any) -> dict[str, Any]:
        p["softness"] = 1.01 * p["softness"]
        return press(inputs, p)

    def rounds(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        return {"sunk_mm": np.round(press(inputs, p)["sunk_mm"], 2)}

    def half_precision(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        return {"sunk_mm": press(inputs, p)["sunk_mm"].astype(np.float16)}

    def misspells_candidate(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        load_N = inputs["load_N"]
        return {"sunk_mm": p["softness"] * load_N + p["bottoming.a"] * load_N**2 + p.get("crep.rate", 0.0) * T_S}

    def misspells_in_a_namespace(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        values = SimpleNamespace(**{name.replace(".", "_"): value for name, value in p.items()})
        load_N = inputs["load_N"]
        return {
            "sunk_mm": values.softness * load_N + getattr(values, "botoming_a", 0.0) * load_N**2 + values.creep_rate
        }

    def never_reads_base(self, inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
        return {"sunk_mm": 0.1 * inputs["load_N"] + p["bottoming.a"] * inputs["load_N"] ** 2 + p["creep.rate"] * T_S}


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("noisy", "twice"),
        ("leaks_state", "twice"),
        ("remembers_parameters", "again"),
        ("writes_into_input", "load_N"),
        ("writes_into_parameters", "softness"),
        ("rounds", "rounds"),
        ("half_precision", "rounds"),
        ("misspells_candidate", "creep.rate"),
        ("misspells_in_a_namespace", "bottoming.a"),
        ("never_reads_base", "softness"),
    ],
)
def test_a_simulator_that_cannot_be_fitted_is_refused(fault: str, message: str) -> None:
    run: Callable[..., Any] = getattr(Faults(), fault)
    simulator = replace(PAD, run=run)
    with pytest.raises(InputError, match=message) as refused:
        diagnose_simulator(simulator, runs_of(simulator))
    assert "\n" not in str(refused.value) and "foot" in str(refused.value)


def test_a_sound_simulator_is_called_a_few_times_and_its_runs_stay_as_they_are() -> None:
    calls = 0

    def counted(inputs: Columns, p: Mapping[str, float]) -> dict[str, np.ndarray]:
        nonlocal calls
        calls += 1
        return press(inputs, p)

    runs = runs_of()
    before = [{name: values.copy() for name, values in run.columns.items()} for run in runs]
    check_calls(replace(PAD, run=counted), runs)
    assert calls <= 4 + 2 * 3
    for run, columns in zip(runs, before, strict=True):
        assert all(np.array_equal(run.columns[name], values) for name, values in columns.items())


NAMES = ("softness", "bottoming.a", "creep.rate")
VALUES = itemgetter(*NAMES)


def updated(p: Mapping[str, float]) -> dict[str, float]:
    values: dict[str, float] = {}
    values.update(p)
    return values


@pytest.mark.parametrize(
    "values_of",
    [
        VALUES,
        lambda p: [p.setdefault(name, 0.5) for name in NAMES],
        lambda p: [p.get(name) for name in NAMES],
        lambda p: VALUES(p.copy()),
        lambda p: VALUES(copy.copy(p)),
        lambda p: VALUES({"more": 1.0} | p | {"other": 2.0}),
        lambda p: VALUES(updated(p)),
        lambda p: VALUES(json.loads(json.dumps(p))),
        lambda p: VALUES(dict(zip(p, p.values(), strict=True))),
    ],
    ids=["itemgetter", "setdefault", "get", "copy", "copied by a module", "joined", "updated", "json", "zipped"],
)
def test_a_simulator_may_read_its_parameters_as_it_likes(values_of: Callable[[Any], Any]) -> None:
    run = lambda inputs, p: press(inputs, dict(zip(NAMES, values_of(p), strict=True)))  # noqa: E731
    check_calls(replace(PAD, run=run), runs_of())


def test_what_these_runs_cannot_show_is_no_fault_of_the_simulator() -> None:
    """A level that no run reaches is read and changes nothing; friction has a kink where the speed turns."""

    def stopped(inputs: Columns, p: Mapping[str, float]) -> dict[str, np.ndarray]:
        sunk_mm = p["softness"] * inputs["load_N"]
        turned = np.sign(np.gradient(sunk_mm, inputs["t_s"]))
        return {"sunk_mm": np.minimum(sunk_mm, p["stop.depth"]) + p["rubbing.size"] * turned}

    simulator = replace(
        PAD,
        run=stopped,
        candidates=(
            candidate("stop", "foot", Parameter("depth", "mm", 100.0, 1e4, 1e3, np.inf, scale="inverse_square")),
            candidate("rubbing", "foot", Parameter("size", "mm", 0.0, 1.0, 0.1, neutral=0.0)),
        ),
    )
    check_calls(simulator, runs_of())


@pytest.mark.parametrize(
    "parameter",
    [
        Parameter("softness", "mm/N", 10.0, 0.01, 0.1),
        Parameter("softness", "mm/N", 0.1, 0.1, 0.1),
        Parameter("softness", "mm/N", 0.01, 10.0, 20.0),
        Parameter("softness", "mm/N", 0.01, 10.0, np.nan),
        Parameter("softness", "mm/N", -np.inf, 10.0, 1.0),
        Parameter("softness", "mm/N", 0.0, 10.0, 1.0, scale="log"),
    ],
)
def test_bounds_that_hold_nothing_are_refused(parameter: Parameter) -> None:
    with pytest.raises(InputError, match="softness"):
        replace(PAD, base=(parameter,))


def test_a_candidate_whose_usual_size_lies_outside_its_bounds_is_refused() -> None:
    with pytest.raises(InputError, match=r"bottoming\.a"):
        replace(PAD, candidates=(candidate("bottoming", "foot", Parameter("a", "", -1.0, 1.0, 2.0, neutral=0.0)),))


SIZE = Parameter("size", "mm", -1.0, 1.0, 0.1, neutral=0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"base": (Parameter("softness", "mm/N", "0", 1.0, 0.5),)}, "lower bound '0'"),
        ({"run": None}, "run is None"),
        ({"inputs": "load_N"}, "in a tuple"),
        ({"inputs": ("t_s",)}, "two of the input columns"),
        ({"base": (*PAD.base, Parameter("creep.rate", "", 0.0, 1.0, 0.5))}, "two of the parameters"),
        ({"candidates": (candidate("toe", "foot", SIZE, SIZE),)}, "two of the parameters"),
        ({"candidates": (candidate("toe", "foot", replace(SIZE, usual=0.0)),)}, "switches it off"),
        ({"candidates": (candidate("toe", "foot", SIZE, probes=((0.1, 0.2),)),)}, "2 values"),
    ],
)
def test_a_declaration_that_cannot_be_meant_is_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        replace(PAD, **change)
    assert "\n" not in str(refused.value) and "foot" in str(refused.value)


@pytest.mark.parametrize("parameters", [(), (replace(SIZE, neutral=None),)])
def test_a_candidate_that_cannot_be_switched_off_is_refused(parameters: tuple[Parameter, ...]) -> None:
    with pytest.raises(InputError, match="toe.*neutral value"):
        candidate("toe", "foot", *parameters)


@pytest.mark.parametrize(("values", "message"), [(["a"] * 50, "no column of numbers"), (np.ones((50, 2)), "shape")])
def test_a_column_that_is_none_is_refused(values: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"load_N.*{message}"):
        recorded(PAD, "1", {"t_s": np.arange(50.0), "load_N": values, "sunk_mm": np.ones(50)})


def test_two_runs_of_one_name_are_refused() -> None:
    with pytest.raises(InputError, match="two runs have one name: one, one"):
        diagnose_simulator(PAD, [runs_of()[0]] * 2)


def leaves(inputs: Columns, p: Mapping[str, float]) -> dict[str, Any]:
    raise SystemExit(3)


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (leaves, "SystemExit"),
        (lambda inputs, p: {"sunk_mm": press(inputs, p)["sunk_mm"] + 0j}, "complex"),
    ],
)
def test_a_simulator_that_leaves_or_is_complex_fails_in_one_line(run: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        diagnose_simulator(replace(PAD, run=run), runs_of())


def test_a_simulator_that_gives_its_first_answer_for_ever_is_refused() -> None:
    answers: dict[int, dict[str, np.ndarray]] = {}

    def stale(inputs: Columns, p: Mapping[str, float]) -> dict[str, np.ndarray]:
        return answers.setdefault(len(inputs["t_s"]), press(inputs, p))

    with pytest.raises(InputError, match="no parameter changes a channel"):
        diagnose_simulator(replace(PAD, run=stale), runs_of())


@pytest.mark.parametrize("decimals", [1, 2, 3])
def test_a_channel_on_a_grid_is_refused_however_far_it_moves(decimals: int) -> None:
    """A small step moves most samples by more than the grid: differences alone would look sound."""
    far = lambda inputs, p: {"sunk_mm": np.round(1e3 * press(inputs, p)["sunk_mm"], decimals)}  # noqa: E731
    with pytest.raises(InputError, match="it rounds sunk_mm"):
        check_calls(replace(PAD, run=far), runs_of())
    fine = lambda inputs, p: {"sunk_mm": np.round(press(inputs, p)["sunk_mm"], 9)}  # noqa: E731
    check_calls(replace(PAD, run=fine), runs_of())


def test_inputs_on_a_grid_make_no_grid_of_channels() -> None:
    run = runs_of()[0]
    whole = replace(run, columns=run.columns | {"load_N": np.round(run.columns["load_N"])})
    check_calls(PAD, [whole])


def ball(inputs: Columns, p: Mapping[str, float]) -> dict[str, np.ndarray]:
    """A ball that is dropped and bounces, each fall in closed form; the camera may be tilted."""
    out = []
    for time_left in inputs["t_s"]:
        height, speed = p["height"], 0.0
        while (lands := (speed + np.sqrt(speed**2 + 2.0 * p["g"] * height)) / p["g"]) < time_left and lands > 1e-3:
            time_left, speed, height = time_left - lands, p["bounce"] * (p["g"] * lands - speed), 0.0
        out.append(height + speed * time_left - 0.5 * p["g"] * time_left**2)
    return {"y_m": np.array(out) + p["tilt.rate"] * inputs["t_s"]}


BALL = Simulator(
    "ball",
    ball,
    (),
    ("y_m",),
    (
        Parameter("g", "m/s²", 1.0, 20.0, 9.8),
        Parameter("height", "m", 0.1, 3.0, 1.0),
        Parameter("bounce", "", 0.3, 0.9, 0.7),
    ),
    (candidate("tilt", "camera", Parameter("rate", "m/s", -1.0, 1.0, 0.05, neutral=0.0)),),
)


def test_a_ball_that_bounces_is_accepted_and_diagnosed() -> None:
    rng, t_s, runs = np.random.default_rng(1), np.arange(0.0, 2.0, 0.02), []
    for name, height in (("1", 1.2), ("2", 0.8)):
        y = ball({"t_s": t_s}, {"g": 9.8, "height": height, "bounce": 0.75, "tilt.rate": 0.08})["y_m"]
        runs.append(recorded(BALL, name, {"t_s": t_s, "y_m": y + rng.normal(0.0, 0.003, len(t_s))}))
    dropped = replace(BALL, base=(BALL.base[0], BALL.base[2]), run_parameters=(BALL.base[1],))
    diagnosis = diagnose_simulator(dropped, runs)
    assert (diagnosis.verdict, diagnosis.best.ids) == ("explained", ("tilt",))
    assert diagnosis.report()["parameters"]["height@2"] == pytest.approx(0.8, abs=0.01)


def test_an_oscillator_of_many_periods_is_smooth() -> None:
    """A step of a hundredth turns its phase round: longer steps than those of a fit say nothing of smoothness."""
    swing = lambda inputs, p: {"y_m": np.sin(p["w"] * inputs["t_s"]) + p["tilt.rate"] * inputs["t_s"]}  # noqa: E731
    simulator = replace(BALL, run=swing, base=(Parameter("w", "1/s", 1.0, 100.0, 50.0),))
    t_s = np.arange(0.0, 30.0, 0.01)
    check_calls(simulator, [recorded(simulator, "1", {"t_s": t_s, "y_m": np.sin(48.0 * t_s)})])


def test_an_event_that_jumps_from_step_to_step_is_refused() -> None:
    """A switch that acts at the next of its own steps: its time moves in jumps."""

    def late(inputs: Columns, p: Mapping[str, float]) -> dict[str, np.ndarray]:
        phase = np.floor(p["w"] * inputs["t_s"] * 3e3) / 3e3
        return {"y_m": np.sin(phase) + p["tilt.rate"] * 1e-9}

    simulator = replace(BALL, run=late, base=(Parameter("w", "1/s", 1.0, 100.0, 1.0),))
    t_s = np.arange(0.0, 2.0, 0.01)
    with pytest.raises(InputError, match="place an event between two steps"):
        check_calls(simulator, [recorded(simulator, "1", {"t_s": t_s, "y_m": np.sin(t_s)})])
