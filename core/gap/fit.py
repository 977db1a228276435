"""Fit base parameters and effects jointly to all runs; where a fit can move; the structure that it leaves."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from softcal.core.gap.linear import DIFFERENCE, energy, fit_scale, gram, start_coordinates, to_fit
from softcal.core.gap.problem import Around, Block, Hypothesis, Problem
from softcal.core.messages.reason import Reason
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect
from softcal.core.twin.parameters import BaseParameters

TOLERANCE = 0.02
"""A step that gains less than this in χ² is the last."""

TRIES = 6
"""Steps tried from one place, each damped more than the one before."""


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


def fit(problem: Problem, hypothesis: Hypothesis, start: Array, steps: int = 20) -> Fit:
    """Minimise χ² from a start within the bounds of all parameters."""
    space = _Space(problem, hypothesis)
    x = np.clip(start, space.low, space.high)
    predicted, around = problem.predict_around(hypothesis, x)
    residual = problem.residual(predicted, x)
    chi2, damping = _finite_energy(residual), 1e-4
    if chi2 == np.inf:
        return Fit(problem, hypothesis, x, predicted, chi2, np.zeros((len(x), len(predicted))))
    slopes = space.slopes(x, predicted, around)
    for _ in range(steps):
        jacobian = problem.jacobian(slopes)
        normal, slope = gram(jacobian), jacobian @ residual
        accepted = False
        for _ in range(TRIES):
            candidate = space.step(x, normal, slope, damping)
            moved = candidate - x
            # A step cut short by a bound may promise nothing where a more damped one does.
            if float(2.0 * moved @ slope - moved @ normal @ moved) > 0.1 * TOLERANCE:
                trial, trial_around = problem.predict_around(hypothesis, candidate)
                trial_residual = problem.residual(trial, candidate)
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
        if gain < TOLERANCE + 1e-7 * chi2:
            break
        slopes = space.slopes(x, predicted, around)
    return Fit(problem, hypothesis, x, predicted, chi2, slopes)


def _finite_energy(residual: Array) -> float:
    cost = energy(residual)
    return cost if np.isfinite(cost) else np.inf


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
                # Coordinate 0 stands for an infinite value, "no such effect": a fit must reach it.
                self.low[k] = 0.0
        self.scale = np.array([fit_scale(p) for p in parameters])
        self.is_free = np.array([not p.is_fixed for p in parameters])
        self.is_free[hypothesis.of_base] &= problem.is_free

    def slopes(self, x: Array, predicted: Array, around: Around) -> Array:
        """(parameters, samples) derivative of the prediction, one-sided, away from a bound."""
        out, free = np.zeros((len(x), len(predicted))), np.flatnonzero(self.is_free)
        # One-sided: a central difference costs twice and gains nothing on kinked effects.
        steps = np.where(x + DIFFERENCE * self.scale > self.high, -1.0, 1.0) * DIFFERENCE * self.scale
        self._problem.prepare([(self._hypothesis, x + steps * (np.arange(len(x)) == k)) for k in free])
        for k, step in zip(free, steps[free], strict=True):
            # Where a simulator fails the other side tells; between two failures a parameter is held.
            for side in (step, -step):
                moved = x.copy()
                moved[k] += side
                row = (around(self._hypothesis, moved) - predicted) / side
                if np.all(np.isfinite(row)):
                    out[k] = row
                    break
        return out

    def step(self, x: Array, normal: Array, slope: Array, damping: float) -> Array:
        """Return the damped Gauss–Newton step; parameters pushed out of bounds are held there."""
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
            # What stands on its bound and wants beyond is taken out, and the others are solved again.
            on_bound = free & outside & (candidate == x)
            if not on_bound.any():
                break
            free &= ~on_bound
        return candidate


@dataclass(frozen=True)
class Probe:
    """An effect at a small size and one shape, to see which way it would move the prediction."""

    effect: Effect
    values: tuple[float, ...]
    is_one_sided: bool


@dataclass(frozen=True, eq=False)
class Candidate:
    """A probe that would lower χ².

    Args:
        gain: expected drop of χ² when the effect is added and all is refitted, to first order.
        hidden: share of its signature that the fitted parameters imitate.
        shift: (parameters of the fit,) how its coordinates would move along.
    """

    effect: Effect
    values: tuple[float, ...]
    gain: float
    hidden: float
    shift: Array

    def start(self, result: Fit, share: float = 1.0) -> Array:
        """Return where a fit of the larger hypothesis begins, at a share of the promised size."""
        _, is_retained = result.hypothesis.without(self.effect.id)
        retained = (result.coordinates + share * self.shift)[is_retained]
        first = self.effect.parameters[0]
        size = self.values[0] * share if first.neutral == 0.0 else self.values[0] / share
        values = (size, *self.values[1:]) if first.neutral in (0.0, np.inf) and share < 1.0 else self.values
        return np.concatenate([retained, start_coordinates([self.effect], [values])])


class Tangent:
    """The directions in which a fit can move, and how a signature stands to them."""

    def __init__(self, result: Fit, base_only: bool = False) -> None:
        self._fit = result
        jacobian = result.jacobian
        normal = gram(jacobian)
        scale = np.sqrt(np.diag(normal))
        if base_only:
            scale[result.hypothesis.of_base.stop :] = 0.0
        self._rows = np.flatnonzero(scale > 0)
        scale = scale[self._rows]
        strength, axes = np.linalg.eigh(normal[np.ix_(self._rows, self._rows)] / np.outer(scale, scale))
        is_significant = strength > 1e-10 * strength.max(initial=0.0)
        # Rows of `turn` times the Jacobian are orthonormal.
        self._turn = (axes[:, is_significant] / np.sqrt(strength[is_significant])).T / scale
        self._basis = self._turn @ jacobian[self._rows]
        self._residual = result.residual

    @cached_property
    def _around(self) -> Around:
        return self._fit.problem.predict_around(self._fit.hypothesis, self._fit.coordinates)[1]

    def extended_start(self, probe: Probe) -> tuple[Hypothesis, Array]:
        """Return the hypothesis with a probe, and its coordinates."""
        x = np.concatenate([self._fit.coordinates, start_coordinates([probe.effect], [probe.values])])
        return self._fit.hypothesis.adding(probe.effect), x

    def signature(self, probe: Probe) -> Array:
        """(samples,) change of the whitened prediction when the probe is switched on."""
        result, (hypothesis, x) = self._fit, self.extended_start(probe)
        change = result.problem.whitened(self._around(hypothesis, x) - result.predicted)
        return change if np.all(np.isfinite(change)) else np.zeros(len(change))

    def visible(self, signature: Array) -> Array:
        """Return the part of a signature that the fitted parameters cannot imitate."""
        return np.asarray(signature - (self._basis @ signature) @ self._basis)

    def score_candidate(self, probe: Probe) -> Candidate | None:
        """Return what this probe promises, None if it promises nothing."""
        signature = self.signature(probe)
        size = energy(signature)
        visible = self.visible(signature)
        power = energy(visible)
        if power <= 1e-9 * max(size, 1e-30) or power <= 1e-12:
            return None
        times = float(visible @ self._residual) / power
        if probe.is_one_sided and times <= 0:
            return None
        # The probe is linear for small effects only: begin within a decade of it.
        stretch = float(np.clip(times, -30.0, 30.0))
        shift = np.zeros(len(self._fit.coordinates))
        shift[self._rows] = -stretch * (self._turn.T @ (self._basis @ signature))
        first, usual = self._fit.problem.scale.sized(probe.effect.parameters[0]), probe.values[0]
        if first.scale == "inverse_square":
            value = usual / max(stretch, 1e-3) ** 0.5
        else:
            # A level does not scale with what it cuts off.
            value = usual if first.neutral == np.inf else usual * stretch
        values = (float(np.clip(value, first.low, first.high)), *probe.values[1:])
        return Candidate(probe.effect, values, times**2 * power, 1.0 - power / size, shift)


@dataclass(frozen=True)
class Structure:
    """How much of a residual is not noise: excess in standard errors, rms in units of the noise."""

    z: float
    rms: float
    is_significant: bool


def structure(result: Fit, channel: str | None = None) -> Structure:
    """Measure the structure left in the residual of a fit, of one channel or of all."""
    parts = [result.residual[b.rows] for b in result.problem.blocks if channel in (None, b.channel)]
    config, largest = result.problem.method.structure, -np.inf
    for length in config.block_samples:
        # Block sums of white noise keep variance 1 at any length; structure adds up in them.
        sums = [_block_sums(part, length) for part in parts]
        every = np.concatenate(sums)
        if len(every) > 3:
            largest = max(largest, float((np.mean(every**2) - 1.0) / np.sqrt(2.0 / len(every))))
    short = np.concatenate([_block_sums(part, config.block_samples[0]) for part in parts])
    excess = max(0.0, float(np.mean(short**2)) - 1.0) / config.block_samples[0] if len(short) else 0.0
    return Structure(largest, float(np.sqrt(excess)), largest > config.dirty_z)


def _block_sums(values: Array, length: int) -> Array:
    total = len(values) // length * length
    return np.asarray(values[:total].reshape(-1, length).sum(axis=1) / np.sqrt(length))


@dataclass(frozen=True)
class Map:
    """One chain relation fitted alone: stage→force, force→output or stage→output."""

    name: str
    structure: Structure


@dataclass(frozen=True)
class Regime:
    """A condition in which a channel's gap stands out: share of its energy, and over that of time."""

    channel: str
    name: Reason
    share: float
    lift: float


def shares_of_gap(
    result: Fit, blocks: list[Block], conditions: Mapping[Reason, Array]
) -> Iterator[tuple[Reason, float, float]]:
    """Yield each condition with its share of the structured energy of these blocks, and of the time."""
    excess = np.concatenate([result.residual[b.rows] ** 2 - 1.0 for b in blocks])
    total = float(excess.sum())
    # Within four standard errors of the sum of squares there is no gap to divide.
    if total > 4 * np.sqrt(2 * len(excess)):
        for name, members in conditions.items():
            time_share = float(np.mean(members))
            # A regime of next to no time, or of nearly all, says nothing of where a gap lies.
            if 0.01 < time_share < 0.95:
                yield name, float(excess[members].sum()) / total, time_share


def form_of(result: Fit, effect: Effect) -> str:
    """Return the form by which an effect of a fit acts, empty for the list's own equation."""
    names = (form.effect.equation for form in result.problem.model.forms_of(effect.id))
    return effect.equation if effect.equation in names else ""
