"""Empirical terms for a simulator: a number times something its inputs and channels do, added to a channel.

A term describes what no candidate explains. It is made from what the simulator is given and gives itself, never from
a recording. So it can be added to the simulator as such.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter
from softcal.core.twin.signals import low_pass

if TYPE_CHECKING:
    from softcal.core.gap.simulator import Columns, Simulator
    from softcal.core.gap.simulator_problem import SimulatorProblem

MEMORIES = (0.01, 0.03, 0.1, 0.3)
"""Fading times of the memories, as shares of the longest run."""

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
        middle, half: what a signal of 0 and of 1 stand for: from the middle to the farthest that was recorded.
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

    def values(self, t_s: Array, columns: "Columns") -> Array:
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


def terms_of(problem: "SimulatorProblem", predicted: Array) -> Iterator[SimulatorTerm]:
    """Give every term that may be tried on a problem, without its coefficient.

    Args:
        predicted: (samples,) of the simulator alone.
    """
    runs = problem.case.runs
    longest_s = max(float(run.elapsed_s[-1]) for run in runs)
    signals = {name: [problem.recorded(k, name) for k in range(len(runs))] for name in problem.of.inputs}
    signals |= {c: [predicted[b.place] for b in problem.blocks_of(c)] for c in problem.of.channels}
    for place in problem.of.channels:
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


def with_terms(simulator: "Simulator", terms: Sequence[SimulatorTerm]) -> "Simulator":
    """Return a simulator that adds these terms to its channels."""

    def run(inputs: "Columns", parameters: Mapping[str, float]) -> "Columns":
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
