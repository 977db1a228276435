"""Definition of an effect of the twin: its stage, its equation, and its signature."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from softcal.core.messages.reason import Reason
from softcal.core.recording import Array
from softcal.core.twin.probes import ExcitationRange, Probes

ChainStage = Literal["motion", "mechanics", "transduction", "electronics", "load_cell", "acquisition"]
Scale = Literal["linear", "log", "inverse_square"]
Memory: TypeAlias = dict[str, Array]
"""What one effect remembers from chunk to chunk; empty at the start of a run."""


class Hook(IntEnum):
    """The places of the chain an effect can change, in the order of the signal."""

    MOTION = 0
    CONTACT = 1
    FORCE = 2
    CHANNEL = 3
    RESISTANCE = 4
    REFERENCE = 5
    OUTPUT = 6
    CLOCK = 7
    READING = 8


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect, with bounds and usual size.

    Args:
        name: as in the catalogue, without its unit.
        low, high: bounds within which a fit may move it; the neutral value may lie outside.
        usual: typical size on a rig.
        neutral: value that switches the effect off, None for a shape parameter.
        scale: how a fit moves it; `inverse_square` for a level whose absence is infinity.
        weight: its weight as a degree of freedom; less than 1 for a nuisance parameter of one run.
        is_fixed: it has one value on a rig, `usual`, and is not fitted.
    """

    name: str
    unit: str
    low: float
    high: float
    usual: float
    neutral: float | None = None
    scale: Scale = "linear"
    weight: float = 1.0
    is_fixed: bool = False


def _not_yet() -> Array:
    return np.empty(0)


@dataclass(eq=False, slots=True)
class Flow:
    """Signals of one stretch of a run in the chain; every stage changes its own.

    Args:
        t_s: (n,) time since the start of the run.
        step_s: (n,) time since the sample before, 0 at the start of a run.
        stage_mm: (n,) recorded stage position.
        temperature_rise_K: (n,) temperature above the run's first one; None if not recorded.
        episodes: per effect id (m, 2), the rows of an episodic effect in this run.
        run: position of this run in its case, for effects with values of their own in every run.
    """

    t_s: Array
    step_s: Array
    stage_mm: Array
    temperature_rise_K: Array | None
    vref_V: float
    episodes: Mapping[str, Array] = field(default_factory=dict)
    run: int = 0
    pad_mm: Array = field(default_factory=_not_yet)
    contact_mm: Array | float = 0.0
    toe_mm: float = 0.0
    toe_tail: float = 0.0
    compliance_mm_N: float = 0.0
    deformation_mm: Array = field(default_factory=_not_yet)
    force_N: Array = field(default_factory=_not_yet)
    drive: Array = field(default_factory=_not_yet)
    """What the channel feels: the force in N, or the deformation in mm of a strain sensor."""
    resistance_ohm: Array = field(default_factory=_not_yet)
    wiring_ohm: float = 0.0
    reference_V: Array | float = 0.0
    output_V: Array = field(default_factory=_not_yet)
    reading_N: Array = field(default_factory=_not_yet)
    is_unforeseeable: NDArray[np.bool_] | None = None
    """(n,) where nobody can foretell the output: past the end, or amid a step; None: nowhere."""

    @property
    def warmed_K(self) -> Array:
        """(n,) temperature above that of the run's first sample, 0 without a recorded temperature."""
        return np.zeros(len(self.t_s)) if self.temperature_rise_K is None else self.temperature_rise_K


Step: TypeAlias = Callable[[Flow, Sequence[float], Memory], None]
"""Change the flow in place by an effect with these parameter values and this memory."""


class SearchTarget(Enum):
    """Quantities of an effect that a search must estimate from the recordings before the fit."""

    LOSSES = "instants at which samples of the output were lost"
    INTERVALS = "intervals in which the resistance is off by a constant"
    LINE = "a line in the spectrum of the output, its phase free in every run"
    CEILING = "a level above which the output does not go"
    FLOOR = "a level below which the output does not go"


@dataclass(frozen=True)
class Alias:
    """A departure outside the catalogue that no run but a special one separates from an effect.

    Args:
        detail: its description; a plug-in gives a sentence, which is shown unchanged.
        share: of the effect's place that it gets while nothing tells the two apart.
        distinguished_by: kind of the run that tells them apart ...
        changing, by: ... when this channel changes in it by so much.
    """

    stage: ChainStage
    detail: Reason | str
    share: float
    distinguished_by: str
    changing: str
    by: float
    advice: Reason | str


