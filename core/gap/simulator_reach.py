"""What recordings of a mechanism show of a residual: what it may follow, where it stands out, terms that describe it.

A term is a number times what of an input or a channel it follows.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from softcal.core.errors import InputError
from softcal.core.gap.case import Run
from softcal.core.gap.fit import Fit, Regime, shares_of_gap
from softcal.core.gap.method import FloorConfig
from softcal.core.gap.problem import Block
from softcal.core.gap.simulator import Columns, Simulator
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter
from softcal.core.twin.signals import low_pass
from softcal.core.words.reason import Reason, reason

STANDS_OUT = 1.5
"""Share of the gap over share of time from which a condition is listed."""

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
        return Effect(name, self.place, Hook.READING, "", "empirical", (size,), TermStep(self))

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


@dataclass(frozen=True)
class TermStep:
    """What stands for a term among the effects of a hypothesis."""

    term: SimulatorTerm

    def __call__(self, flow: Flow, values: Sequence[float], state: Memory) -> None:
        raise ValueError("this term belongs to a simulator, not to the twin of a soft sensor")


def terms_of(simulator: Simulator, found: Fit) -> Iterator[SimulatorTerm]:
    """Give every term that may be tried on what a simulator leaves, without its coefficient."""
    problem, runs = found.problem, found.problem.case.runs
    longest_s = max(float(run.elapsed_s[-1]) for run in runs)
    signals = {name: [problem.recorded(k, name) for k in range(len(runs))] for name in simulator.inputs}
    signals |= {c: [found.predicted[b.place] for b in problem.blocks_of(c)] for c in simulator.channels}
    for place in simulator.channels:
        span = max(float(np.ptp(problem.measured[b.place])) for b in problem.blocks_of(place))
        yield SimulatorTerm(place, TIME, "", 0.0, 0.0, 1.0, 1.0, 0.0, span)
        for name, parts in signals.items():
            low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
            half = 0.5 * (high - low)
            if half <= 0.0:
                continue
            rates = [np.abs(np.gradient(p, run.t_s)) / half for p, run in zip(parts, runs, strict=True)]
            per_s = max(float(np.median(np.concatenate(rates))), 1e-3 / longest_s)
            one = SimulatorTerm(place, LEVEL, name, 0.0, 0.5 * (low + high), half, per_s, 0.0, span)
            yield from (replace(one, kind=kind) for kind in (LEVEL, SQUARE, CUBE, RATE, WAY, SIZED_WAY, SIZED_TIME))
            yield from (replace(one, kind=REMEMBERED, tau_s=share * longest_s) for share in MEMORIES)


def with_terms(simulator: Simulator, terms: Sequence[SimulatorTerm]) -> Simulator:
    """Return a simulator that adds these terms to its channels."""

    def run(inputs: Columns, parameters: Mapping[str, float]) -> Columns:
        given = dict(simulator.run(inputs, parameters))
        out = {name: np.array(values, dtype=np.float64) for name, values in given.items()}
        for term in terms:
            out[term.place] += term.coefficient * term.values(inputs["t_s"], {**inputs, **given})
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
    place, kind, signal = (str(record[name]) for name in texts)
    return SimulatorTerm(place, kind, signal, **{name: float(v) for name, v in numbers.items()})


def columns_of(signal: Array, run: Run, times: float, config: FloorConfig) -> dict[str, list[Array]]:
    """Return what a residual may follow of a signal within −1 and 1: groups of (n,) columns.

    Args:
        times: by what this rig is slower than a common one; memories fade by so much more slowly.
    """
    rate, hats = np.gradient(signal, run.t_s), config.hats
    way, quick = np.sign(rate), np.gradient(rate, run.t_s)
    places = [2.0 * k / (hats - 1) - 1.0 for k in range(hats)]
    memories = [low_pass(signal, run.step_s, times * tau_s, np.zeros(2)) for tau_s in config.memory_s]
    return {
        "level": [np.maximum(0.0, 1.0 - 0.5 * (hats - 1) * np.abs(signal - place)) for place in places],
        "way": [way, signal * way, signal**2 * way],
        "rate": [rate, np.abs(rate), rate * np.abs(rate), signal * rate, quick],
        "memory": [*memories, *(signal * remembered for remembered in memories)],
        "time": [run.elapsed_s, signal * run.elapsed_s],
    }


def known_of_signals(simulator: Simulator, found: Fit, channel: str) -> list[Sequence[Array]]:
    """Return groups of (samples,) columns of inputs and channels that a residual may follow."""
    problem, out = found.problem, list[Sequence[Array]]()
    times = problem.model.times_slower(problem.case)
    runs, blocks = problem.case.runs, problem.blocks_of(channel)
    inputs = [name for name in simulator.inputs if name != channel]
    signals = {name: [problem.recorded(k, name) for k in range(len(runs))] for name in inputs}
    for name in simulator.channels:
        signals[name] = [found.predicted[b.place] for b in problem.blocks_of(name)]
    for parts in signals.values():
        low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
        scaled = [(2.0 * parts[b.run] - low - high) / max(high - low, 1e-300) for b in blocks]
        each = [columns_of(x, runs[b.run], times, problem.method.floor) for x, b in zip(scaled, blocks, strict=True)]
        for kind in each[0]:
            rows = np.zeros((len(each[0][kind]), len(found.predicted)))
            for block, columns in zip(blocks, each, strict=True):
                rows[:, block.place] = columns[kind]
            out.append(list(rows))
    return out


def shifted(values: Array, t_s: Array, delay_s: float, straight: float) -> Array:
    """Return (3, n) a channel some time later, its rate of change, and straight lines less a curve.

    The curve is the cubic spline through the samples, its third derivative continuous at both ends.

    Args:
        values: (n,) with n of 4 and more, at the times t_s.
        straight: how far it goes by straight lines from sample to sample; by a curve elsewhere.
    """
    curve, rise = CubicSpline(t_s, values), np.diff(values) / np.diff(t_s)
    at_s = np.clip(t_s - delay_s, t_s[0], t_s[-1])
    before = np.minimum(np.searchsorted(t_s, at_s, side="right") - 1, len(rise) - 1)
    line = values[before] + (at_s - t_s[before]) * rise[before]
    apart = line - curve(at_s)
    rate = rise[before] + (1.0 - straight) * (curve(at_s, 1) - rise[before])
    return np.array([line - (1.0 - straight) * apart, np.where(t_s - delay_s > t_s[0], rate, 0.0), apart])


def conditions_of(found: Fit, blocks: list[Block]) -> dict[Reason, Array]:
    """Return which samples of blocks, (n,), lie in conditions in which a gap may stand out."""
    runs = [found.problem.case.runs[b.run] for b in blocks]
    predicted = [found.predicted[b.place] for b in blocks]
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


def regimes_of(base: Fit) -> list[Regime]:
    """Return the conditions in which what a base leaves stands out, the strongest first."""
    seen = []
    for channel in base.problem.scored_channels:
        blocks = base.problem.blocks_of(channel)
        for name, part, time_share in shares_of_gap(base, blocks, conditions_of(base, blocks)):
            share = float(np.clip(part, 0.0, 1.0))
            if share > STANDS_OUT * time_share:
                seen.append(Regime(channel, name, share, share / time_share))
    return sorted(seen, key=lambda r: -r.share * np.log(r.lift))
