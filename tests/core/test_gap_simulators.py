"""Simulators of many kinds: no plain least squares comes closer, and what no candidate explains is not explained."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numba
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import lfilter

from softcal.core.errors import InputError
from softcal.core.gap.case import Case
from softcal.core.gap.residual import noise_chance
from softcal.core.gap.simulator import Columns, Simulator, SimulatorRun, candidate, recorded
from softcal.core.gap.simulator_model import SimulatorModel, diagnose_simulator
from softcal.core.gap.simulator_reach import shifted, term_of, with_terms
from softcal.core.twin.effects import Parameter
from tests.layers import layered

T = np.arange(400) * 0.05
Values = Mapping[str, float]


@dataclass(frozen=True)
class Rig:
    """A simulator, what its rig is, what is put in in every run, and how noisy its channels are."""

    simulator: Simulator
    truth: Values
    inputs: Callable[[int], Columns]
    noise: float
    causes: tuple[str, ...]
    runs: int = 2
    spoil: Callable[[np.random.Generator, np.ndarray], np.ndarray] = field(default=lambda rng, values: values)

    def recorded(self, seed: int = 0) -> list[SimulatorRun]:
        rng, out = np.random.default_rng(seed), []
        off = {f"{c.id}.{p.name}": v for c in self.simulator.candidates for p, v in neutral(c)}
        for run in range(self.runs):
            inputs = self.inputs(run)
            gives = self.simulator.run(inputs, off | dict(self.truth))
            noisy = {c: self.spoil(rng, v) + rng.normal(0.0, self.noise, len(v)) for c, v in gives.items()}
            out.append(recorded(self.simulator, str(run + 1), {**inputs, **noisy}))
        return out


def blind(simulator: Simulator, causes: tuple[str, ...]) -> Simulator:
    """The simulator without these candidates; nothing in it can act as they do."""
    run = simulator.run
    off = {f"{c.id}.{p.name}": v for c in simulator.candidates if c.id in causes for p, v in neutral(c)}
    selected = tuple(c for c in simulator.candidates if c.id not in causes)
    return replace(simulator, candidates=selected, run=lambda i, p: run(i, off | dict(p)))


def neutral(effect: Any) -> list[tuple[Parameter, float]]:
    return list(zip(effect.parameters, effect.neutral_values, strict=True))


def size(name: str, unit: str, low: float, high: float, usual: float) -> Parameter:
    return Parameter(name, unit, low, high, usual, neutral=0.0)


def sweep(run: int) -> np.ndarray:
    return np.asarray(np.sin((0.4 + 0.5 * run + 0.04 * T) * T) * (1.0 - 0.3 * run))


def spring(i: Columns, p: Values) -> Columns:
    x = i["x"]
    return {"y": p["slope"] * x + p["zero"] + p["cubic.a"] * x**3 + p["even.a"] * x**2 + p["drift.rate"] * T}


SPRING = Rig(
    Simulator(
        "a spring that pulls",
        spring,
        ("x",),
        ("y",),
        (Parameter("slope", "1", -9.0, 9.0, 1.0), Parameter("zero", "1", -9.0, 9.0, 0.1)),
        (
            candidate("cubic", "spring", size("a", "1", -9.0, 9.0, 0.1)),
            candidate("even", "spring", size("a", "1", -9.0, 9.0, 0.1)),
            candidate("drift", "sensor", size("rate", "1/s", -1.0, 1.0, 0.01)),
        ),
    ),
    {"slope": -2.0, "zero": -0.4, "cubic.a": -0.5},
    lambda run: {"t_s": T, "x": sweep(run)},
    0.003,
    ("cubic",),
)


def lag(values: np.ndarray, tau_s: float) -> np.ndarray:
    decay = np.exp(-0.05 / max(tau_s, 1e-3))
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], values))


def oven(i: Columns, p: Values) -> Columns:
    heat = np.interp(T - p["late.delay"], T, i["power"]) * (1.0 - p["weak.share"] * i["power"])
    warm = p["room"] + p["gain"] * (
        (1.0 - p["wall.share"]) * lag(heat, p["tau"]) + p["wall.share"] * lag(heat, p["wall.tau"])
    )
    return {"T": warm}


OVEN = Rig(
    Simulator(
        "an oven",
        oven,
        ("power",),
        ("T",),
        (
            Parameter("room", "K", -500.0, 500.0, 10.0),
            Parameter("gain", "K", 0.1, 1000.0, 20.0, scale="log"),
            Parameter("tau", "s", 0.02, 100.0, 5.0, scale="log"),
        ),
        (
            candidate("late", "heater", size("delay", "s", 0.0, 3.0, 0.1)),
            candidate("weak", "heater", size("share", "1", 0.0, 0.9, 0.1)),
            candidate(
                "wall", "wall", size("share", "1", 0.0, 0.9, 0.2), Parameter("tau", "s", 0.1, 50.0, 5.0, scale="log")
            ),
        ),
    ),
    {"room": -18.0, "gain": 60.0, "tau": 0.6, "wall.share": 0.3, "wall.tau": 6.0},
    lambda run: {"t_s": T, "power": np.clip(0.5 + sweep(run) * (1 if run else -1), 0.0, 1.0) * (T > 1.0)},
    0.1,
    ("wall",),
)


def enzyme(i: Columns, p: Values) -> Columns:
    s = i["s"] ** (1.0 + p["hill.more"])
    rate = p["vmax"] * s / (p["k"] + s * (1.0 + p["inhibition.by"] * s)) + p["blank.level"]
    return {"v": rate * np.exp(-p["decay.rate"] * T)}


ENZYME = Rig(
    Simulator(
        "an enzyme",
        enzyme,
        ("s",),
        ("v",),
        (Parameter("vmax", "1", 0.01, 1000.0, 1.0, scale="log"), Parameter("k", "1", 1e-3, 1000.0, 1.0, scale="log")),
        (
            candidate("inhibition", "enzyme", size("by", "1", 0.0, 10.0, 0.1)),
            candidate("hill", "enzyme", size("more", "1", -0.5, 2.0, 0.2)),
            candidate("blank", "meter", size("level", "1", -1.0, 1.0, 0.05)),
            candidate("decay", "enzyme", size("rate", "1/s", 0.0, 1.0, 0.01)),
        ),
    ),
    {"vmax": 30.0, "k": 12.0, "inhibition.by": 0.05, "decay.rate": 0.02},
    lambda run: {"t_s": T, "s": 10.0 ** (0.7 + 0.9 * sweep(run))},
    0.03,
    ("decay", "inhibition"),
)


def ringing(i: Columns, p: Values) -> Columns:
    phase = 2 * np.pi * (p["rate"] + p["stiffening.per_s"] * T) * T
    envelope = np.maximum(np.exp(-T / p["fades"]) - p["rubbing.loss"] * T, 0.0)
    return {"y": i["pluck"] * p["size"] * envelope * np.cos(phase) + p["offset.y"]}


RINGING = Rig(
    Simulator(
        "a string",
        ringing,
        ("pluck",),
        ("y",),
        (
            Parameter("rate", "Hz", 0.05, 3.0, 0.5),
            Parameter("fades", "s", 0.1, 1000.0, 5.0, scale="log"),
            Parameter("size", "1", -10.0, 10.0, 1.0),
        ),
        (
            candidate("stiffening", "string", size("per_s", "Hz/s", -0.05, 0.05, 0.002)),
            candidate("rubbing", "bridge", size("loss", "1/s", 0.0, 0.2, 0.01)),
            candidate("offset", "sensor", size("y", "1", -1.0, 1.0, 0.02)),
        ),
    ),
    {"rate": 0.83, "fades": 9.0, "size": 1.4, "rubbing.loss": 0.02},
    lambda run: {"t_s": T, "pluck": np.full(len(T), 1.0 + 0.5 * run)},
    0.01,
    ("rubbing",),
)


@numba.njit
def _pendulum(u: np.ndarray, step_s: float, steps: int, p: np.ndarray) -> np.ndarray:
    out, angle, speed = np.zeros(len(u)), 0.0, 0.0
    for n in range(len(u) - 1):
        for k in range(steps):
            push = u[n] + (u[n + 1] - u[n]) * k / steps
            rubs = p[1] * speed + p[2] * np.tanh(speed / 0.05) + p[3] * speed * abs(speed)
            speed += step_s / steps * (p[4] * push - p[0] * np.sin(angle) - rubs)
            angle += step_s / steps * speed
        out[n + 1] = angle
    return out


def pendulum(i: Columns, p: Values, steps: int = 20) -> Columns:
    coefficients = np.array([p["pull"], p["damping"], p["dry.torque"], p["air.c2"], p["push"]])
    return {"angle_rad": np.interp(T - p["latency.delay"], T, _pendulum(i["u"], 0.05, steps, coefficients))}


PENDULUM = Rig(
    Simulator(
        "a pendulum",
        pendulum,
        ("u",),
        ("angle_rad",),
        (
            Parameter("pull", "1/s²", 0.1, 500.0, 5.0, scale="log"),
            Parameter("damping", "1/s", 0.0, 10.0, 0.2),
            Parameter("push", "1", -100.0, 100.0, 3.0),
        ),
        (
            candidate("dry", "bearing", size("torque", "1/s²", 0.0, 5.0, 0.1)),
            candidate("air", "rod", size("c2", "1", 0.0, 5.0, 0.05)),
            candidate("latency", "encoder", size("delay", "s", 0.0, 0.3, 0.01)),
        ),
    ),
    {"pull": 9.0, "damping": 0.15, "push": 6.0, "dry.torque": 0.25},
    lambda run: {"t_s": T, "u": sweep(run)},
    0.003,
    ("dry",),
)

RIGS = {rig.simulator.name: rig for rig in (SPRING, OVEN, ENZYME, RINGING, PENDULUM)}


def plain(rig: Rig, runs: list[SimulatorRun], causes: tuple[str, ...]) -> float:
    """Root mean square left by SciPy's least squares from six starts, over the one channel of a simulator."""
    simulator = rig.simulator
    selected = [c for c in simulator.candidates if c.id in causes]
    parameters = [(p, p.name) for p in simulator.base] + [
        (p, f"{c.id}.{p.name}") for c in selected for p in c.parameters
    ]
    off = {f"{c.id}.{p.name}": v for c in simulator.candidates for p, v in neutral(c)}
    low, high, usual = (
        np.array([np.log(v) if p.scale == "log" else v for p, v in ((p, getattr(p, end)) for p, _ in parameters)])
        for end in ("low", "high", "usual")
    )
    scale = np.array([1.0 if p.scale == "log" else abs(p.usual) for p, _ in parameters])
    channel = simulator.channels[0]

    def residual(x: np.ndarray) -> np.ndarray:
        values = off | {n: np.exp(v) if p.scale == "log" else v for (p, n), v in zip(parameters, x, strict=True)}
        return np.concatenate([simulator.run(r.columns, values)[channel] - r.columns[channel] for r in runs])

    rng, margin = np.random.default_rng(7), 1e-9 * (high - low)
    starts = [usual, *(usual + 0.7 * scale * rng.normal(size=len(usual)) for _ in range(5))]
    solutions = [
        least_squares(residual, np.clip(x, low + margin, high - margin), bounds=(low, high), x_scale=scale)
        for x in starts
    ]
    return float(np.sqrt(2.0 * min(f.cost for f in solutions) / len(solutions[0].fun)))


