"""What a fit is of: a hypothesis, and measured channels as one vector with weights."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from softcal.core.gap.case import Case, Mask, Run, RunKind
from softcal.core.gap.linear import (
    NoiseCorrelation,
    Prior,
    RigScale,
    bounded_sizes,
    filter_of,
    filtered,
    from_fit,
    gram,
)
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.simulate import Chain

if TYPE_CHECKING:
    from softcal.core.gap.method import GapMethod, NoiseCorrelationConfig
    from softcal.core.gap.model import Directions, Model, Sizes

LINEAR_SIGMA = 0.5
"""Share of its noise that an offset may move a sample along the slope: bends err far less."""

PASSES = 3
"""How often offsets that bend a channel are taken up anew: what is left shrinks by its square."""

Episodes = tuple[Mapping[str, Array], ...]

Around: TypeAlias = Callable[["Hypothesis", Array], Array]
"""Predict, (samples,), near to other coordinates, with a small effect more or less."""

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
class Block:
    """Where the samples of one channel of one run stand in the vectors of a problem."""

    run: int
    channel: str
    rows: slice


@dataclass(frozen=True, eq=False)
class Problem:
    """The measured channels of a case as one vector with noise weights.

    Args:
        sigma: per channel, standard deviation of the white noise, in the channel's unit.
        weight_of_sample: (samples,) which samples a fit may see; all where None.
        extra_variance: (samples,) variance that comes with the noise of the driving channel.
        has_offsets: whether every run may have something of its own, such as a zero.
        correlation: per channel whose noise is not white, the part that fades.
        of_rig: the size of the rig; read off the runs where None.
        of_base: of every offset, whether the base has what all runs share of it; as its kind says where empty.
    """

    model: "Model"
    case: Case
    sigma: Mapping[str, float]
    weight_of_sample: Array | None = None
    extra_variance: Array | None = None
    has_offsets: bool = True
    correlation: Mapping[str, NoiseCorrelation] = field(default_factory=dict)
    of_rig: RigScale | None = None
    of_base: tuple[bool, ...] = ()

    @property
    def method(self) -> "GapMethod":
        """Every number of the diagnosis."""
        return self.model.method

    @cached_property
    def scale(self) -> RigScale:
        return self.of_rig or self.model.scale_of(self.case)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        blocks, at = [], 0
        for k, run in enumerate(self.case.runs):
            for channel in self.model.channels_of(run):
                blocks.append(Block(k, channel, slice(at, at + len(run))))
                at += len(run)
        return tuple(blocks)

    def blocks_of(self, channel: str, kind: RunKind | None = None) -> list[Block]:
        """Return the blocks of a channel, of runs of one kind where it is given."""
        runs = self.case.runs
        return [b for b in self.blocks if b.channel == channel and kind in (None, runs[b.run].kind)]

    @cached_property
    def measured(self) -> Array:
        """(samples,) all channels of all runs, block by block."""
        return np.concatenate([self.recorded(b.run, b.channel) for b in self.blocks])

    def recorded(self, run: int, channel: str) -> Array:
        """Return a recorded channel of a run, (n,)."""
        return self.model.recorded(self.case.runs[run], channel)

    @cached_property
    def correlation_config(self) -> "NoiseCorrelationConfig":
        """How noise that fades is read."""
        return self.method.colour.slower(self.model.times_slower(self.case))

    def noise_range(self, channel: str) -> tuple[float, float]:
        """Return the least and the largest noise of a channel that is believed."""
        return self.model.noise_range(self, channel)

    @cached_property
    def priors(self) -> Sequence[Prior]:
        """What is known of the base beforehand; a run that is only planned does not tell it again."""
        return () if self.case.is_planned else self.model.priors

    @property
    def scored_channels(self) -> list[str]:
        """Channels whose gap is measured."""
        return self.model.scored_channels(self)

    def of_run(self, run: Run) -> "Problem":
        """Return the problem of a run that is not recorded yet, under the same noise."""
        case = Case(self.case.serial, (run,), is_planned=True)
        return replace(self, case=case, weight_of_sample=None, extra_variance=None, has_offsets=True, of_rig=self.scale)

    @cached_property
    def noise(self) -> Array:
        """(samples,) standard deviation of the noise of every sample."""
        noise = np.concatenate([np.full(b.rows.stop - b.rows.start, self.sigma[b.channel]) for b in self.blocks])
        return noise if self.extra_variance is None else np.sqrt(noise**2 + self.extra_variance)

    @cached_property
    def slow_noise(self) -> Array:
        """(samples,) standard deviation of white noise as strong as this near zero frequency."""
        if not self.correlation:
            return self.noise
        variance = self.noise**2
        for block in (b for b in self.blocks if b.channel in self.correlation):
            step_s = float(np.median(self.case.runs[block.run].step_s))
            variance[block.rows] += self.correlation[block.channel].slow_variance(step_s)
        return np.sqrt(variance)

    @cached_property
    def total_noise(self) -> Array:
        """(samples,) standard deviation of the noise, the part that fades included."""
        noise = self.noise.copy()
        for block in (b for b in self.blocks if b.channel in self.correlation):
            noise[block.rows] = np.hypot(noise[block.rows], self.correlation[block.channel].spread)
        return noise

    def noise_floor(self, channel: str) -> float:
        """Return the standard deviation of the noise of a channel, the part that fades included."""
        fading = self.correlation[channel].spread if channel in self.correlation else 0.0
        return float(np.hypot(self.sigma[channel], fading))

    @cached_property
    def weights(self) -> Array:
        """(samples,) 1/σ of the white noise, 0 where a fit may not look."""
        return 1.0 / self.noise if self.weight_of_sample is None else self.weight_of_sample / self.noise

    def whitened(self, values: Array) -> Array:
        """Return (samples + priors,) independent values over their noise, 0 where a fit may not look."""
        out = np.append(values * self.weights, np.zeros(len(self.priors)))
        for block, steps in self._filters:
            out[block.rows] = filtered(values[block.rows], steps)
        return out

    def residual(self, predicted: Array, coordinates: Array) -> Array:
        """Return (samples + priors,) what a prediction leaves, and how far its base lies from what is known of it."""
        out = self.whitened(self.measured - predicted)
        for k, prior in enumerate(self.priors, start=len(predicted)):
            out[k] = (prior.mean - coordinates[prior.index]) / prior.sd
        return out

    def jacobian(self, slopes: Array) -> Array:
        """Return (parameters, samples + priors) derivatives of what is compared, from those of a prediction."""
        out = np.array([self.whitened(row) for row in slopes])
        for k, prior in enumerate(self.priors, start=len(self.measured)):
            out[prior.index, k] = 1.0 / prior.sd
        return out

    @cached_property
    def _filters(self) -> list[tuple[Block, Array]]:
        weight_of_sample, filters = (
            np.ones(len(self.measured)) if self.weight_of_sample is None else self.weight_of_sample,
            [],
        )
        for block in (b for b in self.blocks if b.channel in self.correlation):
            step_s, of = self.case.runs[block.run].step_s, self.correlation[block.channel]
            is_used = weight_of_sample[block.rows].astype(np.float64)
            filters.append((block, filter_of(self.noise[block.rows], is_used, step_s, of.spread, of.fading_s)))
        return filters

    @cached_property
    def is_free(self) -> Array:
        """(base,) which base parameters these channels determine."""
        return self.model.is_free(self.case)

    @cached_property
    def largest_offsets(self) -> Array:
        """(k,) bounds of what every run has of its own."""
        return self.model.largest_offsets(self.case)

    @property
    def are_relative(self) -> Mask:
        """(k,) of which offsets only what the runs differ by is taken off."""
        return np.array(self.of_base, dtype=np.bool_) if self.of_base else self.model.are_relative

    @property
    def is_driven_by_force(self) -> bool:
        """Whether a measured force, with its noise, drives the chain in place of a stage."""
        return self.extra_variance is not None

    @property
    def count(self) -> int:
        """Samples a fit may see."""
        return int(np.count_nonzero(self.weights))

    def predict(self, hypothesis: Hypothesis, coordinates: Array) -> Array:
        """Return the clean prediction, (samples,), at these coordinates of the fit."""
        return self.predict_around(hypothesis, coordinates)[0]

    def predict_around(self, hypothesis: Hypothesis, coordinates: Array) -> tuple[Array, "Around"]:
        """Return the clean prediction, (samples,), and what foretells it nearby in one pass."""
        out = self.clean(hypothesis, coordinates, {})
        if not self.has_offsets or self.case.is_planned or not len(self.largest_offsets):
            return self.model.with_unknown(self, out), self.predict
        out, nearby = with_offsets(self, hypothesis, coordinates, out)
        out = nearby.added(self, out)

        def around(other: Hypothesis, near: Array) -> Array:
            return self.model.with_unknown(self, nearby.added(self, self.clean(other, near, nearby.moved)))

        return self.model.with_unknown(self, out), around

    def offset_sizes(self, hypothesis: Hypothesis, coordinates: Array) -> dict[int, Array]:
        """Return by run, (k,), what it has of its own at these coordinates."""
        clean, nearby = with_offsets(self, hypothesis, coordinates, self.clean(hypothesis, coordinates, {}))
        sizes = nearby.sizes(self, clean)
        return {run: size + nearby.moved.get(run, 0.0) for run, size in sizes.items()}

    def directions(self, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: "Sizes") -> "Directions":
        """Return how a prediction with these offsets in it changes with each of them."""
        return self.model.directions(self, hypothesis, coordinates, clean, sizes)

    def prepare(self, points: Sequence[tuple[Hypothesis, Array]]) -> None:
        """Make predictions at several places at once, where the model is quicker so."""
        self.model.prepare(self, points)

    def clean(self, hypothesis: Hypothesis, coordinates: Array, sizes: "Sizes") -> Array:
        """Return the (samples,) prediction with these offsets in it, NaN where nobody can know."""
        return self.model.clean(self, hypothesis, coordinates, sizes)

    def seeing(self, weight_of_sample: Array) -> "Problem":
        """Return the same problem with other samples open to the fit."""
        return replace(self, weight_of_sample=weight_of_sample)

    @cached_property
    def bare(self) -> "Problem":
        """The same problem with one zero, one resistance and one seat for all runs."""
        return replace(self, has_offsets=False)

    def with_noise(
        self, sigma: Mapping[str, float], correlation: Mapping[str, NoiseCorrelation] | None = None
    ) -> "Problem":
        """Return the same problem under other noise, of the same colour where none is given."""
        return replace(self, sigma=sigma, correlation=self.correlation if correlation is None else correlation)


@dataclass(frozen=True, eq=False)
class Nearby:
    """The offsets around one prediction, and along what they move nearby; `moved` is in it already."""

    directions: "Directions"
    moved: "Sizes" = field(default_factory=dict)
    _products: dict[int, tuple[Array, Array]] = field(default_factory=dict, repr=False)

    def _pulling(self, problem: Problem, number: int, rows: Array) -> tuple[Array, Array]:
        """Return the rows of a block over the noise's variance, and their products: the same at every asking."""
        if number not in self._products:
            weighted = rows / problem.slow_noise[problem.blocks[number].rows]
            self._products[number] = weighted / problem.slow_noise[problem.blocks[number].rows], gram(weighted)
        return self._products[number]

    def sizes(self, problem: Problem, clean: Array) -> dict[int, Array]:
        """Return what is still to be added to a prediction, (samples,) with `moved` in it."""
        pairs = list(zip(problem.blocks, self.directions, strict=True))
        runs, count = list(dict.fromkeys(b.run for b, rows in pairs if rows is not None)), len(problem.largest_offsets)
        normal, slope = np.zeros((len(runs), count, count)), np.zeros((len(runs), count))
        residual = problem.measured - clean
        is_finite = bool(np.isfinite(residual.sum()))
        for number, (block, rows) in enumerate(pairs):
            if rows is not None:
                k, error = runs.index(block.run), residual[block.rows]
                pulling, product = self._pulling(problem, number, rows)
                if not is_finite:
                    # A sample that nobody can foretell tells nothing.
                    has_value = np.isfinite(error)
                    pulling, error = np.where(has_value, pulling, 0.0), np.where(has_value, error, 0.0)
                    product = gram(np.where(has_value, rows, 0.0) / problem.slow_noise[block.rows])
                normal[k] += product
                slope[k] += pulling @ error
        has = np.array([self.moved.get(run, np.zeros(count)) for run in runs]).reshape(len(runs), count)
        sizes = bounded_sizes(normal, slope, has, problem.largest_offsets, problem.are_relative)
        return dict(zip(runs, sizes, strict=True))

    def added(self, problem: Problem, clean: Array) -> Array:
        """Return a prediction, (samples,) with `moved` in it, with what the offsets add to it."""
        out, sizes = clean.copy(), self.sizes(problem, clean)
        for block, rows in zip(problem.blocks, self.directions, strict=True):
            if rows is not None:
                out[block.rows] += sizes[block.run] @ rows
        return out


