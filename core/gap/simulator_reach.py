"""What recordings of a mechanism show: mistakes; what a residual follows, and where; terms that describe it.

A term is a number times what of an input or a channel it follows. Mistakes: a dead channel, a unit of time, one run
against the others. What needs the simulator is looked for only where the base leaves a large part of a channel: a run
is held against what all others say of it, and against the same run repaired.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from softcal.core.errors import InputError
from softcal.core.gap.case import (
    SHIFTED,
    Case,
    DataMistake,
    Run,
    apart,
    numbers,
    of_samples,
    of_shifted,
    of_sign,
    unit_of,
)
from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import start_coordinates
from softcal.core.gap.method import GapMethod, MistakeConfig, NoiseFloorConfig
from softcal.core.gap.model import Block, Fit
from softcal.core.gap.simulator import Columns, ForeignStep, Simulator, SimulatorFailed, SimulatorRun, runs_of
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Hook, Parameter
from softcal.core.twin.signals import low_pass

MEMORIES = (0.01, 0.03, 0.1, 0.3)
"""Fading times of the memories that terms may follow, as shares of the longest run."""

BLUNT = 0.05
"""Share of the usual rate within which a direction turns."""

TIME = "t"
LEVEL, SQUARE, CUBE, RATE, WAY, REMEMBERED = "", "²", "³", "rate of ", "way of ", "memory of "
SIZED_WAY, SIZED_TIME = "size·way of ", "t·"
"""What of a signal a term may follow; a size of 1 is the farthest recorded from the middle."""


@dataclass(frozen=True)
class SimulatorTerm:
    """channel += coefficient · variable.

    Args:
        kind: what of the signal it follows.
        signal: an input or a channel, empty for the time.
        middle, half: what a signal of 0 and of 1 stand for: from the middle to the farthest recorded.
        per_s: the usual rate of change of the signal so counted, 1/s.
        span: the range of the channel, for the size of a step.
    """

    place: str
    kind: str
    signal: str
    coefficient: float
    middle: float
    half: float
    per_s: float
    tau_s: float
    span: float

    @property
    def variable(self) -> str:
        """What it follows, in words."""
        if self.kind == TIME:
            return TIME
        if self.kind in (SQUARE, CUBE):
            return f"{self.signal}{self.kind}"
        return f"{self.kind}{self.signal}" + (f" over {self.tau_s:.2g} s" if self.kind == REMEMBERED else "")

    @property
    def unit(self) -> str:
        """Unit of the coefficient."""
        unit = self.place.rpartition("_")[2] if "_" in self.place else ""
        return f"{unit or 1}/s" if self.kind in (TIME, SIZED_TIME) else unit

    @property
    def formula(self) -> str:
        """The term in one line, as a report shows it."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.place} += {self.coefficient:.3g}{unit} · {self.variable}"

    @cached_property
    def effect(self) -> Effect:
        """The term as an effect; its coefficient is its one parameter."""
        usual = 0.01 * self.span
        size = Parameter("coefficient", self.unit, -1e3 * self.span, 1e3 * self.span, usual, neutral=0.0)
        name = f"{self.place} += {self.variable}"
        return Effect(name, self.place, Hook.READING, "", "empirical", (size,), ForeignStep(self))

    def values(self, t_s: Array, columns: Columns) -> Array:
        """Return the variable, (n,), from the time in s and the inputs and channels of a run."""
        if self.kind == TIME:
            return np.asarray(t_s - t_s[0])
        x = (np.asarray(columns[self.signal], dtype=np.float64) - self.middle) / self.half
        if self.kind in (LEVEL, SQUARE, CUBE):
            return np.asarray(x ** (1 + (LEVEL, SQUARE, CUBE).index(self.kind)))
        if self.kind == SIZED_TIME:
            return np.asarray(x * (t_s - t_s[0]))
        if self.kind == REMEMBERED:
            return low_pass(x, np.diff(t_s, prepend=t_s[0]), self.tau_s, np.zeros(2))
        rate = np.gradient(x, t_s) / self.per_s
        way = np.tanh(rate / BLUNT)
        return np.asarray({RATE: rate, WAY: way, SIZED_WAY: x * way}[self.kind])

    def record(self) -> dict[str, object]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def terms_of(simulator: Simulator, result: Fit) -> Iterator[SimulatorTerm]:
    """Give every term that may be tried on what a simulator leaves, without its coefficient."""
    problem, runs = result.problem, result.problem.case.runs
    longest_s = max(float(run.elapsed_s[-1]) for run in runs)
    signals = _signals(simulator, result)
    for channel in simulator.channels:
        span = max(float(np.ptp(problem.measured[b.rows])) for b in problem.blocks_of(channel))
        yield SimulatorTerm(channel, TIME, "", 0.0, 0.0, 1.0, 1.0, 0.0, span)
        for name, parts in signals.items():
            low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
            half = 0.5 * (high - low)
            if half <= 0.0:
                continue
            rates = [np.abs(np.gradient(p, run.t_s)) / half for p, run in zip(parts, runs, strict=True)]
            per_s = max(float(np.median(np.concatenate(rates))), 1e-3 / longest_s)
            one = SimulatorTerm(channel, LEVEL, name, 0.0, 0.5 * (low + high), half, per_s, 0.0, span)
            yield from (replace(one, kind=kind) for kind in (LEVEL, SQUARE, CUBE, RATE, WAY, SIZED_WAY, SIZED_TIME))
            yield from (replace(one, kind=REMEMBERED, tau_s=share * longest_s) for share in MEMORIES)


