"""Whether a simulator can be fitted at all, by a few calls, and mistakes in recordings of any mechanism.

What cannot be fitted is refused in one line. Mistakes: a dead channel, a unit of time, one run against the others.
What needs the simulator is looked for only where the base leaves a large part of a channel: a run
is held against what all others say of it, and against the same run repaired.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import Case, DataMistake, apart, numbers, of_sign, unit_of
from softcal.core.gap.coordinates import fit_scale, from_fit, start_coordinates, to_fit
from softcal.core.gap.fit import DIFFERENCE, Fit, fit
from softcal.core.gap.method import MistakeConfig
from softcal.core.gap.problem import Hypothesis
from softcal.core.gap.simulator import Columns, Simulator, SimulatorFailed, SimulatorRun, runs_of
from softcal.core.recording import Array
from softcal.core.twin.effects import Parameter
from softcal.core.words.reason import Reason, reason

if TYPE_CHECKING:
    from softcal.core.gap.simulator_model import SimulatorModel


REPEATABLE = 1e-7
"""Largest difference of equal calls, as a share of a channel's span: a tenth of what derivatives bear."""

LONG_STEP = 100.0
"""Steps of the fit in the longer of two difference quotients that are compared."""

MOVED, ROUNDED = 1e-3, 0.5
"""Share of the largest change from which a sample is compared; share of samples and changes that rounding spoils."""


class _ReadNames(dict[str, float]):
    """Parameters that remember which of them were read by name; reading all at once is told apart."""

    def __init__(self, values: Mapping[str, float]) -> None:
        super().__init__(values)
        self.names: set[str] = set()
        self.is_iterated = False

    def __getitem__(self, name: str) -> float:
        # A copy fetches every value by its name, one after another.
        if not self.is_iterated:
            self.names.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self.names.add(name)
        return super().get(name, default)

    # Without these `**p` and `dict(p)` copy the values past both methods above.
    def __iter__(self) -> Iterator[str]:
        self.is_iterated = True
        return super().__iter__()

    def keys(self) -> Any:
        self.is_iterated = True
        return super().keys()

    def values(self) -> Any:
        self.is_iterated = True
        return super().values()

    def items(self) -> Any:
        self.is_iterated = True
        return super().items()


class _Calls:
    """A simulator on the runs of a case, every call with copies of its inputs and parameters."""

    def __init__(self, simulator: Simulator, runs: Sequence[SimulatorRun]) -> None:
        self.simulator, self._runs = simulator, runs
        self.names: set[str] = set()
        self.is_iterated = False
        # Watched where the user's own code reads: what a simulator does before that reads every name.
        self._watched = replace(simulator, run=self._watch)
        self._given: Mapping[str, float] = {}
        self._read = _ReadNames({})

    def first(self, values: Mapping[str, float]) -> Array:
        """Return the channels of the first run, one after another."""
        return self._run(self._runs[0], values)

    def every(self, values: Mapping[str, float]) -> Array:
        """Return the channels of all runs, one after another."""
        return np.concatenate([self._run(run, values) for run in self._runs])

    def excited(self, values: Mapping[str, float]) -> Array:
        """Return the channels of the first run where every input swings about what was recorded."""
        t_s = self._runs[0].columns["t_s"]
        phase = 2.0 * np.pi * (t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]), 1e-300)
        swings = {}
        for k, name in enumerate(self.simulator.inputs, start=1):
            column = self._runs[0].columns[name]
            swings[name] = column + (float(np.max(np.abs(column))) or 1.0) * np.sin((2 * k + 1) * phase)
        return self._run(self._runs[0], values, swings)

    def _run(self, run: SimulatorRun, values: Mapping[str, float], swings: Columns | None = None) -> Array:
        recorded = {name: run.columns[name] for name in ("t_s", *self.simulator.inputs)} | dict(swings or {})
        inputs = {name: column.copy() for name, column in recorded.items()}
        channels = self._watched(inputs, values)
        self.names |= self._read.names
        self.is_iterated |= self._read.is_iterated
        self._refuse_written(inputs, recorded, "copy its inputs before changing them")
        changed = {name: np.asarray(dict.get(self._read, name)) for name in self._given}
        self._refuse_written(changed, {name: np.asarray(v) for name, v in self._given.items()}, "copy the parameters")
        return np.concatenate([channels[name] for name in self.simulator.channels])

    def _watch(self, inputs: Columns, parameters: Mapping[str, float]) -> Columns:
        self._given, self._read = dict(parameters), _ReadNames(parameters)
        return self.simulator.run(inputs, self._read)

    def _refuse_written(self, after: Columns, before: Columns, cure: str) -> None:
        for name, values in before.items():
            if not np.array_equal(after[name], values):
                raise refused(self.simulator, f"writes into {name}; {cure}")


