"""Fit base and effects jointly to all runs; where a fit can move; the structure that it leaves; its evidence."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softcal.core.gap.hypothesis import DIFFERENCE, Hypothesis, Probe, fit_scale, start_coordinates, to_fit
from softcal.core.gap.linear import energy, gram
from softcal.core.gap.model import Around, Block, Directions, Fit, Fits, Problem
from softcal.core.messages.reason import Reason
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect

TOLERANCE = 0.02
"""A step that gains less than this in χ² is the last."""

TRIES = 6
"""Steps tried from one place, each damped more than the one before."""


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
        self._problem.model.prepare(
            self._problem, [(self._hypothesis, x + steps * (np.arange(len(x)) == k)) for k in free]
        )
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
    return Structure(largest, float(np.sqrt(excess)), largest > config.structured_z)


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


def strongest_regimes(
    result: Fit, conditions_of: Callable[[Fit, list[Block]], dict[Reason, Array]], min_lift: float = 0.0
) -> tuple[Regime, ...]:
    """Return the conditions of pressed runs in which what a fit leaves stands out, the strongest first.

    Args:
        conditions_of: which samples of blocks, (n,), lie in a condition.
    """
    out = []
    for channel in result.problem.scored_channels:
        if blocks := result.problem.blocks_of(channel, "press"):
            for name, part, time_share in shares_of_gap(result, blocks, conditions_of(result, blocks)):
                share = float(np.clip(part, 0.0, 1.0))
                out += [Regime(channel, name, share, share / time_share)] if share >= min_lift * time_share else []
    return tuple(sorted(out, key=lambda r: -r.share * np.log(max(r.lift, 1.0) + 1e-9)))


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


def misfit(excess: float, modes: float) -> float:
    """Return −2·ln of the likelihood of an excess of χ² when every equation may be a little wrong.

    The difference between equation and rig is that many normal coordinates of unknown common size, at the
    size that fits best. A large excess counts by its logarithm: by which factor a hypothesis lowers
    what the others leave, not how many σ that is.
    """
    return excess if excess < modes else modes * (1.0 + float(np.log(excess / modes)))


@dataclass(frozen=True)
class Yardstick:
    """χ² of the hypothesis that comes closest, and of the structure even this one may leave."""

    chi2: float
    noise_floor: float

    @classmethod
    def from_fits(cls, fits: Iterable[Fit]) -> "Yardstick":
        """Take the measure from fits under one noise level."""
        every = list(fits)
        config = every[0].problem.method.evidence
        closest = min(every, key=lambda f: f.chi2)
        residual, gap = structure(closest), max(f.chi2 for f in every) - closest.chi2
        structured = residual.rms**2 * closest.problem.count if residual.is_significant else 0.0
        driven = config.driven_cost if closest.problem.is_driven_by_force else 0.0
        return cls(closest.chi2, max(structured, config.exactness * gap, driven))

    def log_evidence(self, result: Fit) -> float:
        """Return the logarithm of prior times evidence of a hypothesis."""
        modes = result.problem.method.evidence.modes
        return -0.5 * (misfit(max(result.chi2 - self.chi2, 0.0) + self.noise_floor, modes) + penalty(result))


def exact_log_evidence(result: Fit) -> float:
    """Return the logarithm of prior times evidence of a hypothesis whose equations hold exactly."""
    return -0.5 * (result.chi2 + penalty(result))


def penalty(result: Fit) -> float:
    """Return the penalty where a loose lead is one cause, however often it gaps.

    Each episode was paid for in full when it was placed. A size that these runs hardly determine pays
    less than Schwarz's ln n: −2·ln of posterior over prior (Laplace). An unusual size is less likely.
    """
    problem, log_count = result.problem, float(np.log(result.problem.count))
    config = problem.method.evidence
    more = max(result.hypothesis.episode_count - 1, 0)
    cheaper = more * (config.episode_cost - config.further_episode_cost) * log_count
    if problem.is_driven_by_force:
        # What its noise feigns is in the floor already.
        cheaper += config.driven_cost * len(result.ids)
    spared, unusual, on_bound = 0.0, 0.0, 0
    for effect, values in zip(result.effects, result.effect_values, strict=True):
        size, at = problem.scale.sized(effect.parameters[0]), result.hypothesis.index_of(effect.id)
        ends = [end for end in (size.low, size.high) if end not in (0.0, size.neutral)]
        on_bound += size.scale == "linear" and any(abs(values[0] - end) < 0.01 * abs(end) for end in ends)
        variance = 0.0 if problem.is_driven_by_force else float(result.covariance[at, at])
        if variance > 0.0 and not effect.is_episodic:
            width = config.usual_range * fit_scale(size) / np.sqrt(2.0 * np.pi * variance)
            spared += size.weight * max(0.0, log_count - 2.0 * float(np.log(max(width, 1.0))))
        if size.neutral == 0.0:
            # Of two sets that these runs cannot tell apart the one of usual sizes is likelier: Cauchy's prior.
            unusual += 2.0 * float(np.log1p((values[0] / (config.usual_range * size.usual)) ** 2))
    return result.penalty - (cheaper + spared) + unusual + config.bound_cost * on_bound


def log_evidences(fits: Fits) -> dict[tuple[str, ...], float]:
    """Return the log of prior times evidence of every hypothesis, all under one noise level."""
    yardstick = Yardstick.from_fits(fits.values())
    return {ids: yardstick.log_evidence(result) for ids, result in fits.items()}


def leader_of(fits: Fits) -> Fit:
    """Return the hypothesis of best evidence in white noise: the one to grow further."""
    return min(fits.values(), key=lambda f: f.bic)


def one_less(fits: Fits, result: Fit) -> dict[str, Fit]:
    """Return the fits without each of the causes of a hypothesis, by that cause."""
    ids = result.ids
    return {i: fits[rest] for k, i in enumerate(ids) if (rest := ids[:k] + ids[k + 1 :]) in fits}


def share_of_gap(base: Fit, result: Fit) -> float:
    """Return which share of the excess of the base over the noise a hypothesis takes away."""
    excess = base.chi2 - base.problem.count
    return 1.0 - (result.chi2 - result.problem.count) / excess if excess > 0 else 1.0