def rms(fitted: Any) -> float:
    return float(np.sqrt(np.mean((fitted.problem.measured - fitted.predicted) ** 2)))


@pytest.mark.parametrize("name", layered(RIGS, set(RIGS) - {PENDULUM.simulator.name}))
def test_causes_are_named_and_no_plain_fit_is_closer(name: str) -> None:
    rig = RIGS[name]
    runs = rig.recorded()
    diagnosis = diagnose_simulator(rig.simulator, runs)
    assert (diagnosis.verdict, diagnosis.best.hypothesis.ids) == ("explained", rig.causes)
    assert rms(diagnosis.base) <= 1.002 * plain(rig, runs, ())
    assert rms(diagnosis.best) <= 1.002 * plain(rig, runs, rig.causes)
    assert diagnosis.explained_fraction.held_out > 0.9


@pytest.mark.parametrize("name", RIGS)
def test_without_its_cause_a_rig_is_unknown(name: str) -> None:
    rig = RIGS[name]
    diagnosis = diagnose_simulator(blind(rig.simulator, rig.causes[:1]), rig.recorded())
    assert diagnosis.verdict == "unknown" and all(cause.probability < 0.5 for cause in diagnosis.causes)


def test_what_no_candidate_explains_is_described_by_a_term_that_the_simulator_can_take_up() -> None:
    simulator = blind(SPRING.simulator, ("cubic",))
    diagnosis = diagnose_simulator(simulator, SPRING.recorded())
    assert diagnosis.verdict == "unknown" and diagnosis.residual is not None
    (one,) = diagnosis.residual.terms
    # In the units of the term 1 is the largest x of the runs.
    assert (one.term.place, one.term.variable) == ("y", "x³")
    assert one.term.coefficient / one.term.half**3 == pytest.approx(-0.5, abs=5 * one.standard_error)
    assert diagnosis.residual.explained_fraction.held_out > 0.95
    record = diagnosis.report()["residual"]
    taken_up = with_terms(simulator, [term_of(each, "here") for each in record["added"]])
    fresh = replace(SPRING, runs=4).recorded(5)[3]
    residual = fresh.columns["y"] - taken_up(fresh.columns, record["parameters"])["y"]
    assert np.std(residual) == pytest.approx(SPRING.noise, rel=0.1)


