"""Fit base parameters and effects jointly to all runs: Levenberg–Marquardt within bounds."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from softcal.core.gap.coordinates import fit_scale, to_fit
from softcal.core.gap.linear import dots, energy, gram
from softcal.core.gap.method import METHOD
from softcal.core.gap.problem import Around, Hypothesis, Problem
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect
from softcal.core.twin.parameters import BaseParameters

DIFFERENCE = 2e-4
"""Step of a derivative, in usual sizes of a parameter: beyond corners of play and clipping."""

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
        """(parameters, samples) derivative of the whitened prediction; rows held fixed are 0."""
        return np.array([self.problem.whitened(row) for row in self.slopes])

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
    def penalty(self) -> float:
        """p·ln(n) of Schwarz for the flexibility, and −2·ln of the prior odds of the causes."""
        # Many causes are tried: without prior odds the luckiest would often win by chance.
        each = -2.0 * float(np.log(METHOD.evidence.prior_odds))
        each += METHOD.evidence.driven_cost if self.problem.is_driven_by_force else 0.0
        # An episode counts as many parameters, for it was searched for all over the runs.
        added = sum(p.weight for effect in self.effects for p in effect.parameters)
        count = int(self.problem.is_free.sum()) + added + METHOD.evidence.episode_cost * self.hypothesis.episode_count
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
            if float(2.0 * moved @ slope - moved @ normal @ moved) > 0.1 * TOLERANCE:
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
        self._hypothesis = hypothesis
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
        out = np.zeros((len(x), len(predicted)))
        for k in np.flatnonzero(self.is_free):
            # One-sided: a central difference costs twice and gains nothing on kinked effects.
            step = DIFFERENCE * self.scale[k]
            if x[k] + step > self.high[k]:
                step = -step
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
            held = free & outside & (candidate == x)
            if not held.any():
                break
            free &= ~held
        return candidate
