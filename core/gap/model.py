"""A model that predicts recordings, softcal's twin or a foreign simulator; the problem of a fit; a fit.

The three refer to one another: a model predicts the channels of a problem, and is asked what a fit leaves.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from softcal.core.gap.case import Case, DataMistake, MenuEntry, RigScale, Run, RunKind
from softcal.core.gap.hypothesis import Hypothesis, Prior, Probe
from softcal.core.gap.linear import NoiseCorrelation, bounded_sizes, energy, filter_of, filtered, gram, scaled_inverse
from softcal.core.gap.method import GapMethod, NoiseCorrelationConfig
from softcal.core.recording import Array, Mask
from softcal.core.twin.effects import Effect, Form, Parameter
from softcal.core.twin.parameters import BaseParameters

Sizes: TypeAlias = Mapping[int, Array]
"""By run, (k,), the sizes of its offsets that are in a prediction."""

Directions: TypeAlias = list[Array | None]
"""Per block, (k, n), how a channel changes with each offset; None where a run has none."""

Mistakes: TypeAlias = "tuple[DataMistake, ...]"


class Model(ABC):
    """What predicts recordings, what it may lack, and what every run may have of its own: a zero, a delay.

    Args:
        method: every number of the diagnosis.
        base: parameters that every hypothesis has.
        candidates: effects it may lack; causes are sought among them.
        offset_names: of what every run may have of its own.
        are_relative: of which offsets only what the runs differ by is taken off.
        channels: whose gap is measured, where they were recorded.
        priors: what is known of the base before any run.
        are_bending: which offsets move a channel other than in proportion.
        is_partly_unknown: whether a sample that nobody can foretell costs what a right prediction would; else a fit
            must not go where one is.
        hands_on_closest: whether the set of least error held back is handed on where no cause is certain.
        smooth_order: which differences of a residual hold noise alone: second ones where all is quick.
    """

    method: GapMethod
    smooth_order: int
    is_partly_unknown: bool
    hands_on_closest: bool

    @property
    @abstractmethod
    def base(self) -> tuple[Parameter, ...]: ...

    @property
    @abstractmethod
    def candidates(self) -> tuple[Effect, ...]: ...

    def forms_of(self, cause: str) -> Sequence[Form]:
        """Return other realisations of a cause."""
        return next((effect.forms for effect in self.candidates if effect.id == cause), ())

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]: ...

    @property
    @abstractmethod
    def priors(self) -> Sequence[Prior]: ...

    @property
    @abstractmethod
    def offset_names(self) -> tuple[str, ...]: ...

    @property
    @abstractmethod
    def are_relative(self) -> Mask: ...

    @property
    @abstractmethod
    def are_bending(self) -> Mask: ...

    # What it predicts.

    @abstractmethod
    def scale_of(self, case: Case) -> RigScale:
        """Return by what a rig is larger than the one of the bounds of its parameters."""

    @abstractmethod
    def channels_of(self, run: Run) -> tuple[str, ...]:
        """Return the recorded channels of a run that are predicted."""

    @abstractmethod
    def noise_range(self, problem: Problem, channel: str) -> tuple[float, float]:
        """Return the least and the largest noise of a channel that is believed: one without any has no weight."""

    @abstractmethod
    def times_slower(self, case: Case) -> float:
        """Return by what these runs are slower than those of a common rig."""

    @abstractmethod
    def is_free(self, case: Case) -> Array:
        """Return (base,) which base parameters these channels determine."""

    @abstractmethod
    def largest_offsets(self, case: Case) -> Array:
        """Return (k,) bounds of what every run has of its own."""

    def prepare(self, problem: Problem, points: Sequence[tuple[Hypothesis, Array]]) -> None:
        """Make predictions at several places at once, and store them; one after another is as quick."""
        return

    @abstractmethod
    def clean(self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        """Return the (samples,) prediction with these offsets in it, NaN where nobody can know."""

    @abstractmethod
    def directions(
        self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes
    ) -> Directions:
        """Return how a prediction with these offsets in it changes with each of them."""

    # What it leaves.

    @abstractmethod
    def is_clean(self, result: Fit) -> bool:
        """Whether a hypothesis leaves no structure."""

    @abstractmethod
    def is_uneven(self, result: Fit) -> bool:
        """Whether noise that a hypothesis leaves is not the same everywhere."""

    @abstractmethod
    def followed(self, result: Fit, channel: str) -> Iterable[Sequence[Array]]:
        """Give groups of (samples,) columns that the residual of a channel may follow."""

    @abstractmethod
    def halves(self, result: Fit, block: Block) -> tuple[Mask | None, ...]:
        """Return which samples of a block, (n,), lie in one of two conditions; None where nothing tells."""

    @abstractmethod
    def load_of(self, result: Fit) -> Array:
        """Return (samples,) how much the mechanism is loaded."""

    def states(self, result: Fit) -> Sequence[Array]:
        """Return (samples,) each, of what the size of a cause may depend; none where the list has every law's forms."""
        return ()

    def laws(self, base: Fit) -> Mapping[str, Sequence[Array]]:
        """Return by candidate (samples,) whitened changes of the prediction, one for each of several shapes."""
        return {}

    @abstractmethod
    def axes_of(self, result: Fit, run: int) -> tuple[str, Array, Array]:
        """Return the column that drives a run, its values and the load, (n,) each, as a figure shows them."""

    # How causes are sought.

    @abstractmethod
    def mistakes(self, case: Case) -> Mistakes:
        """Return mistakes that recordings show by themselves."""

    @abstractmethod
    def base_of_mistaken_case(self, case: Case) -> Fit:
        """Return the base that a report of mistaken recordings shows."""

    @abstractmethod
    def base_fit(self, case: Case) -> Fit:
        """Fit the base alone to all runs, with noise levels taken from its own residual."""

    @abstractmethod
    def mistakes_by_base(self, base: Fit) -> tuple[Mistakes, Mistakes]:
        """Return mistakes that a fitted base shows, and questions that are asked beside a diagnosis."""

    @abstractmethod
    def visible(self, case: Case) -> tuple[Effect, ...]:
        """Return the candidates that these runs can show at all."""

    @abstractmethod
    def probes(self, base: Fit, effects: Sequence[Effect]) -> tuple[Probe, ...]:
        """Return where a search begins for effects that need not be placed in time first."""

    @abstractmethod
    def start_again(self, base: Fit, candidates: Sequence[Effect], fits: Fits, store: Callable[[Fit], None]) -> None:
        """Fit hypotheses from other starts, for structure is left.

        Args:
            fits: by their causes; what `store` takes goes on in them.
        """

    @abstractmethod
    def departures(self, case: Case) -> tuple[Effect, ...]:
        """Return departures outside the list that these runs can show."""

    # What is reported.

    @abstractmethod
    def menu(self, base: Fit) -> Sequence[MenuEntry]:
        """Return the experiments that could be made."""

    @abstractmethod
    def terms(self, base: Fit) -> Iterable[Any]:
        """Give the empirical terms that may be tried on what is left."""


