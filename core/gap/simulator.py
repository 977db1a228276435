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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from numbers import Real
from typing import Any, TypeAlias, cast

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import SHORTEST, Case, Run
from softcal.core.gap.hypothesis import DIFFERENCE, Hypothesis, fit_scale, from_fit, to_fit
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.probes import ExcitationRange

Columns: TypeAlias = Mapping[str, Array]

Simulate: TypeAlias = Callable[[Columns, Mapping[str, float]], Columns]

SimulateMany: TypeAlias = Callable[[Sequence[tuple[Columns, Mapping[str, float]]]], Sequence[Columns | Exception]]

OFFSETS = ("zero", "gain", "delay", "drift")
"""What a run may have of its own in a channel."""

LINEAR = "straight"
"""How far a late channel goes by straight lines from sample to sample, 1, and not by a curve, 0."""


class SimulatorFailed(InputError):
    """A simulator gave no finite channels at the parameters it was asked for."""


@dataclass(frozen=True)
class Experiment:
    """A run that could be made: its inputs with `t_s`, and the minutes it takes on the bench."""

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
        run_parameters: what each run has of its own and the simulator must be told, such as where it begins. They are
            fitted run by run, and called `name@run` in a report.
        priors: what is known of a parameter of base or runs before any recording, such as a mass that stood on a
            scale: by name, mean and standard deviation in its unit.
        noise: by channel, standard deviation of its noise where the sensor's is known; else it is read off the runs.
        skip_s: how much of the start of every run is simulated and not compared, in s.
        run_many: answers several calls at once, each (inputs, parameters), in their order; an exception in the place
            of an answer is a call that failed. Derivatives are made so where it is given.

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
    run_parameters: tuple[Parameter, ...] = ()
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    skip_s: float = 0.0
    run_many: SimulateMany | None = None

    def __post_init__(self) -> None:
        if not callable(self.run):
            raise InputError(f"simulator {self.name}: run is {self.run!r}; a function was expected")
        for label, names in (
            ("channel", self.channels),
            ("base parameter", [p.name for p in (*self.base, *self.run_parameters)]),
            ("candidate", [c.id for c in self.candidates]),
            ("parameter", [*self.parameter_names, *(p.name for p in self.run_parameters)]),
            ("input column", ["t_s", *self.inputs]),
        ):
            if not names:
                raise InputError(f"simulator {self.name}: no {label} is given; at least one was expected")
            if isinstance(self.inputs, str) or isinstance(self.channels, str):
                raise InputError(f"simulator {self.name}: inputs and channels are names in a tuple, as ('force_N',)")
            if len(set(names)) < len(names):
                raise InputError(f"simulator {self.name}: two of the {label}s have one name: {', '.join(names)}")
        self._check_bounds()
        self._check_priors()
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

    def _check_priors(self) -> None:
        base = {p.name: p for p in (*self.base, *self.run_parameters)}
        for name, (mean, sd) in self.priors.items():
            if name.partition("@")[0] not in {plain.partition("@")[0] for plain in base}:
                raise InputError(f"simulator {self.name}: priors has {name}; one of {', '.join(base)} was expected")
            bounds = base.get(name)
            if bounds is not None and not (bounds.low <= mean <= bounds.high and 0.0 < sd < np.inf):
                raise InputError(
                    f"simulator {self.name}: the prior of {name} is {mean:g} with the standard deviation {sd:g}; a "
                    f"mean within {bounds.low:g} and {bounds.high:g} and a deviation above 0 were expected"
                )
        for channel, sigma in self.noise.items():
            if channel not in self.channels or not 0.0 < sigma < np.inf:
                raise InputError(
                    f"simulator {self.name}: noise has {channel}: {sigma:g}; the standard deviation of one of "
                    f"{', '.join(self.channels)} was expected, above 0"
                )
        if not 0.0 <= self.skip_s < np.inf:
            raise InputError(f"simulator {self.name}: skip_s is {self.skip_s:g}; seconds from 0 were expected")

    def _check_bounds(self) -> None:
        for name, p in self.every_parameter.items():
            numbers = {"lower bound": p.low, "upper bound": p.high, "usual size": p.usual}
            if invalid := [f"{label} {value!r}" for label, value in numbers.items() if not isinstance(value, Real)]:
                raise InputError(f"simulator {self.name}: {name} has the {invalid[0]}; a number was expected")
            bounds = f"simulator {self.name}: {name} has the bounds {p.low:g} and {p.high:g} {p.unit}".rstrip()
            if not -np.inf < p.low < p.high < np.inf:
                raise InputError(f"{bounds}; two numbers were expected, the smaller first")
            if p.scale != "linear" and p.low <= 0.0:
                raise InputError(f"{bounds}; with scale={p.scale!r} both must be above 0")
            if not p.low <= p.usual <= p.high:
                raise InputError(f"{bounds} and the usual size {p.usual:g}; it must lie within them")
            if p.neutral == p.usual:
                raise InputError(f"simulator {self.name}: {name} has the usual size {p.usual:g}, which switches it off")
        for effect in self.candidates:
            for row in effect.signs.probes(PROBED) if effect.signs.probes else ():
                if len(row) != len(effect.parameters):
                    raise InputError(
                        f"simulator {self.name}: a probe of {effect.id} has {len(row)} values; a value for each of "
                        f"{', '.join(p.name for p in effect.parameters)} was expected"
                    )

    @cached_property
    def offsets(self) -> tuple[tuple[str, str], ...]:
        """Channel and kind of what each run may have of its own; delays have a straightness."""
        declared = [(channel, kind) for channel, kinds in self.per_run.items() for kind in kinds]
        return (*declared, *((channel, LINEAR) for channel, kind in declared if kind == "delay"))

    def of_runs(self, names: Sequence[str]) -> "Simulator":
        """Return the simulator with a base parameter for each run of these names in place of its own parameters."""
        of_each_run = tuple(replace(p, name=f"{p.name}@{name}") for name in names for p in self.run_parameters)
        # A search begins at what is known.
        with_priors = ((p, self.prior_of(p)) for p in (*self.base, *of_each_run))
        base = tuple(replace(p, usual=prior[0]) if prior is not None else p for p, prior in with_priors)
        return replace(self, base=base, run_parameters=())

    def prior_of(self, parameter: Parameter) -> tuple[float, float] | None:
        """Return mean and standard deviation of what is known of a base parameter, of one run's by its plain name."""
        return self.priors.get(parameter.name) or self.priors.get(parameter.name.partition("@")[0])

    def first_compared(self, t_s: Array) -> int:
        """Return the first sample of a run, (n,) times, that is compared."""
        return int(np.searchsorted(t_s, t_s[0] + self.skip_s)) if self.skip_s and len(t_s) else 0

    def parameters_of(self, parameters: Mapping[str, float], run_name: str) -> Mapping[str, float]:
        """Return parameters as `run` takes them for one run: what that run has of its own by its plain name."""
        of_runs = {name: value for name, value in parameters.items() if "@" in name}
        usual = {p.name: p.usual for p in self.run_parameters if p.name not in parameters}
        if not of_runs and not usual:
            return parameters
        of_this_run = {
            name.partition("@")[0]: value for name, value in of_runs.items() if name.endswith(f"@{run_name}")
        }
        # A run that is not recorded yet begins where the first one did.
        first = {name.partition("@")[0]: value for name, value in reversed(of_runs.items())}
        return usual | {name: value for name, value in parameters.items() if name not in of_runs} | first | of_this_run

    @cached_property
    def candidate_ids(self) -> frozenset[str]:
        return frozenset(c.id for c in self.candidates)

    @cached_property
    def every_parameter(self) -> dict[str, Parameter]:
        """All parameters by their name, as `run` takes them."""
        of_causes = {f"{effect.id}.{p.name}": p for effect in self.candidates for p in effect.parameters}
        return {p.name: p for p in (*self.base, *self.run_parameters)} | of_causes

    @property
    def parameter_names(self) -> list[str]:
        """Names of the parameters of base and candidates."""
        return [*(p.name for p in self.base), *(f"{c.id}.{p.name}" for c in self.candidates for p in c.parameters)]

    @property
    def neutral_values(self) -> dict[str, float]:
        """Values that switch the candidates off, by name as `run` takes them."""
        values = ((effect, zip(effect.parameters, effect.neutral_values, strict=True)) for effect in self.candidates)
        return {f"{effect.id}.{p.name}": value for effect, pairs in values for p, value in pairs}

    def parameter_values(self, hypothesis: Hypothesis, coordinates: Array) -> dict[str, float]:
        """Return the values at these coordinates of the fit, as `run` takes them."""
        base, values = hypothesis.split(coordinates)
        out = {p.name: value for p, value in zip(self.base, base, strict=True)} | self.neutral_values
        for effect, row in zip(hypothesis.effects, values, strict=True):
            # An empirical term is added to what the simulator gives.
            if effect.id not in self.candidate_ids:
                continue
            out |= {f"{effect.id}.{p.name}": value for p, value in zip(effect.parameters, row, strict=True)}
        return out

    def __call__(self, inputs: Columns, parameters: Mapping[str, float], run_name: str = "") -> Columns:
        """Return the predicted channels of a run.

        Args:
            run_name: whose own parameters are taken, of those called `name@run`; the first run's where "".

        Raises:
            SimulatorFailed: it raises, a channel is missing, has another length, or is not finite.
        """
        try:
            # What overflows is found below, and is said once.
            with np.errstate(all="ignore"):
                answer: Columns | BaseException = self.run(inputs, self.parameters_of(parameters, run_name))
        except (Exception, SystemExit) as error:
            answer = error
        return self._checked(answer, len(inputs["t_s"]), parameters)

    def predict(self, run: "SimulatorRun", parameters: Mapping[str, float]) -> Columns:
        """Return the predicted channels of a run at the samples that are compared.

        Raises:
            SimulatorFailed: as of a call.
        """
        channels = self(run.driving(self.inputs), parameters, run.name)
        return {name: values[run.skipped :] for name, values in channels.items()}

    def predict_many(
        self, runs: Sequence["SimulatorRun"], parameter_sets: Sequence[Mapping[str, float]]
    ) -> list[list[Columns | SimulatorFailed]]:
        """Return for every place of the parameters the channels of all runs, or how a run failed; in one call."""
        if self.run_many is None:
            raise ValueError(f"simulator {self.name} has no run_many")
        calls = [
            (run.driving(self.inputs), self.parameters_of(parameters, run.name))
            for parameters in parameter_sets
            for run in runs
        ]
        answers = iter(self.run_many(calls))
        return [[self._answer(next(answers), run, parameters) for run in runs] for parameters in parameter_sets]

    def _answer(
        self, answer: Columns | BaseException, run: "SimulatorRun", parameters: Mapping[str, float]
    ) -> "Columns | SimulatorFailed":
        try:
            channels = self._checked(answer, run.skipped + len(run), parameters)
        except SimulatorFailed as error:
            return error
        return {name: values[run.skipped :] for name, values in channels.items()}

    def _checked(self, answer: Columns | BaseException, count: int, parameters: Mapping[str, float]) -> Columns:
        if isinstance(answer, BaseException):
            error = answer
            lines = [one.lineno for one in traceback.extract_tb(error.__traceback__) if one.filename == self._file]
            line = f", line {lines[-1]}" if lines else ""
            raise self._failed(f"{type(error).__name__}: {error}", parameters, line) from error
        out: dict[str, Array] = {}
        for channel in self.channels:
            if not isinstance(answer, Mapping) or channel not in answer:
                gives = ", ".join(map(str, answer)) if isinstance(answer, Mapping) else type(answer).__name__
                raise self._failed(f"gives no {channel}; it gives {gives or 'nothing'}", parameters)
            try:
                if np.iscomplexobj(answer[channel]):
                    raise TypeError("it is complex")
                out[channel] = np.asarray(answer[channel], dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise self._failed(f"{channel} is no array of numbers: {error}", parameters) from error
            if out[channel].shape != (count,):
                shapes = f"has shape {out[channel].shape}, t_s has {(count,)}"
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

    def _failed(self, cause: str, parameters: Mapping[str, float], line: str = "") -> SimulatorFailed:
        at = ", ".join(f"{name} = {value:.4g}" for name, value in parameters.items())
        return SimulatorFailed(f"simulator {self.name} ({self._file}{line}) fails: {cause}; at {at}")


PROBED = ExcitationRange(1.0, 1.0, 0.0, 1.0, 1.0, 1.0)
"""What probes of a mechanism are asked at; they do not depend on it."""


@dataclass(frozen=True)
class ForeignStep:
    """The step of an effect that a simulator makes by itself, `of` a term or of nothing more."""

    of: Any = None

    def __call__(self, flow: Flow, values: Sequence[float], state: Memory) -> None:
        raise ValueError("this effect belongs to a simulator, not to the twin of a soft sensor")


def _constant_probes(rows: Sequence[tuple[float, ...]], at: ExcitationRange) -> Sequence[tuple[float, ...]]:
    return rows


def candidate(
    name: str,
    place: str,
    *parameters: Parameter,
    probes: Sequence[tuple[float, ...]] = (),
    confounders: tuple[str, ...] = (),
) -> Effect:
    """Return an effect that a simulator can switch on.

    Args:
        name: how the report names it.
        place: the part of the mechanism it sits in; the report's `where`.
        parameters: the first is its size and has the neutral value that switches it off.
        probes: values at which a search begins; a fifth of the usual size where none are given.
        confounders: candidates it is mistaken for.
    """
    if not parameters or parameters[0].neutral is None:
        raise InputError(f"candidate {name}: its first parameter must have the neutral value that switches it off")
    signs = Signs(probes=partial(_constant_probes, tuple(probes)) if probes else None, confounders=confounders)
    return Effect(name, place, Hook.READING, "", "a simulator's own", parameters, ForeignStep(), signs=signs)


@dataclass(frozen=True, eq=False)
class SimulatorRun(Run):
    """One recorded run of a mechanism.

    Args:
        columns: its columns by name, (n,) each.
        lead_in: the columns before, which are simulated and not compared; empty where there are none.
    """

    columns: Columns = field(default_factory=dict)
    lead_in: Columns = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.t_s) < SHORTEST:
            raise InputError(f"{self.name}: {len(self.t_s)} samples; at least {SHORTEST} are needed for a diagnosis")
        if not np.all(np.diff(self.t_s) > 0):
            at = int(np.argmin(np.diff(self.t_s) > 0)) + 1
            raise InputError(f"{self.name}: t_s does not go on at sample {at}")
        for name, values in self.columns.items():
            if len(values) != len(self.t_s) or not np.all(np.isfinite(values)):
                raise InputError(f"{self.name}: {name} has {len(values)} samples or is not finite; t_s has {len(self)}")

    def column(self, name: str) -> Array:
        return self.columns[name]

    @property
    def skipped(self) -> int:
        """Samples at the start that are not compared."""
        return len(self.lead_in["t_s"]) if self.lead_in else 0

    def driving(self, inputs: Sequence[str]) -> dict[str, Array]:
        """Return `t_s` and the inputs from the first sample on, as a simulator takes them."""
        names = ("t_s", *inputs)
        if not self.lead_in:
            return {name: self.columns[name] for name in names}
        return {name: np.concatenate([self.lead_in[name], self.columns[name]]) for name in names}

    def changed(self, change: Callable[[Columns], Columns]) -> "SimulatorRun":
        """Return the run with other columns, those before alike."""
        return replace(self, columns=change(self.columns), lead_in=change(self.lead_in) if self.lead_in else {})


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
    numbers = {}
    for column in needed:
        try:
            numbers[column] = np.asarray(columns[column], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: {column} is no column of numbers: {error}") from error
        if numbers[column].ndim != 1:
            raise InputError(f"{name}: {column} has shape {numbers[column].shape}; one column was expected")
    return _run(simulator, name, numbers, profile)


def _run(simulator: Simulator, name: str, columns: Columns, profile: str = "") -> SimulatorRun:
    first = simulator.first_compared(columns["t_s"])
    lead_in, scored = (
        {n: values[part] for n, values in columns.items()} for part in (slice(first), slice(first, None))
    )
    if first and len(scored["t_s"]) < SHORTEST:
        raise InputError(
            f"{name}: {len(scored['t_s'])} samples after skip_s = {simulator.skip_s:g} s; {SHORTEST} are needed"
        )
    # The electronics of a soft sensor mean nothing here.
    return SimulatorRun(
        name, scored["t_s"], ReadoutMetadata(), profile=profile, columns=scored, lead_in=lead_in if first else {}
    )


def runs_of(case: Case) -> list[SimulatorRun]:
    """Return the runs of a case of a mechanism."""
    return [cast(SimulatorRun, run) for run in case.runs]


def planned(simulator: Simulator, name: str) -> SimulatorRun:
    """Return an experiment as the run it would be, its channels still empty (zeros)."""
    inputs = {k: np.asarray(v, dtype=np.float64) for k, v in simulator.experiments[name].inputs.items()}
    return _run(simulator, name, {channel: np.zeros(len(inputs["t_s"])) for channel in simulator.channels} | inputs)


REPEATABLE = 1e-7
"""Largest difference of equal calls, as a share of a channel's span: a tenth of what derivatives bear."""

MOVED, UNEQUAL = 1e-3, 0.5
"""Share of the largest change from which a sample is compared; share of samples and changes that rounding spoils."""

SMOOTH, FEWEST_STEPS, OFF_GRID = 1e-6, 8, 1e-3
"""Share of a span that a channel may be rounded to; steps that make a grid; how far off it a value lies, in steps."""


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

    def setdefault(self, name: str, default: Any = None) -> Any:
        self.names.add(name)
        return super().setdefault(name, default)

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

    def first(self, values: Mapping[str, float]) -> Array:
        """Return the channels of the first run, one after another."""
        return self._run(self._runs[0], values)

    def every(self, values: Mapping[str, float]) -> Array:
        """Return the channels of all runs, one after another."""
        return np.concatenate([self._run(run, values) for run in self._runs])

    def excited(self, values: Mapping[str, float]) -> Array:
        """Return the channels of the first run where every input swings about what was recorded."""
        driving = self._runs[0].driving(self.simulator.inputs)
        t_s = driving["t_s"]
        angle_rad = 2.0 * np.pi * (t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]), 1e-300)
        swings = {}
        for k, name in enumerate(self.simulator.inputs, start=1):
            column = driving[name]
            swings[name] = column + (float(np.max(np.abs(column))) or 1.0) * np.sin((2 * k + 1) * angle_rad)
        return self._run(self._runs[0], values, swings)

    def _run(self, run: SimulatorRun, values: Mapping[str, float], swings: Columns | None = None) -> Array:
        recorded = run.driving(self.simulator.inputs) | dict(swings or {})
        inputs = {name: column.copy() for name, column in recorded.items()}
        given: dict[str, float] = {}
        read = _ReadNames({})

        # Watched where the user's own code reads: what a simulator does before that reads every name.
        def run_watched(columns: Columns, parameters: Mapping[str, float]) -> Columns:
            given.update(parameters)
            read.update(parameters)
            return self.simulator.run(columns, read)

        channels = replace(self.simulator, run=run_watched)(inputs, values)
        self.names |= read.names
        self.is_iterated |= read.is_iterated
        self._refuse_written(inputs, recorded, "copy its inputs before changing them")
        self._refuse_written({name: dict.get(read, name) for name in given}, given, "copy the parameters")
        return np.concatenate([channels[name] for name in self.simulator.channels])

    def _refuse_written(self, after: Mapping[str, Any], before: Mapping[str, Any], cure: str) -> None:
        for name, values in before.items():
            if not np.array_equal(after[name], values):
                raise refused(self.simulator, f"writes into {name}; {cure}")