def test_where_nothing_is_left_nothing_is_described() -> None:
    assert diagnose_simulator(SPRING.simulator, SPRING.recorded()).residual is None
    assert diagnose_simulator(SPRING.simulator, sound(SPRING).recorded()).residual is None


@pytest.mark.parametrize("record", [{}, {"place": "y"}, []])
def test_a_term_that_is_none_is_refused(record: Any) -> None:
    with pytest.raises(InputError, match="here: a term has"):
        term_of(record, "here")


def sound(rig: Rig, **changes: Any) -> Rig:
    return replace(rig, truth={k: v for k, v in rig.truth.items() if "." not in k}, **changes)


@pytest.mark.parametrize("name", [SPRING.simulator.name, OVEN.simulator.name, RINGING.simulator.name])
@pytest.mark.parametrize("has_cause", [False, True])
def test_noise_that_fades_is_a_floor(name: str, has_cause: bool) -> None:
    rig, decay = RIGS[name], np.exp(-1.0 / 8.0)

    def spoil(rng: np.random.Generator, values: np.ndarray) -> np.ndarray:
        quick = rng.normal(0.0, 3.0 * rig.noise, len(values))
        return np.asarray(values + lfilter([np.sqrt(1.0 - decay**2)], [1.0, -decay], quick))

    variant = replace(rig if has_cause else sound(rig), spoil=spoil, runs=4)
    diagnosis = diagnose_simulator(rig.simulator, variant.recorded())
    assert diagnosis.verdict == ("explained" if has_cause else "no_gap")
    assert diagnosis.best.hypothesis.ids == (rig.causes if has_cause else ())