def _signals(simulator: Simulator, result: Fit) -> dict[str, list[Array]]:
    """Return by name, run by run, inputs as they were recorded and channels as they are predicted."""
    problem, count = result.problem, len(result.problem.case.runs)
    inputs = {name: [problem.recorded(k, name) for k in range(count)] for name in simulator.inputs}
    return inputs | {c: [result.predicted[b.rows] for b in problem.blocks_of(c)] for c in simulator.channels}


def with_terms(simulator: Simulator, terms: Sequence[SimulatorTerm]) -> Simulator:
    """Return a simulator that adds these terms to its channels."""

    def run(inputs: Columns, parameters: Mapping[str, float]) -> Columns:
        outputs = dict(simulator.run(inputs, parameters))
        out = {name: np.array(values, dtype=np.float64) for name, values in outputs.items()}
        # What is not compared was not described.
        on = slice(simulator.first_compared(np.asarray(inputs["t_s"])), None)
        columns = {name: np.asarray(values)[on] for name, values in {**inputs, **outputs}.items()}
        for term in terms:
            out[term.place][on] += term.coefficient * term.values(columns["t_s"], columns)
        return out

    return replace(simulator, run=run)


def term_of(record: object, source: str) -> SimulatorTerm:
    """Return a term as a file has it.

    Raises:
        InputError: something in it is missing or is no number.
    """
    names = SimulatorTerm.__dataclass_fields__
    texts = ("place", "kind", "signal")
    if not isinstance(record, dict) or set(record) != set(names):
        raise InputError(f"{source}: a term has {', '.join(names)}; {record!r} was found")
    numbers = {name: record[name] for name in names if name not in texts}
    if not all(isinstance(v, int | float) and np.isfinite(v) for v in numbers.values()):
        raise InputError(f"{source}: a term has {numbers}; finite numbers were expected")
    channel, kind, signal = (str(record[name]) for name in texts)
    return SimulatorTerm(channel, kind, signal, **{name: float(v) for name, v in numbers.items()})


def columns_of(signal: Array, run: Run, times: float, config: NoiseFloorConfig) -> dict[str, list[Array]]:
    """Return what a residual may follow of a signal within −1 and 1: groups of (n,) columns.

    Args:
        times: by what this rig is slower than a common one; memories fade by so much more slowly.
    """
    rate = np.gradient(signal, run.t_s)
    way, quick = np.sign(rate), np.gradient(rate, run.t_s)
    memories = [low_pass(signal, run.step_s, times * tau_s, np.zeros(2)) for tau_s in config.memory_s]
    return {
        "level": _hats(signal, config.hats),
        "way": [way, signal * way, signal**2 * way],
        "rate": [rate, np.abs(rate), rate * np.abs(rate), signal * rate, quick],
        "memory": [*memories, *(signal * remembered for remembered in memories)],
        "time": [run.elapsed_s, signal * run.elapsed_s],
    }