LINEAR_SIGMA = 0.5
"""Share of its noise that an offset may move a sample along the slope: bends err far less."""


PASSES = 3
"""How often offsets that bend a channel are taken up anew: what is left shrinks by its square."""


Around: TypeAlias = Callable[["Hypothesis", Array], Array]
"""Predict, (samples,), near to other coordinates, with a small effect more or less."""


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

    model: Model
    case: Case
    sigma: Mapping[str, float]
    weight_of_sample: Array | None = None
    extra_variance: Array | None = None
    has_offsets: bool = True
    correlation: Mapping[str, NoiseCorrelation] = field(default_factory=dict)
    of_rig: RigScale | None = None
    of_base: tuple[bool, ...] = ()

    @property
    def method(self) -> GapMethod:
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
        return self.case.runs[run].column(channel)

    @cached_property
    def correlation_config(self) -> NoiseCorrelationConfig:
        """How noise that fades is read."""
        return self.method.noise_correlation.slower(self.model.times_slower(self.case))

    @cached_property
    def priors(self) -> Sequence[Prior]:
        """What is known of the base beforehand; a run that is only planned does not tell it again."""
        return () if self.case.is_planned else self.model.priors

    @property
    def scored_channels(self) -> list[str]:
        """Channels whose gap is measured."""
        return [c for c in self.model.channels if any(b.channel == c for b in self.blocks)]

    def of_run(self, run: Run) -> Problem:
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

    def predict_around(self, hypothesis: Hypothesis, coordinates: Array) -> tuple[Array, Around]:
        """Return the clean prediction, (samples,), and what foretells it nearby in one pass."""
        out = self.clean(hypothesis, coordinates, {})
        if not self.has_offsets or self.case.is_planned or not len(self.largest_offsets):
            return self._with_unknown(out), self.predict
        out, nearby = with_offsets(self, hypothesis, coordinates, out)
        out = nearby.added(self, out)

        def around(other: Hypothesis, near: Array) -> Array:
            return self._with_unknown(nearby.added(self, self.clean(other, near, nearby.moved)))

        return self._with_unknown(out), around

    def _with_unknown(self, predicted: Array) -> Array:
        unknown = np.isnan(predicted)
        if not (self.model.is_partly_unknown and unknown.any()):
            return predicted
        return np.where(unknown, self.measured - self.noise, predicted)

    def offset_sizes(self, hypothesis: Hypothesis, coordinates: Array) -> dict[int, Array]:
        """Return by run, (k,), what it has of its own at these coordinates."""
        clean, nearby = with_offsets(self, hypothesis, coordinates, self.clean(hypothesis, coordinates, {}))
        sizes = nearby.sizes(self, clean)
        return {run: size + nearby.moved.get(run, 0.0) for run, size in sizes.items()}

    def directions(self, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes) -> Directions:
        """Return how a prediction with these offsets in it changes with each of them."""
        return self.model.directions(self, hypothesis, coordinates, clean, sizes)

    def clean(self, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        """Return the (samples,) prediction with these offsets in it, NaN where nobody can know."""
        return self.model.clean(self, hypothesis, coordinates, sizes)

    def seeing(self, weight_of_sample: Array) -> Problem:
        """Return the same problem with other samples open to the fit."""
        return replace(self, weight_of_sample=weight_of_sample)

    @cached_property
    def bare(self) -> Problem:
        """The same problem with one zero, one resistance and one seat for all runs."""
        return replace(self, has_offsets=False)

    def with_noise(
        self, sigma: Mapping[str, float], correlation: Mapping[str, NoiseCorrelation] | None = None
    ) -> Problem:
        """Return the same problem under other noise, of the same colour where none is given."""
        return replace(self, sigma=sigma, correlation=self.correlation if correlation is None else correlation)


@dataclass(frozen=True, eq=False)
class Nearby:
    """The offsets around one prediction, and along what they move nearby; `moved` is in it already."""

    directions: Directions
    moved: Sizes = field(default_factory=dict)
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


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its best parameters.

    Args:
        chi2: sum of squared residuals over σ², over the samples the fit saw.
        slopes: (parameters, samples) derivative of the prediction; rows that were held fixed are 0.
    """

    problem: Problem
    hypothesis: Hypothesis
    coordinates: Array
    predicted: Array
    chi2: float
    slopes: Array = field(repr=False)

    @cached_property
    def jacobian(self) -> Array:
        """(parameters, samples + priors) derivative of the whitened prediction; rows held fixed are 0."""
        return self.problem.jacobian(self.slopes)

    @cached_property
    def base(self) -> BaseParameters:
        """The base parameters of the twin."""
        return BaseParameters(*self.hypothesis.split(self.coordinates)[0])

    @property
    def ids(self) -> tuple[str, ...]:
        """Identifiers of the causes, sorted."""
        return self.hypothesis.ids

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects on top of the base."""
        return self.hypothesis.effects

    @cached_property
    def effect_values(self) -> list[list[float]]:
        return self.hypothesis.split(self.coordinates)[1]

    @cached_property
    def residual(self) -> Array:
        """(samples + priors,) measured − predicted, whitened: in white noise over σ."""
        return self.problem.residual(self.predicted, self.coordinates)

    @cached_property
    def covariance(self) -> Array:
        """(parameters, parameters) of the coordinates; rows of fixed parameters are 0."""
        normal = gram(self.jacobian)
        free = np.ix_(*2 * (np.flatnonzero(np.diag(normal) > 0),))
        covariance = np.zeros_like(normal)
        covariance[free] = scaled_inverse(normal[free])
        return covariance

    def under(self, problem: Problem) -> Fit:
        """Return the same parameters scored under another noise level."""
        return replace(self, problem=problem, chi2=energy(problem.residual(self.predicted, self.coordinates)))

    @property
    def penalty(self) -> float:
        """p·ln(n) of Schwarz for the flexibility, and −2·ln of the prior odds of the causes."""
        # Many causes are tried: without prior odds the luckiest would often win by chance.
        evidence = self.problem.method.evidence
        each = -2.0 * float(np.log(evidence.prior_odds))
        each += evidence.driven_cost if self.problem.is_driven_by_force else 0.0
        # An episode counts as many parameters, for it was searched for all over the runs.
        added = sum(p.weight for effect in self.effects for p in effect.parameters)
        count = int(self.problem.is_free.sum()) + added + evidence.episode_cost * self.hypothesis.episode_count
        return count * float(np.log(self.problem.count)) + each * len(self.ids)

    @property
    def bic(self) -> float:
        """χ² + penalty, −2 times the log evidence in white noise of known size."""
        return self.chi2 + self.penalty


Fits = Mapping[tuple[str, ...], Fit]
