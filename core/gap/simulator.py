"""A simulator of somebody else: what it must say of itself so that the diagnosis can be run on it.

    SPRING = Simulator(
        name="mass on a spring",
        run=simulate,                                   # (inputs, parameters) -> channels
        inputs=("push_N",),
        channels=("place_mm",),
        base=(Parameter("stiffness", "N/mm", 0.1, 100.0, 5.0),),
        candidates=(candidate("hardening", "spring", Parameter("k3", "N/mm³", -1.0, 1.0, 0.05, neutral=0.0)),),
    )

`inputs` holds `t_s` and the input columns of a run; `parameters` holds every base parameter by its name and every
parameter of a candidate as `candidate.parameter`, at its neutral value where the candidate is off.
"""

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from softcal.core.errors import InputError
from softcal.core.gap.case import SHORTEST, Case, Mask, Run
from softcal.core.gap.colour import ColourConfig, COMMON_STEP_s
from softcal.core.gap.fit import Block, Fit, Hypothesis, Problem
from softcal.core.gap.library import columns_of
from softcal.core.gap.offsets import Directions, Sizes
from softcal.core.gap.scale import RigScale
from softcal.core.gap.simulator_terms import TermStep
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.probes import Extent

Columns: TypeAlias = Mapping[str, Array]
Simulate: TypeAlias = Callable[[Columns, Mapping[str, float]], Columns]
KNOWN = 200
"""Answers of a simulator that are kept."""

OFFSETS = ("zero", "gain", "delay", "drift")
"""What a run may have of its own in a channel."""


class SimulatorFailed(InputError):
    """A simulator gave no finite channels at the parameters it was asked for."""


@dataclass(frozen=True)
class Experiment:
    """A run that could be made: its inputs with `t_s`, and how long it takes on the bench, in minutes."""

    inputs: Columns
    minutes: float = 1.0