def refused(simulator: Simulator, cause: str) -> InputError:
    """Return the refusal of a simulator that cannot be fitted."""
    return InputError(f"simulator {simulator.name}: {cause}; nothing was fitted")


def check_calls(simulator: Simulator, runs: Sequence[SimulatorRun]) -> None:
    """Call a simulator a few times, and refuse one whose answers a fit could not use.

    A simulator that fails at its usual values is left to the fit, which goes elsewhere.

    Raises:
        InputError: equal calls differ, an input is written into, channels are rounded, or a parameter is never read.
    """
    calls, on = _Calls(simulator, runs), {name: p.usual for name, p in simulator.every_parameter.items()}
    off = on | simulator.neutral_values
    try:
        plain = calls.first(off)
        _refuse_differing(simulator, plain, calls.first(off), "called twice with equal arguments")
        with_causes = calls.first(on)
        after = "called again after a call with other parameters"
        _refuse_differing(simulator, plain, calls.first(off), after)
        moved = [calls.first(_moved(simulator, on, steps)) for steps in (1.0, 2.0)]
    except SimulatorFailed:
        return
    if np.array_equal(moved[1], with_causes) and np.array_equal(with_causes, plain):
        raise refused(simulator, "no parameter changes a channel; it gives what it gave before")
    one_each = len(runs[0]) + runs[0].skipped
    for k, channel in enumerate(simulator.channels):
        answers = [values[k * one_each : (k + 1) * one_each] for values in (plain, with_causes, *moved)]
        if _is_on_grid(answers):
            raise refused(simulator, f"it rounds {channel}; give it in full precision")
    if _jumps(moved[0] - with_causes, moved[1] - moved[0]):
        raise refused(
            simulator,
            "equal small steps of its parameters change its channels by unequal amounts: it rounds them, or an event "
            "in it jumps from one of its steps to the next; give full precision, and place an event between two steps",
        )
    _refuse_unread(calls, on)