def _hats(signal: Array, count: int) -> list[Array]:
    """Return how near a signal within −1 and 1 is to each of several levels: what is linear between them."""
    centres = [2.0 * k / (count - 1) - 1.0 for k in range(count)]
    return [np.maximum(0.0, 1.0 - 0.5 * (count - 1) * np.abs(signal - centre)) for centre in centres]


def _within(parts: Sequence[Array]) -> list[Array]:
    """Return a signal, run by run, within −1 and 1 over all runs."""
    low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
    return [(2.0 * part - low - high) / max(high - low, 1e-300) for part in parts]


def states_of(simulator: Simulator, result: Fit) -> list[Array]:
    """Return (samples,) of what the size of a cause may depend: levels and sizes of every signal, and the time."""
    problem, hats = result.problem, result.problem.method.noise_test.hats
    runs, out = [problem.case.runs[block.run] for block in problem.blocks], list[Array]()
    longest_s = max(float(run.elapsed_s[-1]) for run in runs)
    of_runs = [*map(_within, _signals(simulator, result).values())]
    for scaled in of_runs:
        x = np.concatenate([scaled[block.run] for block in problem.blocks])
        out += [*_hats(x, hats), np.abs(x), x**2]
    time = np.concatenate([run.elapsed_s for run in runs]) / longest_s
    return [*out, time, time**2]


def explanatory_signals(simulator: Simulator, result: Fit, channel: str) -> list[Sequence[Array]]:
    """Return groups of (samples,) columns of inputs and channels that a residual may follow."""
    problem, out = result.problem, list[Sequence[Array]]()
    times = problem.model.times_slower(problem.case)
    runs, blocks = problem.case.runs, problem.blocks_of(channel)
    for parts in _signals(simulator, result).values():
        scaled = _within(parts)
        each = [columns_of(scaled[b.run], runs[b.run], times, problem.method.noise_test) for b in blocks]
        for kind in each[0]:
            rows = np.zeros((len(each[0][kind]), len(result.predicted)))
            for block, columns in zip(blocks, each, strict=True):
                rows[:, block.rows] = columns[kind]
            out.append(list(rows))
    return out


def shifted(values: Array, t_s: Array, delay_s: float, linear: float) -> Array:
    """Return (3, n) a channel some time later, its rate of change, and straight lines less a curve.

    The curve is the cubic spline through the samples, its third derivative continuous at both ends.

    Args:
        values: (n,) with n of 4 and more, at the times t_s.
        linear: how far it goes by straight lines from sample to sample; by a curve elsewhere.
    """
    curve, rise = CubicSpline(t_s, values), np.diff(values) / np.diff(t_s)
    at_s = np.clip(t_s - delay_s, t_s[0], t_s[-1])
    before = np.minimum(np.searchsorted(t_s, at_s, side="right") - 1, len(rise) - 1)
    line = values[before] + (at_s - t_s[before]) * rise[before]
    apart = line - curve(at_s)
    rate = rise[before] + (1.0 - linear) * (curve(at_s, 1) - rise[before])
    return np.array([line - (1.0 - linear) * apart, np.where(t_s - delay_s > t_s[0], rate, 0.0), apart])


def conditions_of(result: Fit, blocks: list[Block]) -> dict[Reason, Array]:
    """Return which samples of blocks, (n,), lie in conditions in which a gap may stand out."""
    runs = [result.problem.case.runs[b.run] for b in blocks]
    predicted = [result.predicted[b.rows] for b in blocks]
    slope = np.concatenate([np.gradient(p, r.t_s) for p, r in zip(predicted, runs, strict=True)])
    level, part = np.concatenate(predicted), np.concatenate([r.elapsed_s / r.elapsed_s[-1] for r in runs])
    low, high = np.quantile(level, (0.2, 0.8))
    calm, quick = np.quantile(np.abs(slope), (0.3, 0.7))
    of_run = np.concatenate([np.full(len(r), k) for k, r in enumerate(runs)])
    out = {
        Reason("gap.regime.low_level"): level < low,
        Reason("gap.regime.high_level"): level > high,
        Reason("gap.regime.rising"): slope > quick,
        Reason("gap.regime.falling"): slope < -quick,
        Reason("gap.regime.fast_change"): np.abs(slope) > quick,
        Reason("gap.regime.still"): np.abs(slope) < calm,
        Reason("gap.regime.start"): part < 0.25,
        Reason("gap.regime.end"): part > 0.75,
    }
    return out | {reason("gap.regime.run", run=run.name): of_run == k for k, run in enumerate(runs)}


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