def refused(simulator: Simulator, why: str) -> InputError:
    """Return the refusal of a simulator that cannot be fitted."""
    return InputError(f"simulator {simulator.name}: {why}; nothing was fitted")


def check_calls(simulator: Simulator, runs: Sequence[SimulatorRun]) -> None:
    """Call a simulator a few times, and refuse one whose answers a fit could not use.

    A simulator that fails at its usual values is left to the fit, which goes elsewhere.

    Raises:
        InputError: equal calls differ, an input is written into, channels are rounded, or a parameter is never read.
    """
    calls, usual = _Calls(simulator, runs), {p.name: p.usual for p in _of_base(simulator)}
    off, on = usual | simulator.neutral_values, usual | {name: p.usual for name, p in _of_candidates(simulator)}
    try:
        plain = calls.first(off)
        _refuse_differing(simulator, plain, calls.first(off), "called twice with equal arguments")
        with_causes = calls.first(on)
        after = "called again after a call with other parameters"
        _refuse_differing(simulator, plain, calls.first(off), after)
        near, far = (calls.first(_moved(simulator, on, steps)) for steps in (1.0, LONG_STEP))
    except SimulatorFailed:
        return
    if _is_rounded(near - with_causes, far - with_causes):
        raise refused(
            simulator,
            "a small change of its parameters does not show as a hundredth of a larger one: it rounds its channels, "
            "or is not smooth; give them in full precision",
        )
    _refuse_unread(calls, on)


def _of_base(simulator: Simulator) -> tuple[Parameter, ...]:
    return (*simulator.base, *simulator.run_parameters)


def _of_candidates(simulator: Simulator) -> list[tuple[str, Parameter]]:
    return [(f"{effect.id}.{p.name}", p) for effect in simulator.candidates for p in effect.parameters]


def _refuse_differing(simulator: Simulator, one: Array, other: Array, when: str) -> None:
    apart = float(np.max(np.abs(one - other)))
    if apart > REPEATABLE * max(float(np.ptp(one)), float(np.max(np.abs(one)))):
        raise refused(
            simulator, f"{when} its channels differ by {apart:.3g}; fix the seed of its noise, and start anew each time"
        )


def _moved(simulator: Simulator, values: Mapping[str, float], steps: float) -> dict[str, float]:
    """Return the parameters, each moved by so many steps of the fit's difference quotients."""
    out = {}
    for name, p in (*((p.name, p) for p in _of_base(simulator)), *_of_candidates(simulator)):
        x, step = to_fit(p, values[name]), steps * DIFFERENCE * fit_scale(p)
        out[name] = (
            values[name]
            if p.is_fixed
            else from_fit(p, x + step if x + step <= max(to_fit(p, p.low), to_fit(p, p.high)) else x - step)
        )
    return out