def _refuse_differing(simulator: Simulator, one: Array, other: Array, when: str) -> None:
    apart = float(np.max(np.abs(one - other)))
    if apart > REPEATABLE * max(float(np.ptp(one)), float(np.max(np.abs(one)))):
        raise refused(
            simulator, f"{when} its channels differ by {apart:.3g}; fix the seed of its noise, and start anew each time"
        )


def _moved(simulator: Simulator, values: Mapping[str, float], steps: float) -> dict[str, float]:
    """Return the parameters, each moved by so many steps of the fit's difference quotients."""
    out = dict(values)
    for name, p in simulator.every_parameter.items():
        if not p.is_fixed:
            x, step = to_fit(p, values[name]), steps * DIFFERENCE * fit_scale(p)
            out[name] = from_fit(p, x + step if x + step <= max(to_fit(p, p.low), to_fit(p, p.high)) else x - step)
    return out


def _jumps(first: Array, second: Array) -> bool:
    """Whether most samples that two equal steps move are moved otherwise by the one than by the other."""
    larger = np.maximum(np.abs(first), np.abs(second))
    moves = larger > MOVED * np.max(larger, initial=0.0)
    return bool(moves.any() and np.mean(np.abs(second - first)[moves] > UNEQUAL * larger[moves]) > UNEQUAL)


def _is_on_grid(answers: Sequence[Array]) -> bool:
    """Whether a channel takes multiples of one coarse step alone, whatever its parameters are."""
    if all(np.array_equal(answers[0], other) for other in answers[1:]):
        return False
    values = np.unique(np.concatenate(answers))
    span = float(np.ptp(values))
    steps = np.diff(values)
    # Between two states a channel has one step, and is not rounded.
    step = float(np.min(steps[steps > 1e-12 * span], initial=np.inf))
    is_coarse = SMOOTH * span < step < np.inf and span > FEWEST_STEPS * step
    return bool(is_coarse and np.all(np.abs(values / step - np.round(values / step)) < OFF_GRID))


def _refuse_unread(calls: _Calls, values: Mapping[str, float]) -> None:
    """Refuse a parameter that is never read, or that is copied with all others and never changes a channel.

    What these runs alone do not excite is left to the diagnosis, which says that they cannot tell it.
    """
    simulator = calls.simulator
    for name, p in simulator.every_parameter.items():
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
