"""Recordings of a mechanism and what its simulator says of them, as one problem for a fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from softcal.core.gap.case import Case, Mask, Run
from softcal.core.gap.colour import ColourConfig, COMMON_STEP_s
from softcal.core.gap.coordinates import RigScale
from softcal.core.gap.fit import Fit
from softcal.core.gap.floor import columns_of
from softcal.core.gap.method import METHOD
from softcal.core.gap.offsets import Directions, Sizes
from softcal.core.gap.problem import Block, Hypothesis, Problem
from softcal.core.gap.simulator import STRAIGHT, Simulator, SimulatorFailed, SimulatorRun, TermStep
from softcal.core.recording import Array

KNOWN = 200
"""Answers of a simulator that are kept."""


@dataclass
class Failures:
    """How often a simulator failed within the bounds of its parameters, and how it did first."""

    count: int = 0
    of: int = 0
    first: str = ""

    def record(self) -> dict[str, object] | None:
        """Return what a report says of it; None where it never failed."""
        return {"evaluations": self.count, "of": self.of, "first": self.first} if self.count else None


@dataclass(frozen=True, eq=False)
class SimulatorProblem(Problem):
    """Recorded channels of a mechanism as one vector, and what its simulator says of them."""

    of: Simulator = field(kw_only=True)
    failures: Failures = field(default_factory=Failures)
    known: dict[tuple[tuple[str, float], ...], Array] = field(default_factory=dict)
    """What the simulator said lately, by its parameters; noise and samples do not matter."""
    of_base: tuple[bool, ...] = ()
    """Of every offset, whether the base has what all runs share of it; not known where empty."""

    @cached_property
    def channels_of_runs(self) -> list[tuple[str, ...]]:
        return [self.of.channels for _ in self.case.runs]

    def recorded(self, run: int, channel: str) -> Array:
        return self._runs[run].columns[channel]

    @cached_property
    def is_free(self) -> Array:
        return np.ones(len(self.of.base), dtype=np.bool_)

    @cached_property
    def dither_V(self) -> float | None:
        return None

    @property
    def scored_channels(self) -> list[str]:
        return list(self.of.channels)

    @cached_property
    def times_slower(self) -> float:
        """By what these runs are slower than those of a common rig."""
        return float(np.median(np.concatenate([run.step_s[1:] for run in self.case.runs]))) / COMMON_STEP_s

    @cached_property
    def colour_config(self) -> ColourConfig:
        return METHOD.colour.slower(self.times_slower)

    @property
    def smooth_order(self) -> int:
        return 2

    def least_noise(self, channel: str) -> float:
        return 1e-9 * max(float(np.ptp(self.measured[b.place])) for b in self.blocks_of(channel))

    def of_run(self, run: Run) -> Problem:
        case = Case(self.case.serial, (run,), is_planned=True)
        return replace(self, case=case, use=None, failures=Failures(), known={})

    @cached_property
    def largest_offsets(self) -> Array:
        return np.array([self.of.per_run[channel].get(kind, 1.0) for channel, kind in self.of.offsets])

    @cached_property
    def are_relative(self) -> Mask:
        return np.array(self.of_base or [kind == "gain" for _, kind in self.of.offsets], dtype=np.bool_)

    @cached_property
    def are_bending(self) -> Mask:
        return np.array([kind == "delay" for _, kind in self.of.offsets], dtype=np.bool_)

    def _known(self, out: Array) -> Array:
        # Where a simulator fails nothing is known: a fit must not go there.
        return out

    def clean(self, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        out = self._simulated(hypothesis, coordinates).copy()
        for block in self.blocks if sizes else ():
            rows = zip(self.of.offsets, sizes[block.run], strict=True)
            mine = {kind: float(size) for (channel, kind), size in rows if channel == block.channel}
            t_s = self.case.runs[block.run].elapsed_s
            values = out[block.place]
            if mine.get("delay") and np.all(np.isfinite(values)):
                values = shifted(values, t_s, mine["delay"], mine[STRAIGHT])[0]
            out[block.place] = (
                values * (1.0 + mine.get("gain", 0.0)) + mine.get("zero", 0.0) + mine.get("drift", 0.0) * t_s
            )
        return out

    def directions(self, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes) -> Directions:
        raw, out = self._simulated(hypothesis, coordinates), Directions()
        for block in self.blocks:
            if block.channel not in self.of.per_run:
                out.append(None)
                continue
            kinds, mine = self.of.offsets, raw[block.place]
            t_s, has = self.case.runs[block.run].elapsed_s, dict.fromkeys(kinds, 0.0)
            if block.run in sizes:
                has = dict(zip(kinds, sizes[block.run], strict=True))
            late, slope, apart = mine, np.gradient(clean[block.place], t_s), np.zeros(len(t_s))
            if has.get((block.channel, "delay")) and np.all(np.isfinite(mine)):
                late, slope, apart = shifted(mine, t_s, has[block.channel, "delay"], has[block.channel, STRAIGHT])
            of_kind = {"zero": np.ones(len(t_s)), "drift": t_s, "gain": late, "delay": -slope, STRAIGHT: apart}
            out.append(np.array([of_kind[kind] * (channel == block.channel) for channel, kind in kinds]))
        return out

    def _simulated(self, hypothesis: Hypothesis, coordinates: Array) -> Array:
        """Return (samples,) with the empirical terms, NaN where the simulator fails in a run."""
        parameters = self.of.named(hypothesis, coordinates)
        key = tuple(parameters.items())
        if key not in self.known:
            self.known[key] = self._run_all(parameters)
            # The oldest goes: every part that is held back begins where the others did.
            if len(self.known) > KNOWN:
                del self.known[next(iter(self.known))]
        raw = self.known[key]
        terms = [(e.step.term, e.id) for e in hypothesis.effects if isinstance(e.step, TermStep)]
        if not terms or not np.all(np.isfinite(raw)):
            return raw
        out, sizes = raw.copy(), {i: coordinates[hypothesis.place_of(i)] for _, i in terms}
        for run in range(len(self.case.runs)):
            places = {b.channel: b.place for b in self.blocks if b.run == run}
            columns = {name: self.recorded(run, name) for name in self.of.inputs}
            columns |= {channel: raw[place] for channel, place in places.items()}
            for term, i in terms:
                out[places[term.place]] += sizes[i] * term.values(self.case.runs[run].t_s, columns)
        return out

    def _run_all(self, parameters: Mapping[str, float]) -> Array:
        out = np.empty(len(self.measured))
        last, channels = -1, {}
        self.failures.of += 1
        for block in self.blocks:
            if block.run != last:
                last = block.run
                inputs = {name: self.recorded(last, name) for name in ("t_s", *self.of.inputs)}
                try:
                    channels = dict(self.of(inputs, parameters, self._runs[last].name))
                except SimulatorFailed as error:
                    self.failures.count += 1
                    self.failures.first = self.failures.first or str(error)
                    return np.full(len(out), np.nan)
            out[block.place] = channels[block.channel]
        return out

    @cached_property
    def _runs(self) -> list[SimulatorRun]:
        return runs_of(self.case)


def runs_of(case: Case) -> list[SimulatorRun]:
    """Return the runs of a case of a mechanism."""
    return [run for run in case.runs if isinstance(run, SimulatorRun)]


def rough_problem(simulator: Simulator, case: Case) -> SimulatorProblem:
    """Return recordings with a fiftieth of the spread of a channel as its noise."""
    columns = {c: np.concatenate([run.columns[c] for run in runs_of(case)]) for c in simulator.channels}
    rough = {c: 0.02 * max(float(np.std(values)), 1e-12) for c, values in columns.items()}
    # A simulator states the bounds of its own parameters.
    return SimulatorProblem(case, rough, of_rig=RigScale(), of=simulator)


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


def followed(found: Fit, channel: str) -> list[Sequence[Array]]:
    """Return groups of (samples,) columns of inputs and channels that a residual may follow."""
    problem, out = found.problem, list[Sequence[Array]]()
    if not isinstance(problem, SimulatorProblem):
        return out
    runs, blocks = runs_of(problem.case), problem.blocks_of(channel)
    signals = {name: [run.columns[name] for run in runs] for name in problem.of.inputs if name != channel}
    for name in problem.of.channels:
        signals[name] = [found.predicted[b.place] for b in problem.blocks_of(name)]
    for parts in signals.values():
        low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
        scaled = [(2.0 * parts[b.run] - low - high) / max(high - low, 1e-300) for b in blocks]
        each = [columns_of(x, runs[b.run], problem.times_slower) for x, b in zip(scaled, blocks, strict=True)]
        for kind in each[0]:
            rows = np.zeros((len(each[0][kind]), len(found.predicted)))
            for block, columns in zip(blocks, each, strict=True):
                rows[:, block.place] = columns[kind]
            out.append(list(rows))
    return out


def is_high(found: Fit, block: Block) -> Mask:
    """Return where a channel of a run lies above its median, (n,)."""
    level = found.predicted[block.place]
    return np.asarray(level > np.median(level), dtype=np.bool_)


def is_quick(found: Fit, block: Block) -> Mask:
    """Return where a channel of a run changes faster than usual, (n,)."""
    rate = np.abs(np.gradient(found.predicted[block.place], found.problem.case.runs[block.run].t_s))
    return np.asarray(rate > np.median(rate), dtype=np.bool_)