def _is_rounded(near: Array, far: Array) -> bool:
    """Whether most samples that a long step moves are not moved in proportion by a short one."""
    moves = np.abs(far) > MOVED * np.max(np.abs(far), initial=0.0)
    is_apart = np.abs(LONG_STEP * near - far)[moves] > ROUNDED * np.abs(far)[moves]
    return bool(moves.any() and np.mean(is_apart) > ROUNDED)


def _refuse_unread(calls: _Calls, values: Mapping[str, float]) -> None:
    """Refuse a parameter that is never read, or that is copied with all others and never changes a channel.

    What these runs alone do not excite is left to the diagnosis, which says that they cannot tell it.
    """
    simulator = calls.simulator
    for name, p in (*((p.name, p) for p in _of_base(simulator)), *_of_candidates(simulator)):
        if name in calls.names or p.is_fixed:
            continue
        makes = (calls.every, calls.excited) if calls.is_iterated else ()
        if not any(_changes_something(make, values, name, p) for make in makes):
            raise refused(
                simulator,
                f"parameter {name} is never read, or changes no channel; check how the simulator spells it, or leave "
                "it out",
            )


def _changes_something(
    make: Callable[[Mapping[str, float]], Array], values: Mapping[str, float], name: str, parameter: Parameter
) -> bool:
    ends = [end for end in (parameter.low, parameter.high) if end != values[name]]
    try:
        usual = make(values)
        return any(not np.array_equal(usual, make({**values, name: end})) for end in ends)
    except SimulatorFailed:
        return True


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


def shown(simulator: Simulator, case: Case, config: MistakeConfig) -> tuple[DataMistake, ...]:
    """Return the mistakes that columns show by themselves: another unit of time, a dead channel."""
    runs, number, found = runs_of(case), numbers(case), []
    steps_s = np.array([float(np.median(np.diff(run.t_s))) for run in runs])
    for k, step_s in enumerate(steps_s) if len(runs) >= config.fewest_runs else ():
        others = np.delete(steps_s, k)
        ratio = float(np.median(others) / step_s)
        is_apart = max(ratio, 1.0 / ratio) > config.step_apart and others.max() < config.same_factor * others.min()
        if is_apart and unit_of(ratio, FACTORS, config.same_factor):
            found.append(apart("t_s", number[k], ratio, FACTORS, config.same_factor))
    for channel in simulator.channels:
        dead = tuple(n for n, run in zip(number, runs, strict=True) if np.ptp(run.columns[channel]) == 0.0)
        if dead:
            at = () if len(dead) == len(runs) else dead
            evidence = reason("data.dead", channel=channel)
            found.append(DataMistake("constant", channel, at, None, evidence, Reason("data.repair.dead")))
    return tuple(found)