def recording_mistakes(simulator: Simulator, case: Case, config: MistakeConfig) -> tuple[DataMistake, ...]:
    """Return the mistakes that columns show by themselves: another unit of time, a dead channel."""
    runs, number, result = runs_of(case), numbers(case), []
    steps_s = np.array([float(np.median(np.diff(run.t_s))) for run in runs])
    for k, step_s in enumerate(steps_s) if len(runs) >= config.fewest_runs else ():
        others = np.delete(steps_s, k)
        ratio = float(np.median(others) / step_s)
        is_apart = max(ratio, 1.0 / ratio) > config.step_apart and others.max() < config.same_factor * others.min()
        if is_apart and unit_of(ratio, FACTORS, config.same_factor):
            result.append(apart("t_s", number[k], ratio, FACTORS, config.same_factor))
    for channel in simulator.channels:
        dead = tuple(n for n, run in zip(number, runs, strict=True) if np.ptp(run.columns[channel]) == 0.0)
        if dead:
            at = () if len(dead) == len(runs) else dead
            evidence = reason("data.dead", channel=channel)
            result.append(DataMistake("constant", channel, at, None, evidence, Reason("data.repair.dead")))
    return tuple(result)


def cut_off(simulator: Simulator, case: Case, config: MistakeConfig) -> tuple[DataMistake, ...]:
    """Return channels that may be cut off at an end: questions, for a mechanism may do so."""
    result = []
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
                    result.append(DataMistake("out_of_range", channel, (number,), None, evidence, repair))
    return tuple(result)


def find_excess_noise(
    simulator: Simulator, scatter_of: Mapping[str, float], config: MistakeConfig
) -> tuple[DataMistake, ...]:
    """Return channels that scatter far more than the noise that is stated of them: questions."""
    result = []
    for channel, scatter in scatter_of.items():
        stated_noise = simulator.noise.get(channel, np.inf)
        if scatter > config.louder * stated_noise:
            evidence = reason("data.louder", channel=channel, scatter=scatter, stated=stated_noise)
            result.append(
                DataMistake("noise", channel, (), None, evidence, reason("data.repair.louder", channel=channel))
            )
    return tuple(result)


class RoughModel(Protocol):
    """A simulator whose base is fitted quickly, for a question that is put to several cases."""

    @property
    def simulator(self) -> Simulator: ...

    @property
    def method(self) -> GapMethod: ...

    def rough_fit(self, case: Case) -> Fit: ...


@dataclass(frozen=True)
class MistakeTest:
    """A mistake that the simulator points at, and how well it stands against what else could be.

    Args:
        residual: share of the worst channel that the base leaves once the mistake is repaired.
        unrepaired_residual, causes_residual: what the base leaves as recorded, and at best with one of its candidates.
        repaired: share of what the base leaves that may be left once a mistake is repaired.
    """

    mistake: DataMistake
    residual: float
    unrepaired_residual: float
    causes_residual: float
    repaired: float

    @property
    def is_enough(self) -> bool:
        """Whether the repair takes most of what the base leaves."""
        return self.residual <= self.repaired * self.unrepaired_residual

    @property
    def is_alone(self) -> bool:
        """Whether no candidate does as well."""
        return self.residual < self.causes_residual

    @property
    def is_claim(self) -> bool:
        """Whether nothing is to be diagnosed before it is repaired; else it is a question at most."""
        return self.is_enough and self.is_alone


def against_others(model: RoughModel, base: Fit) -> MistakeTest | None:
    """Return what the simulator shows: one run recorded otherwise than others, exchanged columns; None if nothing."""
    problem, config = base.problem, model.method.mistake
    if _agreement(base) > config.good:
        return None
    unrepaired = 1.0 - _agreement(base)
    exchanged = _exchanged(model, problem.case)
    suspected = (*exchanged, unrepaired) if exchanged else _of_one_run(model, problem.case)
    if suspected is None:
        return None
    mistake, residual, unrepaired = suspected
    by_causes = min(1.0 - _agreement(_with_causes(base, [cause], 20)) for cause in model.simulator.candidates)
    test = MistakeTest(mistake, residual, unrepaired, by_causes, config.repaired)
    return test if test.is_enough or test.is_alone else None


