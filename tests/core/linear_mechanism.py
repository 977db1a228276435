"""A mechanism that is linear in its parameters: every step of a diagnosis has a closed form on it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import Hypothesis
from softcal.core.gap.model import Fit, Problem
from softcal.core.gap.search import Search
from softcal.core.gap.simulator import Simulator, SimulatorRun, candidate, recorded
from softcal.core.gap.simulator_model import SimulatorModel
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter

SIGMA = 0.05
SHAPES = {
    "bend": lambda x: x**2,
    "ripple": lambda x: np.sin(3.0 * x),
    "kink": lambda x: np.abs(x),
}


def line(inputs, p):
    x = inputs["x"]
    y = p["level"] + p["slope"] * x
    return {"y": y + sum(p[f"{name}.size"] * shape(x) for name, shape in SHAPES.items())}


def size(usual: float = 0.2, low: float = -50.0, high: float = 50.0) -> Parameter:
    return Parameter("size", "", low, high, usual, neutral=0.0)


LEVEL, SLOPE = Parameter("level", "", -50.0, 50.0, 1.0), Parameter("slope", "", -50.0, 50.0, 2.0)
CAUSES = tuple(candidate(name, f"part of {name}", size()) for name in SHAPES)
BEND, RIPPLE, KINK = CAUSES
LINE = Simulator("line", line, ("x",), ("y",), (LEVEL, SLOPE), CAUSES)


def x_of(run: int, count: int = 60) -> Array:
    rng = np.random.default_rng(100 + run)
    return np.sort(rng.uniform(-1.5 - 0.3 * run, 2.0 + 0.2 * run, count))[rng.permutation(count)]


def runs_of(
    truth: Mapping[str, float],
    counts: Sequence[int] = (60, 71),
    noise: float = SIGMA,
    seed: int = 0,
    simulator: Simulator = LINE,
) -> list[SimulatorRun]:
    """Recorded runs of the line with white noise; candidates that are not in the truth are off."""
    rng, out = np.random.default_rng(seed), []
    values = {"level": 1.0, "slope": 2.0} | simulator.neutral_values | dict(truth)
    for run, count in enumerate(counts):
        columns = {"t_s": 0.05 * np.arange(count), "x": x_of(run, count)}
        y = line(columns, values)["y"] + rng.normal(0.0, noise, count)
        out.append(recorded(simulator, str(run + 1), columns | {"y": y}))
    return out


def problem_of(runs: Sequence[SimulatorRun], sigma: float = SIGMA, simulator: Simulator = LINE) -> Problem:
    return Problem(SimulatorModel(simulator), Case("L1", tuple(runs)), {"y": sigma})


def fitted(problem: Problem, *effects: Effect) -> Fit:
    start = np.array([0.3, -0.4, *(0.0 for e in effects for _ in e.parameters)])
    return fit(problem, Hypothesis(tuple(effects), of_all=problem.model.base), start)


def fits_of(problem: Problem, *sets: tuple[Effect, ...]) -> dict[tuple[str, ...], Fit]:
    every = [fitted(problem, *effects) for effects in ((), *sets)]
    return {one.ids: one for one in every}


def design(runs: Sequence[SimulatorRun], *names: str) -> Array:
    """(samples, parameters): a column of ones, x, and the shape of every cause."""
    x = np.concatenate([run.columns["x"] for run in runs])
    return np.column_stack([np.ones(len(x)), x, *(SHAPES[name](x) for name in names)])


def measured(runs: Sequence[SimulatorRun]) -> Array:
    return np.concatenate([run.columns["y"] for run in runs])


def solved(columns: Array, values: Array) -> Array:
    return np.linalg.lstsq(columns, values, rcond=None)[0]


def left_of(columns: Array, values: Array) -> Array:
    """What a least-squares fit leaves of values."""
    return values - columns @ solved(columns, values)


def one_sided(effect: Effect) -> Effect:
    return replace(effect, parameters=(replace(effect.parameters[0], low=0.0),))


def search_with(fits: Mapping[tuple[str, ...], Fit]) -> Search:
    """Return a search that holds these fits, the base among them."""
    search = Search(fits[()], CAUSES)
    for fit_of_set in fits.values():
        search.store(fit_of_set)
    return search