@dataclass(frozen=True)
class Signs:
    """Signature of an effect: all that a diagnosis uses besides its equation.

    Args:
        needs: channels that must be recorded and change, besides the one of its stage.
        probes: where a search begins; the usual size and shapes around the usual ones where None.
        search_target: what must be found in the recordings first.
        clock: how its size moves the output's instants: by a constant, or in proportion to time.
        confounders: effects that look like it on poor recordings.
        best_experiments: experiments that show it best.
        remedy: what to measure where no experiment tells it from its rivals.
        alias: a departure outside the catalogue that looks exactly like it.
    """

    needs: tuple[str, ...] = ()
    probes: Probes | None = None
    search_target: SearchTarget | None = None
    clock: Literal["delay", "rate"] | None = None
    confounders: tuple[str, ...] = ()
    best_experiments: tuple[str, ...] = ()
    remedy: Reason | str = ""
    alias: Alias | None = None


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue of effects, or another equation of the same cause.

    Args:
        id: identifier of the catalogue.
        stage: of the chain; the part of the mechanism, for an effect of another simulator.
        hook: signal it changes.
        equation: its equation on top of the base model.
        source: where the equation or its usual size comes from.
        parameters: in the order `step` takes them; the first one is the size of the effect.
        is_episodic: it happens at a few instants of one run and does not carry over to another.
        of_runs: the same effect with separate values in every run, for a number of runs; None
            where one set of values holds for all.
        sides: other forms of the same effect, distinguished by the given parameters.
        forms: other realisations of the same cause that a rig may show.
        constants: numbers by name that the equation takes behind its parameters; a fit reads them
            off each recording (not a number here), a twin holds them.
    """

    id: str
    stage: str
    hook: Hook
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    step: Step
    is_episodic: bool = False
    signs: Signs = Signs()
    of_runs: "Callable[[int], Effect] | None" = None
    sides: "tuple[Effect, ...]" = ()
    forms: "tuple[Form, ...]" = ()
    constants: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if self.parameters and self.parameters[0].neutral is None:
            raise ValueError(f"the first parameter of {self.id} is its size and needs a neutral value")

    @property
    def neutral_values(self) -> tuple[float, ...]:
        """Values at which the effect changes nothing; shape parameters at their usual value."""
        return tuple(p.usual if p.neutral is None else p.neutral for p in self.parameters)

    @property
    def is_one_sided(self) -> bool:
        """Whether its size has one sign: from 0, or a level whose absence is infinity."""
        size = self.parameters[0]
        return size.low == 0.0 or size.neutral == np.inf

    @property
    def belongs_to_run(self) -> bool:
        """Whether the values of one run carry no information about another run."""
        return self.is_episodic or self.of_runs is not None

    def find_side(self, names: Sequence[str]) -> "Effect":
        """Return the side with parameters of these names; itself where none has all."""
        every = (self, *self.sides)
        return next((side for side in every if set(names) <= {p.name for p in side.parameters}), self)

    def probes(
        self, at: ExcitationRange, sized: Callable[[Parameter], Parameter] = lambda parameter: parameter
    ) -> list[tuple[float, ...]]:
        """Return the values at which a search on such a case begins, shapes within their bounds.

        Args:
            sized: gives a parameter the bounds it has on a rig of this size.
        """
        if self.signs.search_target in (SearchTarget.LOSSES, SearchTarget.INTERVALS, SearchTarget.LINE):
            return []
        first, *shapes = (sized(p) for p in self.parameters)
        rows: Sequence[tuple[float, ...]] = [(0.2 * first.usual,)]
        if self.signs.probes is not None:
            rows = self.signs.probes(at)
        elif shapes:
            usual = [p.usual for p in shapes]
            rows = [(0.2 * first.usual, factor * usual[0], *usual[1:]) for factor in (0.25, 1.0, 4.0)]
        return [
            (row[0], *(float(np.clip(v, p.low, p.high)) for p, v in zip(shapes, row[1:], strict=True))) for row in rows
        ]

    @property
    def value_names(self) -> tuple[str, ...]:
        return (*(p.name for p in self.parameters), *(name for name, _ in self.constants))

    def find_form(self, name: str) -> "Effect | None":
        """Return the form of this name, itself for an empty one; None without such a form."""
        return next((f.effect for f in self.forms if f.effect.equation == name), None) if name else self

    def with_forms(self, *makers: "Callable[[Effect], Form]") -> "Effect":
        return replace(self, forms=tuple(make(self) for make in makers))


@dataclass(frozen=True)
class Form:
    """Another realisation of a cause.

    Args:
        carry: each parameter from the catalogue's values, as (index or None, factor or value).
    """

    effect: Effect
    carry: tuple[tuple[int | None, float], ...]

    def start(self, values: Sequence[float], factor: Callable[[str], float] = lambda unit: 1.0) -> list[float]:
        """Return where a fit of this form begins when the catalogue's ended at these values.

        Args:
            factor: by what a quantity of a unit is larger on this rig than on the common one.
        """
        return [
            number * factor(p.unit) if index is None else values[index] * number
            for p, (index, number) in zip(self.effect.parameters, self.carry, strict=True)
        ]


Quantity: TypeAlias = Callable[[Flow, Sequence[float], Memory], Array | float]
"""Compute something from the flow, the parameter values and the memory of an effect."""


def set_signal(signal: str, value: Quantity) -> Step:
    """Return a step that gives one signal of the flow, by its name there, a new value."""

    def step(flow: Flow, values: Sequence[float], state: Memory) -> None:
        setattr(flow, signal, value(flow, values, state))

    return step


def adds(signal: str, part: Quantity) -> Step:
    """Return a step that adds the size of the effect times a part: x + v₀·part."""
    return set_signal(signal, lambda flow, v, state: getattr(flow, signal) + v[0] * part(flow, v, state))


def grows(signal: str, part: Quantity) -> Step:
    """Return a step by which a signal grows: x·(1 + v₀·part)."""
    return set_signal(signal, lambda flow, v, state: getattr(flow, signal) * (1.0 + v[0] * part(flow, v, state)))


def hands_on(*names: str) -> Step:
    """Return a step that writes its parameter values into the flow, by these names."""

    def step(flow: Flow, values: Sequence[float], _: Memory) -> None:
        for name, value in zip(names, values, strict=True):
            setattr(flow, name, value)

    return step


def memory(memory: Memory, name: str, *start: float) -> Array:
    """Return the named state array of an effect, created from its start values on first use."""
    if name not in memory:
        memory[name] = np.array(start, dtype=np.float64)
    return memory[name]