def cut_off(simulator: Simulator, case: Case, config: MistakeConfig) -> tuple[DataMistake, ...]:
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
                if repeats <= config.resting and count > max(1.0, config.stuck * len(values)):
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
        repaired: share of what the base leaves that may be left once a mistake is repaired.
    """

    mistake: DataMistake
    left: float
    left_unrepaired: float
    left_by_causes: float
    repaired: float

    @property
    def is_enough(self) -> bool:
        """Whether the repair takes most of what the base leaves."""
        return self.left <= self.repaired * self.left_unrepaired

    @property
    def is_alone(self) -> bool:
        """Whether no candidate does as well."""
        return self.left < self.left_by_causes

    @property
    def is_claim(self) -> bool:
        """Whether nothing is to be diagnosed before it is repaired; else it is a question at most."""
        return self.is_enough and self.is_alone


def against_others(model: "SimulatorModel", base: Fit) -> MistakeTest | None:
    """Return what the simulator shows: one run in another unit or sign, exchanged columns; None where nothing."""
    problem, config = base.problem, model.method.mistake
    if _agreement(base) > config.good:
        return None
    suspected = _exchanged(model, problem.case) or _of_one_run(model, problem.case)
    if suspected is None:
        return None
    mistake, left = suspected
    starts = [
        (
            Hypothesis((cause,), of_all=model.base),
            start_coordinates([cause], [[p.usual for p in cause.parameters]]),
        )
        for cause in model.candidates
    ]
    fits = [fit(problem, one, np.concatenate([base.coordinates, start]), steps=20) for one, start in starts]
    by_causes = min(1.0 - _agreement(found) for found in fits)
    test = MistakeTest(mistake, left, 1.0 - _agreement(base), by_causes, config.repaired)
    return test if test.is_enough or test.is_alone else None


def _exchanged(model: "SimulatorModel", case: Case) -> tuple[DataMistake, float] | None:
    """Return columns that agree with the base once they are exchanged, and what it leaves then."""
    for pair in combinations((*model.simulator.inputs, *model.simulator.channels), 2):
        one, other = pair
        runs = [
            replace(run, columns={**run.columns, one: run.columns[other], other: run.columns[one]})
            for run in runs_of(case)
        ]
        if (share := _agreement(model.rough_fit(Case(case.serial, tuple(runs))))) > model.method.mistake.good:
            evidence = reason("data.swapped", one=one, other=other)
            repair = reason("data.repair.swap", one=one, other=other)
            return DataMistake("swapped_columns", "+".join(pair), (), None, evidence, repair), 1.0 - share
    return None


def _of_one_run(model: "SimulatorModel", case: Case) -> tuple[DataMistake, float] | None:
    """Return one run in another unit or sign than all others, and what the base leaves once it is repaired."""
    runs, number, config = runs_of(case), numbers(case), model.method.mistake
    for k, run in enumerate(runs) if len(runs) >= config.fewest_runs else ():
        others = model.rough_fit(Case(case.serial, tuple(runs[:k] + runs[k + 1 :])))
        if (share := _agreement(others)) >= config.good:
            for mistake, repaired in _repaired(model, others, run, number[k]):
                return mistake, 1.0 - min(share, repaired)
    return None


def _agreement(found: Fit) -> float:
    problem, predicted = found.problem, found.predicted
    return min(_share(problem.measured[b.place], predicted[b.place]) for b in problem.blocks)


def _share(measured: Array, predicted: Array) -> float:
    spread = float(np.sum((measured - measured.mean()) ** 2))
    left = float(np.sum((measured - predicted) ** 2))
    return 1.0 - left / max(spread, 1e-300)


def _repaired(
    model: "SimulatorModel", others: Fit, run: SimulatorRun, number: int
) -> Iterator[tuple[DataMistake, float]]:
    simulator, config = model.simulator, model.method.mistake
    said = simulator.named(others.hypothesis, others.coordinates)
    gives = simulator(run.columns, said, run.name)
    off = [c for c in simulator.channels if _share(run.columns[c], gives[c]) < config.bad]
    for channel in off if len(off) == 1 else ():
        slope = float(np.polyfit(gives[channel], run.columns[channel], 1)[0]) if np.ptp(gives[channel]) > 0.0 else 0.0
        is_apart = slope != 0.0 and (slope < 0.0 or abs(np.log(slope)) > np.log(config.apart))
        if is_apart and (share := _share(run.columns[channel] / slope, gives[channel])) > config.good:
            yield _of_factor(channel, number, 1.0 / slope, config.same_factor), share
    for name in simulator.inputs if off else ():
        for factor in (-1.0, *FACTORS.values()):
            moved = simulator({**run.columns, name: factor * run.columns[name]}, said, run.name)
            if (share := min(_share(run.columns[c], moved[c]) for c in simulator.channels)) > config.good:
                yield _of_factor(name, number, factor, config.same_factor), share


def _of_factor(name: str, number: int, factor: float, same: float) -> DataMistake:
    if abs(np.log(abs(factor))) < np.log(same) and factor < 0.0:
        return of_sign(name, (number,), reason("data.run.apart", channel=name, ratio=1.0 / factor))
    return apart(name, number, factor, FACTORS, same)
