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
from typing import TypeAlias, cast

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import SHORTEST, Case, Run
from softcal.core.gap.problem import Hypothesis
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.probes import Extent

Columns: TypeAlias = Mapping[str, Array]

Simulate: TypeAlias = Callable[[Columns, Mapping[str, float]], Columns]

OFFSETS = ("zero", "gain", "delay", "drift")
"""What a run may have of its own in a channel."""

STRAIGHT = "straight"
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

    def __post_init__(self) -> None:
        for what, names in (
            ("channel", self.channels),
            ("base parameter", [p.name for p in (*self.base, *self.run_parameters)]),
            ("candidate", [c.id for c in self.candidates]),
        ):
            if not names:
                raise InputError(f"simulator {self.name}: no {what} is given; at least one was expected")
            if len(set(names)) < len(names):
                raise InputError(f"simulator {self.name}: two of the {what}s have one name: {', '.join(names)}")
        self._check_bounds()
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

    def _check_bounds(self) -> None:
        of_causes = [(f"{effect.id}.{p.name}", p) for effect in self.candidates for p in effect.parameters]
        for name, p in (*((p.name, p) for p in (*self.base, *self.run_parameters)), *of_causes):
            bounds = f"simulator {self.name}: {name} has the bounds {p.low:g} and {p.high:g} {p.unit}".rstrip()
            if not -np.inf < p.low < p.high < np.inf:
                raise InputError(f"{bounds}; two numbers were expected, the smaller first")
            if p.scale != "linear" and p.low <= 0.0:
                raise InputError(f"{bounds}; with scale={p.scale!r} both must be above 0")
            if not p.low <= p.usual <= p.high:
                raise InputError(f"{bounds} and the usual size {p.usual:g}; it must lie within them")

    @cached_property
    def offsets(self) -> tuple[tuple[str, str], ...]:
        """Channel and kind of what each run may have of its own; delays have a straightness."""
        own = [(channel, kind) for channel, kinds in self.per_run.items() for kind in kinds]
        return (*own, *((channel, STRAIGHT) for channel, kind in own if kind == "delay"))

    def of_runs(self, names: Sequence[str]) -> "Simulator":
        """Return the simulator with a base parameter for each run of these names in place of its own parameters."""
        own = tuple(replace(p, name=f"{p.name}@{name}") for name in names for p in self.run_parameters)
        return replace(self, base=(*self.base, *own), run_parameters=())

    def parameters_of(self, parameters: Mapping[str, float], run_name: str) -> Mapping[str, float]:
        """Return parameters as `run` takes them for one run: what that run has of its own by its plain name."""
        own = {name: value for name, value in parameters.items() if "@" in name}
        usual = {p.name: p.usual for p in self.run_parameters if p.name not in parameters}
        if not own and not usual:
            return parameters
        mine = {name.partition("@")[0]: value for name, value in own.items() if name.endswith(f"@{run_name}")}
        # A run that is not recorded yet begins where the first one did.
        first = {name.partition("@")[0]: value for name, value in reversed(own.items())}
        return usual | {name: value for name, value in parameters.items() if name not in own} | first | mine

    @cached_property
    def candidate_ids(self) -> frozenset[str]:
        return frozenset(c.id for c in self.candidates)

    @property
    def parameter_names(self) -> list[str]:
        """Names of all parameters, as `run` takes them."""
        return [*(p.name for p in self.base), *(f"{c.id}.{p.name}" for c in self.candidates for p in c.parameters)]

    @property
    def neutral_values(self) -> dict[str, float]:
        """Values that switch the candidates off, by name as `run` takes them."""
        values = ((effect, zip(effect.parameters, effect.neutral_values, strict=True)) for effect in self.candidates)
        return {f"{effect.id}.{p.name}": value for effect, pairs in values for p, value in pairs}

    def named(self, hypothesis: Hypothesis, coordinates: Array) -> dict[str, float]:
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
                found = self.run(inputs, self.parameters_of(parameters, run_name))
        except Exception as error:
            lines = [one.lineno for one in traceback.extract_tb(error.__traceback__) if one.filename == self._file]
            line = f", line {lines[-1]}" if lines else ""
            raise self._failed(f"{type(error).__name__}: {error}", parameters, line) from error
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
        probes: values at which a search begins; a fifth of the usual size where none are given.
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


def runs_of(case: Case) -> list[SimulatorRun]:
    """Return the runs of a case of a mechanism."""
    return [cast(SimulatorRun, run) for run in case.runs]


def planned(simulator: Simulator, name: str) -> SimulatorRun:
    """Return an experiment as the run it would be, its channels still empty (zeros)."""
    inputs = {k: np.asarray(v, dtype=np.float64) for k, v in simulator.experiments[name].inputs.items()}
    return _run(name, {channel: np.zeros(len(inputs["t_s"])) for channel in simulator.channels} | inputs)