@dataclass(frozen=True, eq=False)
class Simulator:
    """A simulator with its parameters and the effects it may be missing.

    Args:
        name: for reports.
        run: the simulator. It must not change its arguments, and must be smooth to about 1e-6 of a channel's span in
            its parameters: derivatives are taken by differences.
        inputs: columns of a recording that drive it, besides `t_s`.
        channels: columns it predicts.
        base: parameters that every hypothesis has.
        candidates: effects it can switch on, made by `candidate`.
        experiments: runs that could be made, by name; the next experiment is chosen among them.
        per_run: by channel, what each run may have of its own and no cause has to explain: `zero` in the channel's
            unit, `gain` as a share, `delay` in s, `drift` in the channel's unit per s; each with the largest that is
            taken off. A gain that all runs share belongs to the base.

    Raises:
        InputError: two parts have the same name, or a part that must be there is missing.
    """

    name: str
    run: Simulate
    inputs: tuple[str, ...]
    channels: tuple[str, ...]
    base: tuple[Parameter, ...]
    candidates: tuple[Effect, ...]
    experiments: Mapping[str, Experiment] = field(default_factory=dict)
    per_run: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what, names in (
            ("channel", self.channels),
            ("base parameter", [p.name for p in self.base]),
            ("candidate", [c.id for c in self.candidates]),
        ):
            if not names:
                raise InputError(f"simulator {self.name}: no {what} is given; at least one was expected")
            if len(set(names)) < len(names):
                raise InputError(f"simulator {self.name}: two of the {what}s have one name: {', '.join(names)}")
        for channel, kinds in self.per_run.items():
            if channel not in self.channels or not set(kinds) <= set(OFFSETS):
                raise InputError(
                    f"simulator {self.name}: per_run has {channel}: {', '.join(kinds)}; "
                    f"one of {', '.join(self.channels)} was expected, with any of {', '.join(OFFSETS)}"
                )
            for kind, largest in kinds.items():
                if not 0.0 < largest < np.inf:
                    raise InputError(
                        f"simulator {self.name}: {kind} of {channel} is {largest}; its largest was expected"
                    )

    @cached_property
    def offsets(self) -> tuple[tuple[str, str], ...]:
        """Channel and kind of everything that each run may have of its own."""
        return tuple((channel, kind) for channel, kinds in self.per_run.items() for kind in kinds)

    @property
    def parameter_names(self) -> list[str]:
        """Names of all parameters, as `run` takes them."""
        return [*(p.name for p in self.base), *(f"{c.id}.{p.name}" for c in self.candidates for p in c.parameters)]

    def named(self, hypothesis: Hypothesis, coordinates: Array) -> dict[str, float]:
        """Return the values at these coordinates of the fit, as `run` takes them."""
        base, values = hypothesis.split(coordinates)
        out = {p.name: value for p, value in zip(self.base, base, strict=True)}
        for effect in self.candidates:
            out |= {f"{effect.id}.{p.name}": v for p, v in zip(effect.parameters, effect.neutral_values, strict=True)}
        for effect, row in zip(hypothesis.effects, values, strict=True):
            if isinstance(effect.step, TermStep):
                continue
            out |= {f"{effect.id}.{p.name}": value for p, value in zip(effect.parameters, row, strict=True)}
        return out

    def __call__(self, inputs: Columns, parameters: Mapping[str, float]) -> Columns:
        """Return the predicted channels of a run.

        Raises:
            SimulatorFailed: it raises, a channel is missing, has another length, or is not finite.
        """
        try:
            # What overflows is found below, and is said once.
            with np.errstate(all="ignore"):
                found = self.run(inputs, parameters)
        except Exception as error:
            raise self._failed(f"{type(error).__name__}: {error}", parameters, _line_of(error, self._file)) from error
        out: dict[str, Array] = {}
        for channel in self.channels:
            if not isinstance(found, Mapping) or channel not in found:
                gives = ", ".join(map(str, found)) if isinstance(found, Mapping) else type(found).__name__
                raise self._failed(f"gives no {channel}; it gives {gives or 'nothing'}", parameters)
            try:
                out[channel] = np.asarray(found[channel], dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise self._failed(f"{channel} is no array of numbers: {error}", parameters) from error
            if out[channel].shape != np.shape(inputs["t_s"]):
                shapes = f"has shape {out[channel].shape}, t_s has {np.shape(inputs['t_s'])}"
                raise self._failed(f"{channel} {shapes}", parameters)
            bad = np.flatnonzero(~np.isfinite(out[channel]))
            if len(bad):
                raise self._failed(f"{channel} is {out[channel][bad[0]]} at sample {bad[0]}", parameters)
        return out

    @cached_property
    def _file(self) -> str:
        """The user's file, for messages."""
        code = getattr(self.run, "__code__", None) or getattr(type(self.run).__call__, "__code__", None)
        return str(getattr(code, "co_filename", "")) or str(getattr(self.run, "__module__", "its module"))

    def _failed(self, what: str, parameters: Mapping[str, float], line: str = "") -> SimulatorFailed:
        at = ", ".join(f"{name} = {value:.4g}" for name, value in parameters.items())
        return SimulatorFailed(f"simulator {self.name} ({self._file}{line}) fails: {what}; at {at}")


def _line_of(error: Exception, file: str) -> str:
    """Return the last line of the user's file that an error went through, empty where it did not."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f", line {lines[-1]}" if lines else ""


@dataclass
class Failures:
    """How often a simulator failed within the bounds of its parameters, and how it did first."""

    count: int = 0
    of: int = 0
    first: str = ""

    def record(self) -> dict[str, object] | None:
        """Return what a report says of it; None where it never failed."""
        return {"evaluations": self.count, "of": self.of, "first": self.first} if self.count else None


def _elsewhere(flow: Flow, values: Sequence[float], state: Memory) -> None:
    raise ValueError("this effect belongs to another simulator, not to the twin of a soft sensor")


@dataclass(frozen=True)
class _Rows:
    rows: tuple[tuple[float, ...], ...]

    def __call__(self, at: Extent) -> Sequence[tuple[float, ...]]:
        return self.rows


def candidate(
    name: str,
    place: str,
    *parameters: Parameter,
    probes: Sequence[tuple[float, ...]] = (),
    hides_behind: tuple[str, ...] = (),
) -> Effect:
    """Return an effect that a simulator can switch on.

    Args:
        name: how the report names it.
        place: the part of the mechanism it sits in; the report's `where`.
        parameters: the first is its size and has the neutral value that switches it off.
        probes: parameter values at which a search begins; a fifth of the usual size where none are given.
        hides_behind: candidates it is mistaken for.
    """
    signs = Signs(probes=_Rows(tuple(probes)) if probes else None, hides_behind=hides_behind)
    return Effect(name, place, Hook.READING, "", "a simulator's own", parameters, _elsewhere, signs=signs)


@dataclass(frozen=True, eq=False)
class SimulatorRun(Run):
    """One recorded run of a mechanism: its columns by name."""

    columns: Columns = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.t_s) < SHORTEST:
            raise InputError(f"{self.name}: {len(self.t_s)} samples; at least {SHORTEST} are needed for a diagnosis")
        if not np.all(np.diff(self.t_s) > 0):
            at = int(np.argmin(np.diff(self.t_s) > 0)) + 1
            raise InputError(f"{self.name}: t_s does not go on at sample {at}")
        for name, values in self.columns.items():
            if len(values) != len(self.t_s) or not np.all(np.isfinite(values)):
                raise InputError(f"{self.name}: {name} has {len(values)} samples or is not finite; t_s has {len(self)}")


def recorded(simulator: Simulator, name: str, columns: Columns, profile: str = "") -> SimulatorRun:
    """Return a recorded run of the mechanism.

    Args:
        columns: `t_s`, the inputs and at least the channels of the simulator; others are left out.

    Raises:
        InputError: a column is missing, or has gaps.
    """
    needed = ("t_s", *simulator.inputs, *simulator.channels)
    missing = [column for column in needed if column not in columns]
    if missing:
        raise InputError(f"{name}: {', '.join(missing)} missing; simulator {simulator.name} needs {', '.join(needed)}")
    kept = {column: np.asarray(columns[column], dtype=np.float64) for column in needed}
    return _run(name, kept, profile)


def _run(name: str, columns: Columns, profile: str = "") -> SimulatorRun:
    # The electronics of a soft sensor mean nothing here.
    return SimulatorRun(name, columns["t_s"], ReadoutMetadata(), profile=profile, columns=columns)


def planned(simulator: Simulator, name: str) -> SimulatorRun:
    """Return an experiment as the run it would be, its channels still empty (zeros)."""
    inputs = {k: np.asarray(v, dtype=np.float64) for k, v in simulator.experiments[name].inputs.items()}
    return _run(name, {channel: np.zeros(len(inputs["t_s"])) for channel in simulator.channels} | inputs)


@dataclass(frozen=True, eq=False)
class SimulatorProblem(Problem):
    """Recorded channels of a mechanism as one vector, and what its simulator says of them."""

    simulator: Simulator | None = None
    failures: Failures = field(default_factory=Failures)
    known: dict[tuple[tuple[str, float], ...], Array] = field(default_factory=dict)
    """What the simulator said lately, by its parameters, whatever noise or samples a problem has."""
    of_base: tuple[bool, ...] = ()
    """Of every offset, whether the base has what all runs share of it; nothing of it is known where empty."""

    @property
    def of(self) -> Simulator:
        """The simulator."""
        if self.simulator is None:
            raise ValueError("a problem of a simulator needs one")
        return self.simulator

    @cached_property
    def channels_of_runs(self) -> list[tuple[str, ...]]:
        return [self.of.channels for _ in self.case.runs]

    def recorded(self, run: int, channel: str) -> Array:
        return self._runs[run].columns[channel]

    @cached_property
    def is_free(self) -> Array:
        return np.ones(len(self.of.base), dtype=np.bool_)

    @cached_property
    def scale(self) -> RigScale:
        # A simulator states the bounds of its own parameters.
        return RigScale()

    @property
    def is_driven_by_force(self) -> bool:
        return False

    @cached_property
    def dither_V(self) -> float | None:
        return None

    @property
    def scored_channels(self) -> list[str]:
        return list(self.of.channels)

    @cached_property
    def _times_slower(self) -> float:
        return float(np.median(np.concatenate([run.step_s[1:] for run in self.case.runs]))) / COMMON_STEP_s

    @cached_property
    def colour_config(self) -> ColourConfig:
        return ColourConfig().slower(self._times_slower)

    @property
    def smooth_order(self) -> int:
        return 2

    def least_noise(self, channel: str) -> float:
        return 1e-9 * max(float(np.ptp(self.measured[b.place])) for b in self.blocks if b.channel == channel)

    def of_run(self, run: Run) -> Problem:
        case = Case(self.case.serial, (run,), is_planned=True)
        return replace(self, case=case, use=None, failures=Failures(), known={})

    @cached_property
    def largest_offsets(self) -> Array:
        return np.array([self.of.per_run[channel][kind] for channel, kind in self.of.offsets])

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
                # A straight line between samples would err by more than the noise where a channel bends.
                values = CubicSpline(t_s, values)(np.clip(t_s - mine["delay"], 0.0, t_s[-1]))
            out[block.place] = (
                values * (1.0 + mine.get("gain", 0.0)) + mine.get("zero", 0.0) + mine.get("drift", 0.0) * t_s
            )
        return out

    def directions(self, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes) -> Directions:
        raw = self._simulated(hypothesis, coordinates)
        return [self._along(block, clean[block.place], raw[block.place]) for block in self.blocks]

    def _along(self, block: Block, clean: Array, raw: Array) -> Array | None:
        """(k, n) change of a channel with each offset of its run; None where none is allowed."""
        if block.channel not in self.of.per_run:
            return None
        t_s = self.case.runs[block.run].elapsed_s
        of_kind = {"zero": np.ones(len(t_s)), "drift": t_s, "gain": raw, "delay": -np.gradient(clean, t_s)}
        return np.array([of_kind[kind] * (channel == block.channel) for channel, kind in self.of.offsets])

    def _simulated(self, hypothesis: Hypothesis, coordinates: Array) -> Array:
        """Return what the simulator says, (samples,), NaN everywhere where it fails in a run."""
        parameters = self.of.named(hypothesis, coordinates)
        key = tuple(parameters.items())
        if key not in self.known:
            self.known[key] = self._run_all(parameters)
            # The oldest goes: every part that is held back begins where the others did.
            if len(self.known) > KNOWN:
                del self.known[next(iter(self.known))]
        return self._with_terms(hypothesis, coordinates, self.known[key])

    def _with_terms(self, hypothesis: Hypothesis, coordinates: Array, raw: Array) -> Array:
        """Return what the simulator says, (samples,), with the empirical terms of a hypothesis added."""
        found = [(e.step.term, e.id) for e in hypothesis.effects if isinstance(e.step, TermStep)]
        if not found or not np.all(np.isfinite(raw)):
            return raw
        out, sizes = raw.copy(), {i: coordinates[hypothesis.place_of(i)] for _, i in found}
        for run in range(len(self.case.runs)):
            places = {b.channel: b.place for b in self.blocks if b.run == run}
            columns = {name: self.recorded(run, name) for name in self.of.inputs}
            columns |= {channel: raw[place] for channel, place in places.items()}
            for term, i in found:
                out[places[term.place]] += sizes[i] * term.values(self.case.runs[run].t_s, columns)
        return out

    def _run_all(self, parameters: Mapping[str, float]) -> Array:
        out = np.empty(len(self.measured))
        last, found = -1, {}
        self.failures.of += 1
        for block in self.blocks:
            if block.run != last:
                last = block.run
                inputs = {name: self.recorded(last, name) for name in ("t_s", *self.of.inputs)}
                try:
                    found = dict(self.of(inputs, parameters))
                except SimulatorFailed as error:
                    self.failures.count += 1
                    self.failures.first = self.failures.first or str(error)
                    return np.full(len(out), np.nan)
            out[block.place] = found[block.channel]
        return out

    def followed(self, predicted: Array, channel: str) -> dict[str, dict[str, Array]]:
        """Return groups of (samples,) columns that a residual of a channel may follow: of inputs and channels."""
        signals = {name: [run.columns[name] for run in self._runs] for name in self.of.inputs if name != channel}
        for name in self.of.channels:
            signals[name] = [predicted[b.place] for b in self.blocks if b.channel == name]
        out: dict[str, dict[str, Array]] = {}
        for name, parts in signals.items():
            low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
            for block in (b for b in self.blocks if b.channel == channel):
                signal = (2.0 * parts[block.run] - low - high) / max(high - low, 1e-300)
                for kind, columns in columns_of(signal, self._runs[block.run], self._times_slower).items():
                    group = out.setdefault(f"{kind} of {name}", {})
                    for k, column in enumerate(columns):
                        group.setdefault(f"{k}", np.zeros(len(predicted)))[block.place] = column
        return out

    @cached_property
    def _runs(self) -> list[SimulatorRun]:
        return [run for run in self.case.runs if isinstance(run, SimulatorRun)]


def followed(found: Fit, channel: str) -> list[Mapping[str, Array]]:
    """Return groups of (samples,) columns that a residual of a channel may follow."""
    problem = found.problem
    return list(problem.followed(found.predicted, channel).values()) if isinstance(problem, SimulatorProblem) else []


def is_high(found: Fit, block: Block) -> Mask:
    """Return where a channel of a run lies above its median, (n,)."""
    level = found.predicted[block.place]
    return np.asarray(level > np.median(level), dtype=np.bool_)


def is_quick(found: Fit, block: Block) -> Mask:
    """Return where a channel of a run changes faster than usual, (n,)."""
    rate = np.abs(np.gradient(found.predicted[block.place], found.problem.case.runs[block.run].t_s))
    return np.asarray(rate > np.median(rate), dtype=np.bool_)
