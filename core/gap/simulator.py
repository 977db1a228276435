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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import SHORTEST, Case, Run
from softcal.core.gap.coordinates import from_fit
from softcal.core.gap.fit import Around, Fit, Hypothesis, Problem
from softcal.core.gap.scale import RigScale
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.probes import Extent

Columns: TypeAlias = Mapping[str, Array]
Simulate: TypeAlias = Callable[[Columns, Mapping[str, float]], Columns]


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

    def __call__(self, inputs: Columns, parameters: Mapping[str, float]) -> Columns:
        """Return the predicted channels of a run.

        Raises:
            InputError: a channel is missing, has another length, or is not finite.
        """
        found = self.run(inputs, parameters)
        for channel in self.channels:
            if channel not in found:
                raise InputError(f"simulator {self.name}: gives no {channel}; it gives {', '.join(found)}")
            values = np.asarray(found[channel])
            if values.shape != np.shape(inputs["t_s"]) or not np.all(np.isfinite(values)):
                at = {name: f"{value:.4g}" for name, value in parameters.items()}
                raise InputError(
                    f"simulator {self.name}: {channel} has shape {values.shape} or is not finite at {at}; "
                    f"{np.shape(inputs['t_s'])} finite numbers were expected; narrow the bounds of the parameters"
                )
        return found


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
    return _run(name, inputs | {channel: np.zeros(len(inputs["t_s"])) for channel in simulator.channels})


@dataclass(frozen=True, eq=False)
class SimulatorHypothesis(Hypothesis):
    """The simulator with these candidates switched on."""

    base: tuple[Parameter, ...] = ()

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.base + tuple(p for effect in self.effects for p in effect.parameters)

    @property
    def of_base(self) -> slice:
        return slice(0, len(self.base))

    def named(self, coordinates: Array) -> dict[str, float]:
        """Return the values at these coordinates of the fit, as the simulator takes them."""
        values = [from_fit(p, float(x)) for p, x in zip(self.parameters, coordinates, strict=True)]
        out = {p.name: value for p, value in zip(self.base, values[self.of_base], strict=True)}
        for effect in self.effects:
            for p, value in zip(effect.parameters, values[self.slices[effect.id]], strict=True):
                out[f"{effect.id}.{p.name}"] = value
        return out


@dataclass(frozen=True, eq=False)
class SimulatorProblem(Problem):
    """Recorded channels of a mechanism as one vector, and what its simulator says of them."""

    simulator: Simulator | None = None

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
        found = self.case.runs[run]
        if not isinstance(found, SimulatorRun):
            raise ValueError(f"{found.name} is no run of a simulator")
        return found.columns[channel]

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

    def of_run(self, run: Run) -> Problem:
        return SimulatorProblem(Case(self.case.serial, (run,)), self.sigma, simulator=self.simulator)

    def predict_around(self, hypothesis: Hypothesis, coordinates: Array) -> tuple[Array, Around]:
        if not isinstance(hypothesis, SimulatorHypothesis):
            raise ValueError("a simulator's problem takes a simulator's hypothesis")
        off = {f"{c.id}.{p.name}": v for c in self.of.candidates for p, v in _off(c)}
        parameters = off | hypothesis.named(coordinates)
        out = np.empty(len(self.measured))
        last, found = -1, {}
        for block in self.blocks:
            if block.run != last:
                last = block.run
                inputs = {name: self.recorded(last, name) for name in ("t_s", *self.of.inputs)}
                found = dict(self.of(inputs, parameters))
            out[block.place] = found[block.channel]
        return out, self.predict


def _off(effect: Effect) -> list[tuple[Parameter, float]]:
    return list(zip(effect.parameters, effect.neutral_values, strict=True))


def noise_of(found: Fit) -> dict[str, float]:
    """Return σ per channel from second differences of the residual, the largest fiftieth left out."""
    levels = dict(found.problem.sigma)
    for channel in levels:
        parts = [
            (found.problem.measured - found.predicted)[b.place] for b in found.problem.blocks if b.channel == channel
        ]
        squares = np.sort(np.concatenate([np.diff(part, 2) ** 2 / 6.0 for part in parts]))
        kept = squares[: max(1, int(0.98 * len(squares)))]
        span = float(np.ptp(np.concatenate(parts))) or 1.0
        # A Gaussian without its largest 2 % of squares keeps 0.873 of its variance.
        levels[channel] = max(float(np.sqrt(np.mean(kept) / 0.873)), 1e-9 * span)
    return levels
