"""Fit base parameters and effects jointly to all runs: Levenberg–Marquardt within bounds, channels weighted."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from softcal.core.gap.case import Case, Mask, Run
from softcal.core.gap.colour import Colour, ColourConfig, filter_of, filtered
from softcal.core.gap.coordinates import fit_scale, from_fit, to_fit
from softcal.core.gap.forward import predict
from softcal.core.gap.linear import dots, energy, gram
from softcal.core.gap.offsets import (
    IS_RELATIVE,
    Directions,
    Nearby,
    Sizes,
    bases_of,
    directions,
    largest_offsets,
    with_offsets,
)
from softcal.core.gap.rounding import dither_V, mean_code_V
from softcal.core.gap.scale import RigScale
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Chain

BASE = (
    Parameter("u0_mm", "mm", -1e4, 1e4, 0.3),
    Parameter("k1_N_mm", "N/mm", 0.0, 1e4, 1.0),
    Parameter("k3_N_mm3", "N/mm³", 0.0, 1e4, 0.1),
    Parameter("r0_ohm", "ohm", 1e-6, 1e9, 4.0, scale="log"),
    Parameter("kappa_per_N", "1/N", 0.0, 1e3, 0.07),
)
DIFFERENCE = 2e-4
"""Step of a numerical derivative, in units of the parameter's usual size: above the corners of play and clipping."""

QUIETEST = 1e-6
"""Least noise of a force that is believed, N on the common rig."""

TRIES = 6
"""Steps tried from one place, each damped more than the one before."""

PRIOR_ODDS = 0.02
"""Prior odds of each effect being present: one effect in half of the cases, any of the 25."""

DRIVEN_COST = 120.0
"""What a cause pays besides where a measured force drives the chain: what is left of its noise and of the corners that
smoothing rounds off feigns gains of up to 90 on recordings without any gap."""

EPISODE_COST = 5
"""Parameters an episode counts as in Schwarz's criterion: two times, a size, and the places it was not found in."""

Episodes = tuple[Mapping[str, Array], ...]

