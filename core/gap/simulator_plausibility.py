"""Mistakes in recordings of any mechanism: a dead channel, a unit of time, one run against the others.

What needs the simulator is looked for only where the base leaves a large part of a channel: a run
is held against what all others say of it, and against the same run repaired.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.gap.coordinates import start_coordinates
from softcal.core.gap.data_mistake import DataMistake, apart, numbers, of_sign, unit_of
from softcal.core.gap.fit import Fit, fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.problem import Hypothesis
from softcal.core.gap.simulator import Simulator, SimulatorRun
from softcal.core.gap.simulator_problem import SimulatorProblem, rough_problem, runs_of
from softcal.core.gap.start import best_start
from softcal.core.recording import Array
from softcal.core.words.reason import Reason, reason

CONFIG = METHOD.mistake

FACTORS: Mapping[str, float] = {
    "inch": 25.4,
    "kgf": 9.80665,
    "lbf": 4.44822,
    "min": 60.0,
    "degree": float(np.pi / 180.0),
    "rad": float(180.0 / np.pi),
    "1000 x the unit": 1e3,
    "the unit / 1000": 1e-3,
    "1000000 x the unit": 1e6,
    "the unit / 1000000": 1e-6,
    "10 x the unit": 10.0,
    "the unit / 10": 0.1,
}
"""What values in these must be multiplied by."""


def shown(simulator: Simulator, case: Case) -> tuple[DataMistake, ...]:
    """Return the mistakes that columns show by themselves: another unit of time, a dead channel."""
    runs, number, found = runs_of(case), numbers(case), []
    steps_s = np.array([float(np.median(np.diff(run.t_s))) for run in runs])
    for k, step_s in enumerate(steps_s) if len(runs) >= CONFIG.fewest_runs else ():
        others = np.delete(steps_s, k)
        ratio = float(np.median(others) / step_s)
        is_apart = max(ratio, 1.0 / ratio) > CONFIG.step_apart and others.max() < CONFIG.same_factor * others.min()
        if is_apart and unit_of(ratio, FACTORS):
            found.append(apart("t_s", number[k], ratio, FACTORS))
    for channel in simulator.channels:
        dead = tuple(n for n, run in zip(number, runs, strict=True) if np.ptp(run.columns[channel]) == 0.0)
        if dead:
            at = () if len(dead) == len(runs) else dead
            evidence = reason("data.dead", channel=channel)
            found.append(DataMistake("constant", channel, at, None, evidence, Reason("data.repair.dead")))
    return tuple(found)


def cut_off(simulator: Simulator, case: Case) -> tuple[DataMistake, ...]:
    """Return channels that may be cut off at an end: questions, for a mechanism may do so."""
    found = []
    for run, number in zip(runs_of(case), numbers(case), strict=True):
        for channel in simulator.channels:
            values = run.columns[channel]
            for end in (float(values.max()), float(values.min())):
                # A channel that stands on the steps of an encoder repeats its values everywhere.
                repeats = float(np.mean(np.diff(values[values != end]) == 0.0))
                count = int(np.sum(values == end))
                # Every run has one largest sample, however short it is.
                if repeats <= CONFIG.resting and count > max(1.0, CONFIG.stuck * len(values)):
                    evidence = reason("data.cut_off", channel=channel, level=end, count=count)
                    repair = reason("data.repair.range", channel=channel)
                    found.append(DataMistake("out_of_range", channel, (number,), None, evidence, repair))
    return tuple(found)


@dataclass(frozen=True)
class MistakeTest:
    """A mistake that the simulator points at, and how well it stands against what else could be.

    Args:
        left: share of the worst channel that the base leaves once the mistake is repaired.
        left_unrepaired, left_by_causes: what the base leaves as recorded, and at best with one of its candidates.
    """

    mistake: DataMistake
    left: float
    left_unrepaired: float
    left_by_causes: float

    @property
    def is_enough(self) -> bool:
        """Whether the repair takes most of what the base leaves."""
        return self.left <= CONFIG.repaired * self.left_unrepaired

    @property
    def is_alone(self) -> bool:
        """Whether no candidate does as well."""
        return self.left < self.left_by_causes

    @property
    def is_claim(self) -> bool:
        """Whether nothing is to be diagnosed before it is repaired; else it is a question at most."""
        return self.is_enough and self.is_alone


def against_others(base: Fit) -> MistakeTest | None:
    """Return what the simulator shows: one run in another unit or sign, exchanged columns; None where nothing."""
    problem = base.problem
    if not isinstance(problem, SimulatorProblem) or _agreement(base) > CONFIG.good:
        return None
    suspected = _exchanged(problem) or _of_one_run(problem)
    if suspected is None:
        return None
    mistake, left = suspected
    starts = [
        (
            Hypothesis((cause,), of_all=problem.of.base),
            start_coordinates([cause], [[p.usual for p in cause.parameters]]),
        )
        for cause in problem.of.candidates
    ]
    fits = [fit(problem, one, np.concatenate([base.coordinates, start]), steps=20) for one, start in starts]
    by_causes = min(1.0 - _agreement(found) for found in fits)
    test = MistakeTest(mistake, left, 1.0 - _agreement(base), by_causes)
    return test if test.is_enough or test.is_alone else None


def _exchanged(problem: SimulatorProblem) -> tuple[DataMistake, float] | None:
    """Return columns that agree with the base once they are exchanged, and what it leaves then."""
    for pair in combinations((*problem.of.inputs, *problem.of.channels), 2):
        one, other = pair
        runs = [
            replace(run, columns={**run.columns, one: run.columns[other], other: run.columns[one]})
            for run in runs_of(problem.case)
        ]
        if (share := _agreement(_fitted(problem, runs))) > CONFIG.good:
            evidence = reason("data.swapped", one=one, other=other)
            repair = reason("data.repair.swap", one=one, other=other)
            return DataMistake("swapped_columns", "+".join(pair), (), None, evidence, repair), 1.0 - share
    return None


def _of_one_run(problem: SimulatorProblem) -> tuple[DataMistake, float] | None:
    """Return one run in another unit or sign than all others, and what the base leaves once it is repaired."""
    runs, number = runs_of(problem.case), numbers(problem.case)
    for k, run in enumerate(runs) if len(runs) >= CONFIG.fewest_runs else ():
        others = _fitted(problem, runs[:k] + runs[k + 1 :])
        if (share := _agreement(others)) >= CONFIG.good:
            for mistake, repaired in _repaired(problem.of, others, run, number[k]):
                return mistake, 1.0 - min(share, repaired)
    return None


def _agreement(found: Fit) -> float:
    problem, predicted = found.problem, found.predicted
    return min(_share(problem.measured[b.place], predicted[b.place]) for b in problem.blocks)


def _share(measured: Array, predicted: Array) -> float:
    spread = float(np.sum((measured - measured.mean()) ** 2))
    left = float(np.sum((measured - predicted) ** 2))
    return 1.0 - left / max(spread, 1e-300)


def _fitted(problem: SimulatorProblem, runs: Sequence[SimulatorRun]) -> Fit:
    again = rough_problem(problem.of, Case(problem.case.serial, tuple(runs)))
    return best_start(again, Hypothesis(of_all=problem.of.base), scattering=16, tried=2, steps=20)


def _repaired(simulator: Simulator, others: Fit, run: SimulatorRun, number: int) -> Iterator[tuple[DataMistake, float]]:
    said = simulator.named(others.hypothesis, others.coordinates)
    gives = simulator(run.columns, said, run.name)
    off = [c for c in simulator.channels if _share(run.columns[c], gives[c]) < CONFIG.bad]
    for channel in off if len(off) == 1 else ():
        slope = float(np.polyfit(gives[channel], run.columns[channel], 1)[0]) if np.ptp(gives[channel]) > 0.0 else 0.0
        is_apart = slope != 0.0 and (slope < 0.0 or abs(np.log(slope)) > np.log(CONFIG.apart))
        if is_apart and (share := _share(run.columns[channel] / slope, gives[channel])) > CONFIG.good:
            yield _of_factor(channel, number, 1.0 / slope), share
    for name in simulator.inputs if off else ():
        for factor in (-1.0, *FACTORS.values()):
            moved = simulator({**run.columns, name: factor * run.columns[name]}, said, run.name)
            if (share := min(_share(run.columns[c], moved[c]) for c in simulator.channels)) > CONFIG.good:
                yield _of_factor(name, number, factor), share


def _of_factor(name: str, number: int, factor: float) -> DataMistake:
    if abs(np.log(abs(factor))) < np.log(CONFIG.same_factor) and factor < 0.0:
        return of_sign(name, (number,), reason("data.run.apart", channel=name, ratio=1.0 / factor))
    return apart(name, number, factor, FACTORS)