def _with_causes(result: Fit, causes: Sequence[Effect], steps: int) -> Fit:
    """Return a fit of causes beside a base, from their usual sizes."""
    usual = start_coordinates(causes, [[p.usual for p in cause.parameters] for cause in causes])
    return fit(result.problem, result.hypothesis.adding(*causes), np.append(result.coordinates, usual), steps=steps)


def _exchanged(model: RoughModel, case: Case) -> tuple[DataMistake, float] | None:
    """Return columns that agree with the base once they are exchanged in all runs, and what it leaves then."""
    for pair in combinations((*model.simulator.inputs, *model.simulator.channels), 2):
        runs = [run.changed(partial(_swapped, one=pair[0], other=pair[1])) for run in runs_of(case)]
        if (share := _agreement(model.rough_fit(Case(case.serial, tuple(runs))))) > model.method.mistake.good:
            return _exchange_mistake(*pair, ()), 1.0 - share
    return None


def _swapped(columns: Columns, one: str, other: str) -> Columns:
    return {**columns, one: columns[other], other: columns[one]}


def _exchange_mistake(one: str, other: str, runs: tuple[int, ...]) -> DataMistake:
    evidence, repair = (reason(code, one=one, other=other) for code in ("data.swapped", "data.repair.swap"))
    return DataMistake("swapped_columns", f"{one}+{other}", runs, None, evidence, repair)


def _of_one_run(model: RoughModel, case: Case) -> tuple[DataMistake, float, float] | None:
    """Return what is wrong with one run by what the others say of it, and what they leave of it repaired, and as it is.

    The others tell by the base, and by all causes together: a gap that all runs share is no mistake of one.
    """
    runs, number, config = runs_of(case), numbers(case), model.method.mistake
    tests: list[tuple[float, DataMistake | None, float, float]] = []
    for k, run in enumerate(runs) if len(runs) >= config.fewest_runs else ():
        others = model.rough_fit(Case(case.serial, tuple(runs[:k] + runs[k + 1 :])))
        if _residual_of_run(model, others, run) <= config.stands_out * (1.0 - _agreement(others)):
            continue
        for result in (others, _with_causes(others, model.simulator.candidates, config.steps)):
            as_it_is, of_others = _residual_of_run(model, result, run), 1.0 - _agreement(result)
            for mistake, repaired in _repairs(model, result, run, number[k]) if of_others < config.agreeing else ():
                residual = of_others if repaired is None else _residual_of_run(model, result, repaired)
                # A gain fits anything a little better: all of the run must agree then.
                is_free = mistake.what == "gain"
                if residual <= max(1.0 - config.good, 0.0 if is_free else config.stands_out * of_others):
                    tests.append((residual / max(as_it_is, 1e-300), mistake, residual, as_it_is))
    share, best, rest, unrepaired = min(tests, key=lambda one: one[0], default=(np.inf, None, 0.0, 0.0))
    return (best, rest, unrepaired) if best is not None and share <= config.question_share else None


def _residual_of_run(model: RoughModel, others: Fit, run: SimulatorRun) -> float:
    """Return which share of the worst channel's spread over all runs the others leave of a run."""
    columns, residual = run.columns, 0.0
    try:
        gives = model.simulator.predict(run, model.simulator.parameter_values(others.hypothesis, others.coordinates))
    except SimulatorFailed:
        return np.inf
    for channel, values in gives.items():
        parts = [columns[channel], *(one.columns[channel] for one in runs_of(others.problem.case))]
        spread = float(np.mean([np.var(part) for part in parts]))
        residual = max(residual, float(np.mean((columns[channel] - values) ** 2)) / max(spread, 1e-300))
    return residual


def _agreement(result: Fit) -> float:
    """Return which share of a channel's spread a fit takes up where it takes least."""
    pairs = [(result.problem.measured[b.rows], result.predicted[b.rows]) for b in result.problem.blocks]
    return min(1.0 - float(np.mean((m - p) ** 2)) / max(float(np.var(m)), 1e-300) for m, p in pairs)