@pytest.mark.parametrize("name", layered(RIGS, (OVEN.simulator.name,)))
@pytest.mark.parametrize("has_cause", [False, True])
def test_what_a_run_may_have_of_its_own_needs_no_cause(name: str, has_cause: bool) -> None:
    rig, channel = RIGS[name], RIGS[name].simulator.channels[0]

    def spoil(rng: np.random.Generator, values: np.ndarray) -> np.ndarray:
        late = CubicSpline(T, values)(np.maximum(T - rng.uniform(0.0, 0.1), 0.0))
        return np.asarray(late * (1.0 + rng.normal(0.0, 0.01)) + rng.normal(0.0, 20.0 * rig.noise))

    allowed = {channel: {"zero": 100.0 * rig.noise, "delay": 0.2, "gain": 0.05}}
    variant = replace(rig if has_cause else sound(rig), spoil=spoil, runs=4)
    runs = variant.recorded()
    diagnosis = diagnose_simulator(replace(rig.simulator, per_run=allowed), runs)
    assert diagnosis.verdict == ("explained" if has_cause else "no_gap")
    assert diagnosis.best.hypothesis.ids == (rig.causes if has_cause else ())
    assert diagnose_simulator(rig.simulator, runs).verdict == "unknown"


def chance_of_noise(seed: int, residual_level: float = 0.0) -> float:
    """How likely noise leaves as much as the base of a sound spring does, with a ripple beside it of so many σ."""

    def spoil(rng: np.random.Generator, values: np.ndarray) -> np.ndarray:
        return np.asarray(values + residual_level * SPRING.noise * np.sin(2.0 * np.pi * 1.9 * T))

    rig = replace(sound(SPRING), spoil=spoil)
    return noise_chance(SimulatorModel(rig.simulator).base_fit(Case("", tuple(rig.recorded(seed)))))