def with_offsets(problem: Problem, hypothesis: Hypothesis, coordinates: Array, clean: Array) -> tuple[Array, Nearby]:
    """Return a (samples,) prediction with the offsets that bend it, and how all move nearby."""
    near = Nearby(problem.directions(hypothesis, coordinates, clean, {}))
    for _ in range(PASSES - 1):
        sizes, bending = near.sizes(problem, clean), np.flatnonzero(problem.model.are_bending)
        # Where no offset moves a channel further than its slope foretells, the slope will do.
        if not len(bending) or not any(
            rows is not None
            and np.abs(rows[bending] * sizes[block.run][bending, np.newaxis]).max()
            > LINEAR_SIGMA * problem.noise[block.rows].min()
            for block, rows in zip(problem.blocks, near.directions, strict=True)
        ):
            break
        # A lower surface moves the corner of first touch, which a step along the slope would leave.
        moved = {run: step + near.moved.get(run, 0.0) for run, step in sizes.items()}
        clean = problem.clean(hypothesis, coordinates, moved)
        near = Nearby(problem.directions(hypothesis, coordinates, clean, moved), moved)
    return clean, near


def rows_of_runs(problem: Problem, directions: "Directions") -> dict[int, Array]:
    """Return by run, (k, samples), how a prediction changes with its offsets; 0 in other runs."""
    out: dict[int, Array] = {}
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            out.setdefault(block.run, np.zeros((len(rows), len(problem.measured))))[:, block.rows] = rows
    return out


def nuisance_rows(problem: Problem, directions: "Directions") -> tuple[list[Array], tuple[int, ...]]:
    """Return (samples,) rows along which runs may move on their own, and the kind of each.

    Of what is relative they move by what they differ by alone; one run alone by all of it.
    """
    of_run = rows_of_runs(problem, directions).values()
    out: list[Array] = []
    kinds: list[int] = []
    for kind, is_relative in enumerate(problem.are_relative):
        each = [rows[kind] for rows in of_run if rows[kind].any()]
        if is_relative and not problem.case.is_planned:
            each = [row - each[0] for row in each[1:]]
        out, kinds = out + each, kinds + [kind] * len(each)
    return out, tuple(kinds)
