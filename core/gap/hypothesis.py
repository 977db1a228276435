"""A hypothesis: the base of a model with effects on top, and the coordinates in which a fit moves their parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from softcal.core.recording import Array, Mask
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.simulate import Chain

DIFFERENCE = 2e-4
"""Step of a derivative, in usual sizes of a parameter: beyond corners of play and clipping."""

LARGEST_LOG = float(np.log(np.finfo(np.float64).max))


@dataclass(frozen=True)
class Prior:
    """What is known of a base parameter before any run: which one, its mean and SD in coordinates of the fit."""

    index: int
    mean: float
    sd: float


def to_fit(parameter: Parameter, value: float) -> float:
    """Return the coordinate in which the fit moves this parameter."""
    if parameter.scale == "log":
        return float(np.log(value))
    return 0.0 if np.isinf(value) else (1.0 / value**2 if parameter.scale == "inverse_square" else value)


def from_fit(parameter: Parameter, coordinate: float) -> float:
    """Return the physical value at this coordinate of the fit."""
    if parameter.scale == "log":
        return float(np.exp(min(coordinate, LARGEST_LOG)))
    if parameter.scale == "inverse_square":
        return float(coordinate**-0.5) if coordinate > 0 else float("inf")
    return coordinate


def fit_scale(parameter: Parameter) -> float:
    """Return a natural step of this parameter in the coordinates of the fit."""
    if parameter.scale == "log":
        return 1.0
    # What is usually 0 tells no size; narrow bounds do.
    return abs(to_fit(parameter, parameter.usual)) or min(1.0, 0.1 * (parameter.high - parameter.low))


def start_coordinates(effects: Sequence[Effect], values: Sequence[Sequence[float]]) -> Array:
    """Return the coordinates of effect values, to be put after those of a base."""
    return np.array(
        [
            to_fit(p, v)
            for effect, row in zip(effects, values, strict=True)
            for p, v in zip(effect.parameters, row, strict=True)
        ]
    )


Episodes = tuple[Mapping[str, Array], ...]


BASE = (
    Parameter("u0_mm", "mm", -1e4, 1e4, 0.3),
    Parameter("k1_N_mm", "N/mm", 0.0, 1e4, 1.0),
    Parameter("k3_N_mm3", "N/mm³", 0.0, 1e4, 0.1),
    Parameter("r0_ohm", "ohm", 1e-6, 1e9, 4.0, scale="log"),
    Parameter("kappa_per_N", "1/N", 0.0, 1e3, 0.07),
)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The base with these effects on top.

    Args:
        episodes: per run, the rows of its episodic effects.
        of_all: parameters of the base, which every hypothesis has.
    """

    effects: tuple[Effect, ...] = ()
    episodes: Episodes = ()
    of_all: tuple[Parameter, ...] = BASE

    @cached_property
    def chain(self) -> Chain:
        return Chain(self.effects)

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Identifiers of the causes, sorted."""
        return tuple(sorted({effect.id for effect in self.effects}))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters: those of the base, then those of the effects in order."""
        return self.of_all + tuple(p for effect in self.effects for p in effect.parameters)

    def episodes_of(self, run: int) -> Mapping[str, Array]:
        return self.episodes[run] if self.episodes else {}

    @property
    def episode_count(self) -> int:
        """How many episodes were placed."""
        return sum(len(rows) for run in self.episodes for rows in run.values())

    @property
    def of_base(self) -> slice:
        """Where the base parameters stand in the vector of parameters."""
        return slice(0, len(self.of_all))

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where the parameters of every effect stand among all, the size first, by identifier."""
        ends = np.cumsum([self.of_base.stop, *(len(effect.parameters) for effect in self.effects)])
        return {e.id: slice(int(ends[k]), int(ends[k + 1])) for k, e in enumerate(self.effects)}

    def split(self, coordinates: Array) -> tuple[list[float], list[list[float]]]:
        """Return the values of the base and of every effect at these coordinates of the fit."""
        values = [from_fit(p, float(x)) for p, x in zip(self.parameters, coordinates, strict=True)]
        return values[self.of_base], [values[rows] for rows in self.slices.values()]

    def index_of(self, effect_id: str) -> int:
        """Return the index of the size of an effect among the coordinates."""
        return int(self.slices[effect_id].start)

    def without(self, effect_id: str) -> tuple["Hypothesis", Mask]:
        """Return this without one effect, and which coordinates, (parameters,), are left."""
        is_retained = np.ones(len(self.parameters), dtype=np.bool_)
        if effect_id in self.slices:
            is_retained[self.slices[effect_id]] = False
        return replace(self, effects=tuple(e for e in self.effects if e.id != effect_id)), is_retained

    def without_episodes(self) -> "Hypothesis":
        """Return the same effects on a run whose episodes nobody knows."""
        return replace(self, episodes=())

    def adding(self, *effects: Effect, episodes: Episodes | None = None) -> "Hypothesis":
        """Return this hypothesis with effects more, or with other realisations of those it has."""
        others = [e for e in self.effects if e.id not in {added.id for added in effects}]
        return replace(self, effects=(*others, *effects), episodes=self.episodes if episodes is None else episodes)


@dataclass(frozen=True)
class Probe:
    """An effect at a small size and one shape, to see which way it would move the prediction."""

    effect: Effect
    values: tuple[float, ...]
    is_one_sided: bool