Around: TypeAlias = Callable[["Hypothesis", Array], Array]
"""Predict, (samples,), at coordinates near to others, with an effect more or less where it is small."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The base with these effects on top.

    Args:
        effects: entries of the catalogue, or other realisations of the same causes.
        episodes: per run, the rows of its episodic effects.
        of_all: parameters of the base, which every hypothesis has; the twin's where nothing else is said.
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
        """Where the parameters of every effect stand in the vector of parameters, the size first, by identifier."""
        ends = np.cumsum([self.of_base.stop, *(len(effect.parameters) for effect in self.effects)])
        return {e.id: slice(int(ends[k]), int(ends[k + 1])) for k, e in enumerate(self.effects)}

    def split(self, coordinates: Array) -> tuple[list[float], list[list[float]]]:
        """Return the values of the base and of every effect at these coordinates of the fit."""
        values = [from_fit(p, float(x)) for p, x in zip(self.parameters, coordinates, strict=True)]
        return values[self.of_base], [values[place] for place in self.slices.values()]

    def place_of(self, effect_id: str) -> int:
        """Return where the size of an effect stands among the coordinates."""
        return int(self.slices[effect_id].start)

    def without(self, effect_id: str) -> tuple["Hypothesis", Mask]:
        """Return this hypothesis without one effect, and which of its coordinates are left: (parameters,) of bool."""
        left = np.ones(len(self.parameters), dtype=np.bool_)
        if effect_id in self.slices:
            left[self.slices[effect_id]] = False
        return replace(self, effects=tuple(e for e in self.effects if e.id != effect_id)), left

    def without_episodes(self) -> "Hypothesis":
        """Return the same effects on a run whose episodes nobody knows."""
        return replace(self, episodes=())

    def adding(self, effect: Effect, episodes: Episodes | None = None) -> "Hypothesis":
        """Return this hypothesis with one effect more, or with another realisation of one it has."""
        kept = tuple(e for e in self.effects if e.id != effect.id)
        return replace(self, effects=(*kept, effect), episodes=self.episodes if episodes is None else episodes)


@dataclass(frozen=True)
class Block:
    """Where the samples of one channel of one run stand in the vectors of a problem."""

    run: int
    channel: str
    place: slice


@dataclass(frozen=True, eq=False)
class Problem:
    """The measured channels of a case as one vector with noise weights.

    Args:
        case: the runs.
        sigma: per channel, standard deviation of the white noise, (n,) or a number, in the channel's unit.
        use: (samples,) which samples a fit may see; all where None.
        colour: per channel whose noise is not white, the part that fades.
    """

    case: Case
    sigma: Mapping[str, float]
    use: Array | None = None
    extra_variance: Array | None = None
    """(samples,) variance that comes with the noise of the driving channel, in the units of the samples squared."""
    has_offsets: bool = True
    """Whether every run may have a zero of the force, an unloaded resistance and a seat of its own."""
    colour: Mapping[str, Colour] = field(default_factory=dict)
    of_rig: RigScale | None = None
    """The size of the rig; read off the runs where None."""

    @cached_property
    def scale(self) -> RigScale:
        return self.of_rig or RigScale.of(self.case)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        blocks, at = [], 0
        for k, run in enumerate(self.case.runs):
            for channel in self.channels_of_runs[k]:
                blocks.append(Block(k, channel, slice(at, at + len(run))))
                at += len(run)
        return tuple(blocks)

    @cached_property
    def measured(self) -> Array:
        """(samples,) all channels of all runs, block by block."""
        return np.concatenate([self.recorded(b.run, b.channel) for b in self.blocks])

    @cached_property
    def channels_of_runs(self) -> list[tuple[str, ...]]:
        """Per run, the recorded channels that are predicted."""
        return [predicted_channels(run) for run in self.case.runs]

    def recorded(self, run: int, channel: str) -> Array:
        """Return a recorded channel of a run, (n,)."""
        return np.asarray(getattr(self.case.runs[run], channel))

    @cached_property
    def colour_config(self) -> ColourConfig:
        """How noise that fades is read."""
        return ColourConfig()

    @property
    def smooth_order(self) -> int:
        """Which differences of a residual hold its noise alone: second ones where the rest of it may be quick."""
        return 1

    def least_noise(self, channel: str) -> float:
        """Return the least noise of a channel that is believed: one without any has no weight."""
        return 0.1 * self.case.readout.step_V if channel == "output_V" else QUIETEST * self.scale.factor("N")

    @property
    def scored_channels(self) -> list[str]:
        """Channels whose gap is measured; where the stage stands on a rigid block is none."""
        return [c for c in ("output_V", "force_N") if any(b.channel == c for b in self.blocks)]

    def of_run(self, run: Run) -> "Problem":
        """Return the problem of a run that is not recorded yet, under the same noise."""
        return Problem(
            Case(self.case.serial, (run,), is_planned=True), self.sigma, colour=self.colour, of_rig=self.scale
        )

    @cached_property
    def noise(self) -> Array:
        """(samples,) standard deviation of the noise of every sample."""
        noise = np.concatenate([np.full(b.place.stop - b.place.start, self.sigma[b.channel]) for b in self.blocks])
        return noise if self.extra_variance is None else np.sqrt(noise**2 + self.extra_variance)

    @cached_property
    def slow_noise(self) -> Array:
        """(samples,) standard deviation of white noise that is as strong as this one near zero frequency."""
        if not self.colour:
            return self.noise
        variance = self.noise**2
        for block in (b for b in self.blocks if b.channel in self.colour):
            step_s = float(np.median(self.case.runs[block.run].step_s))
            variance[block.place] += self.colour[block.channel].slow_variance(step_s)
        return np.sqrt(variance)

    @cached_property
    def whole_noise(self) -> Array:
        """(samples,) standard deviation of the noise of every sample, the part that fades included."""
        noise = self.noise.copy()
        for block in (b for b in self.blocks if b.channel in self.colour):
            noise[block.place] = np.hypot(noise[block.place], self.colour[block.channel].spread)
        return noise

    def floor(self, channel: str) -> float:
        """Return the standard deviation of the noise of a channel in its unit, the part that fades included."""
        fading = self.colour[channel].spread if channel in self.colour else 0.0
        return float(np.hypot(self.sigma[channel], fading))

    @cached_property
    def weights(self) -> Array:
        """(samples,) 1/σ of the white noise, 0 where a fit may not look."""
        return 1.0 / self.noise if self.use is None else self.use / self.noise

    def whitened(self, values: Array) -> Array:
        """Return (samples,) values as independent ones in units of their noise, 0 where a fit may not look."""
        out = np.asarray(values * self.weights)
        for block, steps in self._filters:
            out[block.place] = filtered(values[block.place], steps)
        return out

    @cached_property
    def _filters(self) -> list[tuple[Block, Array]]:
        use, found = np.ones(len(self.measured)) if self.use is None else self.use, []
        for block in (b for b in self.blocks if b.channel in self.colour):
            step_s, of = self.case.runs[block.run].step_s, self.colour[block.channel]
            seen = use[block.place].astype(np.float64)
            found.append((block, filter_of(self.noise[block.place], seen, step_s, of.spread, of.fading_s)))
        return found

    @cached_property
    def is_free(self) -> Array:
        """(5,) which base parameters these channels determine."""
        case = self.case
        stage, force, output = (case.has(c) for c in ("stage_mm", "force_N", "output_V"))
        # Without a force only κ·k1 and κ·k3 act; k1 stays where it is and κ takes their common factor.
        return np.array([stage, stage and force, stage, output, output])

    @cached_property
    def largest_offsets(self) -> Array:
        """(k,) bounds of what every run has of its own: of the twin a zero, a resistance and a seat."""
        return largest_offsets(self.case)

    @property
    def are_relative(self) -> Mask:
        """(k,) of which offsets only what the runs differ by is taken off."""
        return IS_RELATIVE

    @property
    def are_bending(self) -> Mask:
        """(k,) which offsets move a channel other than in proportion."""
        return IS_RELATIVE

    @property
    def is_driven_by_force(self) -> bool:
        """Whether a measured force, with its noise, drives the chain in place of a stage position."""
        return self.extra_variance is not None

    @cached_property
    def dither_V(self) -> float | None:
        """Noise before an ADC that is coarse against it; None where the stairs of its codes do not show."""
        if "output_V" not in self.sigma:
            return None
        return dither_V(self.floor("output_V"), self.case.readout.step_V)

    @property
    def count(self) -> int:
        """Samples a fit may see."""
        return int(np.count_nonzero(self.weights))

    def predict(self, hypothesis: Hypothesis, coordinates: Array) -> Array:
        """Return the clean prediction, (samples,), at these coordinates of the fit."""
        return self.predict_around(hypothesis, coordinates)[0]

    def predict_around(self, hypothesis: Hypothesis, coordinates: Array) -> tuple[Array, "Around"]:
        """Return the clean prediction, (samples,), and what foretells it nearby in one pass of the chain."""
        out = self.clean(hypothesis, coordinates, {})
        if not self.has_offsets or self.case.is_planned or not len(self.largest_offsets):
            return self._known(out), self.predict
        out, nearby = self._with_offsets(hypothesis, coordinates, out)
        out = nearby.added(self, out)

        def around(other: Hypothesis, near: Array) -> Array:
            return self._known(nearby.added(self, self.clean(other, near, nearby.moved)))

        return self._known(out), around

    def _with_offsets(self, hypothesis: Hypothesis, coordinates: Array, clean: Array) -> tuple[Array, Nearby]:
        return with_offsets(
            self,
            clean,
            lambda clean, sizes: self.directions(hypothesis, coordinates, clean, sizes),
            lambda sizes: self.clean(hypothesis, coordinates, sizes),
        )

    def offset_sizes(self, hypothesis: Hypothesis, coordinates: Array) -> dict[int, Array]:
        """Return by run, (k,), what it has of its own at these coordinates."""
        clean, nearby = self._with_offsets(hypothesis, coordinates, self.clean(hypothesis, coordinates, {}))
        sizes = nearby.sizes(self, clean)
        return {run: size + nearby.moved.get(run, 0.0) for run, size in sizes.items()}

    def _known(self, out: Array) -> Array:
        # A sample nobody can foretell costs as much as a right prediction would: nothing is won by not knowing.
        unknown = np.isnan(out)
        return np.where(unknown, self.measured - self.noise, out) if unknown.any() else out

    def directions(self, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes) -> Directions:
        """Return how a prediction with these offsets in it changes with each of them."""
        return directions(self, BaseParameters(*hypothesis.split(coordinates)[0]), clean, sizes)

    def clean(self, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        """Return the prediction, (samples,), with these offsets in it, NaN where nobody can know."""
        given, values = hypothesis.split(coordinates)
        base = BaseParameters(*given)
        own = bases_of(base, sizes)
        out = np.empty(len(self.measured))
        last, prediction = -1, None
        for block in self.blocks:
            # One pass of the chain gives all channels of a run.
            if block.run != last:
                run, last, mine = self.case.runs[block.run], block.run, own.get(block.run, base)
                prediction = predict(run, last, mine, hypothesis.chain, values, hypothesis.episodes_of(last))
            channel = prediction.channel(block.channel) if prediction is not None else None
            if block.channel == "output_V" and self.dither_V is not None and channel is not None:
                channel = mean_code_V(channel, self.dither_V, self.case.readout.step_V)
            out[block.place] = self.measured[block.place] if channel is None else channel
            if block.channel == "force_N" and block.run in sizes:
                out[block.place] += sizes[block.run][0]
        return out

    def seeing(self, use: Array) -> "Problem":
        """Return the same problem with other samples open to the fit."""
        return replace(self, use=use)

    @cached_property
    def bare(self) -> "Problem":
        """The same problem with one zero, one resistance and one seat for all runs."""
        return replace(self, has_offsets=False)

    def with_noise(self, sigma: Mapping[str, float], colour: Mapping[str, Colour] | None = None) -> "Problem":
        """Return the same problem under another noise level, and the same colour where none is given."""
        return replace(self, sigma=sigma, colour=self.colour if colour is None else colour)


def predicted_channels(run: Run) -> tuple[str, ...]:
    """Return the recorded channels of a run that the twin predicts (not those that drive it)."""
    if run.kind == "rigid_block":
        return ("stage_mm",)
    if run.kind == "dead_weights":
        return ("force_N",)
    if run.kind == "dummy_resistor" or (run.kind == "press" and run.stage_mm is None):
        return ("output_V",)
    return tuple(channel for channel in ("force_N", "output_V") if getattr(run, channel) is not None)


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its best parameters.

    Args:
        coordinates: (parameters,) in the coordinates of the fit.
        predicted: (samples,) clean prediction.
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
        """(parameters, samples) derivative of the whitened prediction; rows that were held fixed are 0."""
        return np.array([self.problem.whitened(row) for row in self.slopes])

    @cached_property
    def base(self) -> BaseParameters:
        """The base parameters of the twin."""
        return BaseParameters(*self.hypothesis.split(self.coordinates)[0])

    @cached_property
    def effect_values(self) -> list[list[float]]:
        return self.hypothesis.split(self.coordinates)[1]

    @cached_property
    def residual(self) -> Array:
        """(samples,) measured − predicted, whitened: in white noise over σ."""
        return self.problem.whitened(self.problem.measured - self.predicted)

    @cached_property
    def covariance(self) -> Array:
        """(parameters, parameters) of the coordinates; rows of fixed parameters are 0."""
        normal = gram(self.jacobian)
        free = np.flatnonzero(np.diag(normal) > 0)
        covariance = np.zeros_like(normal)
        size = np.sqrt(np.diag(normal)[free])
        # Two parameters that these samples cannot tell apart make the matrix singular: an inverse would fail. Each is
        # counted in its own error, so that what is singular does not depend on its unit.
        covariance[np.ix_(free, free)] = np.linalg.pinv(
            normal[np.ix_(free, free)] / np.outer(size, size), rcond=1e-12, hermitian=True
        ) / np.outer(size, size)
        return covariance

    def under(self, problem: Problem) -> "Fit":
        """Return the same parameters scored under another noise level."""
        residual = problem.whitened(problem.measured - self.predicted)
        return replace(self, problem=problem, chi2=energy(residual))

    @property
    def parameter_count(self) -> float:
        """Free parameters; an episode counts as many, for it was searched for all over the runs."""
        added = sum(p.weight for effect in self.hypothesis.effects for p in effect.parameters)
        return int(self.problem.is_free.sum()) + added + EPISODE_COST * self.hypothesis.episode_count

    @property
    def penalty(self) -> float:
        """What the hypothesis pays: p·ln(n) of Schwarz for its flexibility, −2·ln of the prior odds of its causes."""
        # Twenty-five causes are tried: without prior odds the luckiest of them would often win by chance.
        each = -2.0 * float(np.log(PRIOR_ODDS))
        each += DRIVEN_COST if self.problem.is_driven_by_force else 0.0
        return self.parameter_count * float(np.log(self.problem.count)) + each * len(self.hypothesis.ids)

    @property
    def bic(self) -> float:
        """χ² + penalty: −2 times the log evidence in white noise of known size; smaller is better."""
        return self.chi2 + self.penalty


def fit(problem: Problem, hypothesis: Hypothesis, start: Array, steps: int = 20, tolerance: float = 0.02) -> Fit:
    """Minimise χ² from a start within the bounds of all parameters.

    Args:
        start: (parameters,) coordinates to begin at.
        steps: most Levenberg–Marquardt steps taken.
        tolerance: stop when a step gains less than this in χ².
    """
    space = _Space(problem, hypothesis)
    x = np.clip(start, space.low, space.high)
    predicted, around = problem.predict_around(hypothesis, x)
    residual = problem.whitened(problem.measured - predicted)
    chi2, damping = _finite_energy(residual), 1e-4
    if chi2 == np.inf:
        return Fit(problem, hypothesis, x, predicted, chi2, np.zeros((len(x), len(predicted))))
    slopes = space.slopes(x, predicted, around)
    for _ in range(steps):
        jacobian = np.array([problem.whitened(row) for row in slopes])
        normal, slope = gram(jacobian), dots(jacobian, residual)
        accepted = False
        for _ in range(TRIES):
            candidate = space.step(x, normal, slope, damping)
            moved = candidate - x
            # A step cut short by a bound may promise nothing where a more damped one does.
            if float(2.0 * moved @ slope - moved @ normal @ moved) > 0.1 * tolerance:
                trial, trial_around = problem.predict_around(hypothesis, candidate)
                trial_residual = problem.whitened(problem.measured - trial)
                trial_chi2 = _finite_energy(trial_residual)
                if trial_chi2 < chi2:
                    accepted = True
                    break
            # From the whole step to a thousandth of it: what still does not descend is a minimum.
            damping = max(30.0 * damping, 1e-3)
        if not accepted:
            break
        gain = chi2 - trial_chi2
        x, predicted, around, residual, chi2 = candidate, trial, trial_around, trial_residual, trial_chi2
        damping = max(damping / 10, 1e-9)
        # A huge χ² is summed with rounding: below a ten-millionth of it no gain is real.
        if gain < tolerance + 1e-7 * chi2:
            break
        slopes = space.slopes(x, predicted, around)
    return Fit(problem, hypothesis, x, predicted, chi2, slopes)


def _finite_energy(residual: Array) -> float:
    """Return the sum of squares; infinity where the prediction is not finite, so that a fit goes elsewhere."""
    found = energy(residual)
    return found if np.isfinite(found) else np.inf


class _Space:
    """Bounds, scales and derivatives of one hypothesis on one problem."""

    def __init__(self, problem: Problem, hypothesis: Hypothesis) -> None:
        self._problem, self._hypothesis = problem, hypothesis
        parameters = [problem.scale.sized(p) for p in hypothesis.parameters]
        bounds = [sorted((to_fit(p, p.low), to_fit(p, p.high))) for p in parameters]
        self.low = np.array([b[0] for b in bounds])
        self.high = np.array([b[1] for b in bounds])
        for k, p in enumerate(hypothesis.parameters):
            if p.scale == "inverse_square":
                # Coordinate 0 stands for an infinite value, "no such effect": the fit must be able to reach it.
                self.low[k] = 0.0
        self.scale = np.array([fit_scale(p) for p in parameters])
        self.is_free = np.array([not p.is_fixed for p in parameters])
        self.is_free[hypothesis.of_base] &= problem.is_free

    def slopes(self, x: Array, predicted: Array, around: Around) -> Array:
        """(parameters, samples) derivative of the prediction, one-sided, away from a bound."""
        out = np.zeros((len(x), len(predicted)))
        for k in np.flatnonzero(self.is_free):
            # One-sided: a central difference costs a second pass of the chain and gains nothing on kinked effects.
            step = DIFFERENCE * self.scale[k]
            if x[k] + step > self.high[k]:
                step = -step
            # Beside a place where a simulator fails the other side tells; between two such places a parameter is held.
            for side in (step, -step):
                moved = x.copy()
                moved[k] += side
                row = (around(self._hypothesis, moved) - predicted) / side
                if np.all(np.isfinite(row)):
                    out[k] = row
                    break
        return out

    def step(self, x: Array, normal: Array, slope: Array, damping: float) -> Array:
        """Return the damped Gauss–Newton step; parameters pushed out of their bounds are held there."""
        free = self.is_free & (np.diag(normal) > 0)
        candidate = x.copy()
        for _ in range(3):
            k = np.flatnonzero(free)
            # Marquardt's scaling by the diagonal: millimetres and ohms are damped alike.
            size = np.sqrt(np.diag(normal)[k])
            damped = normal[np.ix_(k, k)] / np.outer(size, size) + (damping + 1e-12) * np.eye(len(k))
            candidate = x.copy()
            candidate[k] += np.linalg.solve(damped, slope[k] / size) / size
            outside = (candidate < self.low) | (candidate > self.high)
            candidate = np.clip(candidate, self.low, self.high)
            # What stands on its bound and wants beyond it is taken out; the others are solved again without it.
            held = free & outside & (candidate == x)
            if not held.any():
                break
            free &= ~held
        return candidate