def test_noise_passes_for_noise_at_the_stated_rate() -> None:
    chances = np.array([chance_of_noise(seed) for seed in range(100)])
    assert np.sum(chances < 0.05) <= 11 and np.sum(chances < 1e-3) <= 1


@pytest.mark.parametrize("seed", range(3))
def test_a_ripple_that_sums_to_nothing_is_no_noise(seed: int) -> None:
    rig = replace(sound(SPRING), spoil=lambda rng, v: v + 0.7 * SPRING.noise * np.sin(2.0 * np.pi * 1.9 * T))
    assert chance_of_noise(seed, 0.7) < 1e-6
    assert diagnose_simulator(rig.simulator, rig.recorded(seed)).verdict == "unknown"


@pytest.mark.parametrize("linear_share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("delay_s", [0.3, 2.7, -1.1])
def test_a_channel_is_late_along_a_spline_or_along_linear_segments(linear_share: float, delay_s: float) -> None:
    t_s = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 60))
    t_s, at_s = t_s - t_s[0], np.clip(t_s - t_s[0] - delay_s, 0.0, t_s[-1] - t_s[0])
    values = np.sin(0.6 * t_s)
    curve, lines = CubicSpline(t_s, values)(at_s), np.interp(at_s, t_s, values)
    late, slope, apart = shifted(values, t_s, delay_s, linear_share)
    assert late == pytest.approx((1.0 - linear_share) * curve + linear_share * lines, abs=1e-12)
    assert apart == pytest.approx(lines - curve, abs=1e-12)
    nearby = shifted(values, t_s, delay_s - 1e-6, linear_share)[0]
    inside = (at_s > 1e-5) & (at_s < t_s[-1] - 1e-5)
    assert ((nearby - late) / 1e-6)[inside] == pytest.approx(slope[inside], abs=1e-4)


def test_a_coarse_step_is_not_explained_by_what_does_not_shrink_the_gap() -> None:
    def coarse(i: Columns, p: Values) -> Columns:
        return pendulum(i, p, steps=1)

    simulator = blind(replace(PENDULUM.simulator, run=coarse), ("dry", "air"))
    diagnosis = diagnose_simulator(simulator, sound(PENDULUM).recorded())
    assert diagnosis.verdict != "explained" or diagnosis.explained_fraction.held_out > 0.85
    if diagnosis.verdict == "unknown":
        assert all(cause.probability < 0.5 for cause in diagnosis.causes)


def failing(i: Columns, p: Values) -> Columns:
    if p["slope"] > 3.0:
        return {"y": np.full(len(T), np.nan)}
    if p["even.a"] > 5.0:
        raise KeyError("no such table")
    return spring(i, p) if p["cubic.a"] > -6.0 else {"y": np.zeros(3)}


def test_corners_where_a_simulator_fails_are_avoided_and_reported() -> None:
    diagnosis = diagnose_simulator(replace(SPRING.simulator, run=failing), SPRING.recorded())
    assert (diagnosis.verdict, diagnosis.best.hypothesis.ids) == ("explained", ("cubic",))
    failed = diagnosis.report()["failed"]
    assert isinstance(failed, dict) and 0 < failed["evaluations"] < failed["of"]


def raising(i: Columns, p: Values) -> Columns:
    return {"y": p["slop"] * i["x"]}


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (raising, "KeyError: 'slop'"),
        (lambda i, p: {"y": np.zeros(3)}, r"\(3,\)"),
        (lambda i, p: {"y": i["x"] * np.nan}, "nan"),
        (lambda i, p: {"z": i["x"]}, "gives no y"),
        (lambda i, p: i["x"], "gives no y"),
    ],
)
def test_a_simulator_that_fails_everywhere_is_reported_by_file_and_parameters(run: Any, message: str) -> None:
    with pytest.raises(InputError, match=rf"test_gap_simulators\.py.*{message}.*slope = "):
        diagnose_simulator(replace(SPRING.simulator, run=run), SPRING.recorded())