def _repairs(
    model: RoughModel, others: Fit, run: SimulatorRun, number: int
) -> Iterator[tuple[DataMistake, SimulatorRun | None]]:
    """Yield what may be wrong with a run and the run repaired; None where nothing can be."""
    simulator, config, columns = model.simulator, model.method.mistake, run.columns
    try:
        gives = simulator.predict(run, simulator.parameter_values(others.hypothesis, others.coordinates))
    except SimulatorFailed:
        gives = {}
    for channel, predicted in gives.items():
        yield _factor_mistake(channel, number, -1.0, config.same_factor), _scaled(run, channel, -1.0)
        slope = float(np.polyfit(predicted, columns[channel], 1)[0]) if np.ptp(predicted) > 0.0 else 0.0
        if slope != 0.0 and abs(np.log(abs(slope))) > np.log(config.apart):
            yield _factor_mistake(channel, number, 1.0 / slope, config.same_factor), _scaled(run, channel, 1.0 / slope)
    for name in simulator.inputs:
        for factor in (-1.0, *FACTORS.values()):
            yield _factor_mistake(name, number, factor, config.same_factor), _scaled(run, name, factor)
        if np.ptp(columns[name]) == 0.0 and any(np.ptp(one.columns[name]) for one in runs_of(others.problem.case)):
            dead = reason("data.dead", channel=name)
            yield DataMistake("constant", name, (number,), None, dead, Reason("data.repair.dead")), None
    every = (*simulator.inputs, *simulator.channels)
    for name in every:
        for unit, (factor, offset) in SHIFTED.items():
            mistake = of_shifted(name, (number,), unit, factor, offset, reason("data.run.shifted", channel=name))
            yield mistake, _scaled(run, name, factor, offset)
    for pair in combinations(every, 2):
        yield _exchange_mistake(*pair, (number,)), run.changed(partial(_swapped, one=pair[0], other=pair[1]))


def _scaled(run: SimulatorRun, name: str, factor: float, offset: float = 0.0) -> SimulatorRun:
    return run.changed(lambda columns: {**columns, name: factor * columns[name] + offset})


def _factor_mistake(name: str, number: int, factor: float, same: float) -> DataMistake:
    if abs(np.log(abs(factor))) < np.log(same) and factor < 0.0:
        return of_sign(name, (number,), reason("data.run.apart", channel=name, ratio=1.0 / factor))
    return apart(name, number, factor, FACTORS, same)


def find_strays(model: RoughModel, base: Fit) -> tuple[DataMistake, ...]:
    """Return single samples far beyond all others that the simulator does not foretell: a broken transmission."""
    problem, simulator, config = base.problem, model.simulator, model.method.mistake
    result, case, number = [], problem.case, numbers(problem.case)
    for name in (*simulator.channels, *simulator.inputs):
        low, high = np.quantile(np.concatenate([run.columns[name] for run in runs_of(case)]), (0.01, 0.99))
        max_distance = config.far * float(high - low)
        for k, run in enumerate(runs_of(case)):
            values = run.columns[name]
            is_beyond = (values < low - max_distance) | (values > high + max_distance)
            if max_distance <= 0.0 or not 0.0 < is_beyond.mean() <= config.few:
                continue
            if name in simulator.channels:
                predicted = np.concatenate([base.predicted[b.rows] for b in problem.blocks_of(name) if b.run == k])[
                    is_beyond
                ]
                is_foretold = bool(np.any((predicted < low - max_distance) | (predicted > high + max_distance)))
            else:
                # A kick that is meant moves the mechanism: without it the simulator agrees less.
                inside = np.flatnonzero(~is_beyond)
                repaired = replace(
                    run, columns={**run.columns, name: np.interp(np.arange(len(values)), inside, values[inside])}
                )
                every = tuple(repaired if one is run else one for one in runs_of(case))
                residual = 1.0 - _agreement(model.rough_fit(Case(case.serial, every)))
                is_code = len(np.unique(values[is_beyond])) == 1 and np.count_nonzero(is_beyond) > 1
                is_foretold = residual > (1.0 if is_code else config.repaired) * (1.0 - _agreement(base))
            if not is_foretold:
                count, worst = int(is_beyond.sum()), float(values[is_beyond][0])
                ends = {"worst": worst, "low": float(low), "high": float(high)}
                evidence = reason("data.out_of_range.strays", count=count, channel=name, **ends, unit="")
                result.append(of_samples(name, (number[k],), count, evidence))
    return tuple(result)
