"""What a hypothesis leaves: is it noise, the same noise everywhere, and how large; on samples that no fit has seen too.

What is left counts as noise where it is no larger than its level and follows nothing that is known
of the runs: depth, speed, load, time, temperature, what came before, its own past, another channel.
What fades of it fades in time and is as strong at rest as under load. How far the gap shrinks is forecast, then
measured on samples held back.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import comb

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import ndtr

from softcal.core.gap.case import HALF_WIDTH
from softcal.core.gap.fit import Yardstick, fit, form_of
from softcal.core.gap.hypothesis import Hypothesis
from softcal.core.gap.linear import (
    Noise,
    NoiseCorrelation,
    Stretch,
    energy,
    join_stretches,
    log_likelihood,
    noise_terms,
    projected,
)
from softcal.core.gap.method import ExplainedFractionConfig, NoiseCorrelationConfig
from softcal.core.gap.model import Block, Fit, Problem
from softcal.core.recording import Array, Mask

TRIMMED = 0.02
"""Share of squared differences, the largest, left out of a noise estimate: steps are not noise."""


@dataclass(frozen=True)
class ChannelGap:
    """The gap of one channel on samples held back, root mean square in the channel's unit."""

    rmse_before: float
    rmse_after: float
    noise_floor: float


@dataclass(frozen=True)
class ExplainedFraction:
    """1 − (after − floor)/(before − floor): forecast with 90 % interval, and on unseen samples.

    There is no forecast where the unseen samples of the same runs contradict it already.
    """

    predicted: float | None
    low: float | None
    high: float | None
    held_out: float

    @classmethod
    def checked(
        cls, forecast: tuple[float, float, float], held_out: float, config: ExplainedFractionConfig
    ) -> "ExplainedFraction":
        """Return a forecast beside what was measured, left out where that lies far outside its interval."""
        _, low, high = forecast
        far = max(high - low, config.contradicts)
        if low - far <= held_out <= high + far:
            return cls(*forecast, held_out)
        return cls(None, None, None, held_out)


def gap_of_base(base: Fit) -> dict[str, ChannelGap]:
    """Return what a base leaves, where nothing else was fitted."""
    problem, gap = base.problem, {}
    for channel in problem.scored_channels:
        parts = [(problem.measured - base.predicted)[b.rows] for b in problem.blocks_of(channel)]
        rms = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
        gap[channel] = ChannelGap(rms, rms, problem.noise_floor(channel))
    return gap


def noise_levels(result: Fit) -> dict[str, float]:
    """Return σ of the white noise per channel, within what is believed of it."""
    problem = result.problem
    scatter = {
        c: float(np.clip(sigma, *problem.model.noise_range(problem, c))) for c, sigma in scatter_of(result).items()
    }
    return {**problem.sigma, **scatter}


def scatter_of(result: Fit) -> dict[str, float]:
    """Return the scatter per channel from the differences of neighbouring residuals.

    A structured residual is smooth and hardly enters.
    """
    problem, order = result.problem, result.problem.model.smooth_order
    squares: dict[str, list[Array]] = {}
    for block in problem.blocks:
        error = (problem.measured - result.predicted)[block.rows]
        # White noise of variance 1 gives differences of variance 2, second ones of 6.
        squares.setdefault(block.channel, []).append(np.diff(error, order) ** 2 / comb(2 * order, order))
    levels = {}
    for channel, parts in squares.items():
        every = np.sort(np.concatenate(parts))
        trimmed = every[: max(1, int(len(every) * (1 - TRIMMED)))]
        # A Gaussian without its largest 2 % of squares keeps 0.873 of its variance.
        levels[channel] = float(np.sqrt(np.mean(trimmed) / 0.873))
    return levels


def noise_of(
    result: Fit, channels: Iterable[str] | None = None
) -> tuple[dict[str, float], dict[str, NoiseCorrelation]]:
    """Return white noise and, in these channels or where there already is one, the fading part."""
    levels, correlations, config = noise_levels(result), {}, result.problem.correlation_config
    for channel in result.problem.correlation if channels is None else channels:
        smallest, largest = result.problem.model.noise_range(result.problem, channel)
        if smallest == largest:
            continue
        noise = read_noise([_stretch(result, b) for b in result.problem.blocks_of(channel)], config)
        if noise.gain > config.gain:
            levels[channel], correlations[channel] = noise.white, noise.correlation
    return levels, correlations


def with_correlated_noise(result: Fit) -> Problem | None:
    """Return the problem with noise that fades, read from what is left; None where it is white."""
    problem = result.problem
    # The noise of a measured force that drives the chain cannot be told from the output's.
    if problem.is_driven_by_force:
        return None
    levels, correlations = noise_of(result, problem.scored_channels)
    return problem.with_noise(levels, correlations) if correlations else None


def _stretch(result: Fit, block: Block, is_used: Array | None = None) -> Stretch:
    error = (result.problem.measured - result.predicted)[block.rows]
    step_s = result.problem.case.runs[block.run].step_s
    return Stretch(error, step_s, np.ones(len(error)) if is_used is None else is_used)


def read_noise(stretches: Sequence[Stretch], config: NoiseCorrelationConfig) -> Noise:
    """Return the likeliest noise; the white part sets the scale: two numbers are searched for."""
    error, step_s, is_used = join_stretches(stretches)
    count = max(float(is_used.sum()), 1.0)

    def scale(ratio: float, fading_s: float) -> tuple[float, float]:
        squares, log_det = noise_terms(error, step_s, is_used, ratio, fading_s)
        variance = max(squares / count, 1e-300)
        return variance, -0.5 * (count * (1.0 + float(np.log(variance))) + log_det)

    def loss(x: Array) -> float:
        outside = max(np.log(config.shortest_s) - x[1], x[1] - np.log(config.longest_s), 0.0)
        memory_s = float(np.exp(np.clip(x[1], np.log(config.shortest_s), np.log(config.longest_s))))
        return float(count * outside**2 - scale(float(np.exp(x[0])), memory_s)[1])

    starts = [np.log([ratio, fading_s]) for ratio in config.ratios for fading_s in config.fading_s]
    start = min(starts, key=loss)
    # Half a natural logarithm: less than the distance of two starts.
    simplex = start + 0.5 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"xatol": 0.02, "fatol": 0.05, "initial_simplex": simplex}
    minimum = minimize(loss, start, method="Nelder-Mead", options=options)
    ratio, fading_s = float(np.exp(minimum.x[0])), float(np.exp(minimum.x[1]))
    fading_s = float(np.clip(fading_s, config.shortest_s, config.longest_s))
    variance, log_likelihood = scale(ratio, fading_s)
    white = float(np.sqrt(variance))
    alone = scale(0.0, 1.0)[1]
    return Noise(white, NoiseCorrelation(ratio * white, fading_s), log_likelihood, log_likelihood - alone)


def is_noise(result: Fit) -> bool:
    """Whether what a fit leaves in channels of fading noise fades alike everywhere and is noise."""
    # What has not faded by the longest time tried is no noise but a wander: an R0 that walks.
    problem, config = result.problem, result.problem.method.noise_test
    longest_s = config.wanders * problem.correlation_config.longest_s
    if any(correlation.fading_s > longest_s for correlation in problem.correlation.values()):
        return False
    is_even = all(_is_even(result, channel) for channel in problem.correlation)
    return is_even and noise_chance(result, tuple(problem.correlation)) > config.chance


def noise_chance(result: Fit, channels: Sequence[str] = ()) -> float:
    """Return how likely noise leaves as much as a fit does, in these channels or all scored ones."""
    problem, chances = result.problem, []
    for channel in channels or problem.scored_channels:
        # By how many standard errors what is left is more than noise. A filter has taken the memory out of noise that
        # fades, and its size was read off what is left.
        blocks, tests = problem.blocks_of(channel), []
        if channel not in problem.correlation:
            squares = np.concatenate([result.residual[b.rows] for b in blocks]) ** 2
            count = int(np.count_nonzero(squares))
            # The noise level is of the same samples: its error adds as much as it takes.
            tests.append((float(np.sum(squares)) - count) / float(np.sqrt(2.0 * max(count, 1))))
        if tests and not problem.is_driven_by_force:
            tests.append(_remembers(result, blocks))
        # What another channel leaves of the same runs: their noises have nothing in common.
        elsewhere = np.zeros(len(problem.measured))
        others = {b.run: b for name in problem.scored_channels if name != channel for b in problem.blocks_of(name)}
        for block in blocks:
            if block.run in others and problem.case.runs[block.run].kind == "press":
                elsewhere[block.rows] = (problem.measured - result.predicted)[others[block.run].rows]
        # A measured force that drives the chain is smoothed: what is left of its noise has a memory.
        for group in () if problem.is_driven_by_force else problem.model.followed(result, channel):
            columns = [*group, elsewhere] if elsewhere.any() else group
            visible = projected([problem.whitened(column) for column in columns], result.jacobian)
            # A direction takes 1 off χ² by chance.
            chi2 = float(np.sum((visible @ result.residual) ** 2)) if len(visible) else 0.0
            tests.append(_standard(chi2, len(visible)) if len(visible) else 0.0)
        # The worst of several tests (Bonferroni).
        chances.append(min(1.0, len(tests) * float(ndtr(-max(tests)))) if tests else 1.0)
    return min(chances)


def _is_even(result: Fit, channel: str) -> bool:
    """Whether one fading noise fits both of two conditions alike; white noise may grow with the load."""
    problem, config = result.problem, result.problem.method.noise_test
    white, correlation = problem.sigma[channel], problem.correlation[channel]
    blocks = problem.blocks_of(channel)
    for halves in zip(*(list(problem.model.halves(result, block)) for block in blocks), strict=True):
        pairs = [(b, is_in) for b, is_in in zip(blocks, halves, strict=True) if is_in is not None]
        sides = [[(b, (is_in == side).astype(np.float64)) for b, is_in in pairs] for side in (False, True)]
        parts = [[_stretch(result, b, mask) for b, mask in side] for side in sides]
        if any(sum(float(s.is_used.sum()) for s in part) < config.fewest for part in parts):
            continue
        gain = 0.0
        for part in parts:
            # Against this fading noise beside any white one.
            loss = partial(lambda x, part: -log_likelihood(part, white * float(np.exp(x)), correlation), part=part)
            common = minimize_scalar(loss, bounds=(-2.0, 2.0), method="bounded")
            gain += read_noise(part, problem.correlation_config).log_likelihood + float(common.fun)
        if gain >= config.uneven:
            return False
    return True


def _remembers(result: Fit, blocks: Sequence[Block]) -> float:
    """Return by how many standard errors a residual follows its own past (Box and Pierce 1970)."""
    lags = result.problem.method.noise_test.lags
    parts = [result.residual[b.rows] for b in blocks]
    products, count, energy = np.zeros(lags), 0, 0.0
    for part in parts:
        count, energy = count + len(part), energy + float(part @ part)
        products += [float(part[k:] @ part[:-k]) for k in range(1, lags + 1)]
    return _standard(count * float(np.sum((products / energy) ** 2)), lags) if energy > 0.0 else 0.0


def _standard(chi2: float, freedom: int) -> float:
    """Return χ² as a standard normal value (Wilson and Hilferty 1931)."""
    wide = 2.0 / (9.0 * freedom)
    return float((np.cbrt(chi2 / freedom) - 1.0 + wide) / np.sqrt(wide))


def with_driving_noise(problem: Problem, result: Fit) -> Problem:
    """Return the problem with the noise of a measured force where it drives the chain.

    σ² = σV² + (dV/dF·σF)²: errors in variables to first order.
    """
    case = problem.case
    driven = [run.kind == "press" and run.stage_mm is None and run.force_N is not None for run in case.runs]
    if not any(driven):
        return problem
    extra = np.zeros(len(problem.measured))
    for block in (b for b in problem.blocks if driven[b.run]):
        run = case.runs[block.run]
        force_N = np.asarray(run.force_N)
        order = np.argsort(force_N, kind="stable")
        x, y = force_N[order], result.predicted[block.rows][order]
        # A slope from neighbours would be noise over noise; a 24th of the samples shows the curve's.
        edges = np.linspace(0, len(x) - 1, 25).astype(int)
        is_distinct = np.concatenate([[True], np.diff(x[edges]) > 1e-7 * np.ptp(x)])
        slopes = (
            np.gradient(y[edges][is_distinct], x[edges][is_distinct])
            if is_distinct.sum() > 2
            else np.zeros(int(is_distinct.sum()))
        )
        slope = np.interp(force_N, x[edges][is_distinct], slopes)
        # Smoothed noise moves slowly: it counts as often as samples share it.
        extra[block.rows] = (2 * HALF_WIDTH + 1) * (slope * run.driving_force.sigma_N) ** 2
    return replace(problem, extra_variance=extra)


@dataclass(frozen=True)
class Quantified:
    """The gap per channel before and after, and by how much it shrinks."""

    gap: dict[str, ChannelGap]
    explained_fraction: ExplainedFraction
    protocol: str
    chosen: tuple[tuple[str, ...], ...] = ()
    """Causes that are chosen where each part of the samples, in turn, is held back."""
    held_out_gain: float = 0.0
    gain_error: float = 0.0
    """By how much χ² falls on samples no fit has seen, and its standard error. It tells smaller effects than the shrink
    does: that one compares roots of mean squares with a noise level that is estimated too."""
    config: ExplainedFractionConfig = ExplainedFractionConfig()

    @property
    def is_supported(self) -> bool:
        """Whether the causes lower the gap on samples held back, by more than its noise."""
        return self.held_out_gain > self.config.beyond * self.gain_error and self.explained_fraction.held_out > 0.0


@dataclass(frozen=True, eq=False)
class _Fold:
    unseen: Mask
    before: Fit
    after: Fit

    def chosen(self, others: Iterable[Fit]) -> "_Fold":
        """Return the fold with the hypothesis chosen without the samples held back."""
        problem, now = self.after.problem, (self.before, self.after)
        foretold = [f.under(problem) for f in others]
        # To first order: the χ² that one step from its slopes promises on the samples a fit sees.
        pull = [(f, f.jacobian @ f.residual) for f in foretold]
        foretold = [replace(f, chi2=f.chi2 - float(slope @ f.covariance @ slope)) for f, slope in pull]
        yardstick = Yardstick.from_fits((*now, *foretold))
        config = problem.method.explained_fraction
        min_evidence = max(map(yardstick.log_evidence, now)) - config.near
        near = sorted((f for f in foretold if yardstick.log_evidence(f) > min_evidence), key=lambda f: f.bic)
        fitted = [fit(problem, f.hypothesis, f.coordinates, steps=6) for f in near[: config.max_candidates]]
        yardstick = Yardstick.from_fits((*now, *fitted))
        return replace(self, after=max((*now, *fitted), key=yardstick.log_evidence))


def quantify(base: Fit, best: Fit, others: Iterable[Fit] = (), is_chosen: bool = False) -> Quantified:
    """Refit base and hypothesis without a part of the samples, forecast the shrink there, then look.

    Whole runs are held back in turn; with one run, or an effect of one run, stretches of every run are.
    The forecast is of the best hypothesis. What is measured on a part is what the hypothesis reaches
    that would have been chosen without it: causes look too good on the samples they were chosen by.

    Args:
        others: hypotheses that may be chosen where a part is held back, fitted to all samples.
        is_chosen: measure this hypothesis on every part, whatever would be chosen there.
    """
    folds, protocol = _folds(base.problem, best.hypothesis)
    folds_refitted = [_refit(base, best, unseen) for unseen in folds]
    if not best.ids:
        gap = {c: _channel_gap(folds_refitted, best.problem, c) for c in best.problem.scored_channels}
        return Quantified(gap, ExplainedFraction(0.0, 0.0, 0.0, 0.0), protocol)
    # Every fold has the base; what belongs to one run foretells no other.
    competing = [
        other
        for other in others
        if other.ids not in ((), best.ids) and not any(effect.belongs_to_run for effect in other.effects)
    ]
    chosen = folds_refitted if is_chosen else [fold.chosen(competing) for fold in folds_refitted]
    gap = {c: _channel_gap(chosen, best.problem, c) for c in best.problem.scored_channels}
    config = best.problem.method.explained_fraction
    explained_fraction = ExplainedFraction.checked(
        _forecast(folds_refitted, best), _explained_fraction(gap.values()), config
    )
    ids = tuple(fold.after.ids for fold in chosen)
    return Quantified(gap, explained_fraction, protocol, ids, *_held_out_gain(chosen, best.problem), config)


def _folds(problem: Problem, hypothesis: Hypothesis) -> tuple[list[Mask], str]:
    config = problem.method.explained_fraction
    presses = np.flatnonzero([run.kind == "press" for run in problem.case.runs])
    # What belongs to one run cannot be foretold by another.
    is_by_run = len(presses) > 1 and not any(effect.belongs_to_run for effect in hypothesis.effects)
    parts = presses if is_by_run else np.arange(config.parts)
    unseen = np.zeros((len(parts), len(problem.measured)), dtype=np.bool_)
    for block in problem.blocks:
        stretch = (problem.case.runs[block.run].elapsed_s / config.block_s).astype(int) % config.parts
        unseen[:, block.rows] = parts[:, np.newaxis] == (block.run if is_by_run else stretch)
    return list(unseen), f"{'one run after the other' if is_by_run else 'stretches of every run'} held back"


def _refit(base: Fit, best: Fit, unseen: Mask) -> _Fold:
    problem = best.problem.seeing((~unseen).astype(np.float64))
    # Few steps: the parameters of the whole case are a start close by.
    before = fit(problem, base.hypothesis, base.coordinates, steps=6)
    after = before if best is base else fit(problem, best.hypothesis, best.coordinates, steps=6)
    return _Fold(unseen, before, after)


def held_out_error(base: Fit, result: Fit) -> float:
    """Return the error of a hypothesis on samples held back in turn, RMS in units of the noise."""
    problem, squares, count = result.problem, 0.0, 0
    for unseen in _folds(problem, result.hypothesis)[0]:
        after = _refit(base, result, unseen).after
        errors = problem.whitened(problem.measured - after.predicted)[np.flatnonzero(unseen)]
        squares, count = squares + energy(errors), count + len(errors)
    return float(np.sqrt(squares / max(count, 1)))


def _pooled(folds: list[_Fold], problem: Problem, channel: str, errors: list[Array]) -> float:
    squares, count = 0.0, 0
    for fold, error in zip(folds, errors, strict=True):
        # Presses alone count: they are what a twin is for, weights and resistors only calibrate it.
        for block in problem.blocks_of(channel, "press"):
            members = error[block.rows][fold.unseen[block.rows]]
            squares, count = squares + float(members @ members), count + len(members)
    return float(np.sqrt(squares / max(count, 1)))


def unsupported(best: Fit, smaller: Mapping[str, Fit]) -> list[str]:
    """Return causes that lower nothing on samples held back, the weakest first; `smaller` lacks each."""
    folds = [_refit(best, best, unseen) for unseen in _folds(best.problem, best.hypothesis)[0]]
    sure = {}
    for effect_id, rest in smaller.items():
        pairs = [
            replace(fold, before=fit(fold.after.problem, rest.hypothesis, rest.coordinates, steps=6)) for fold in folds
        ]
        gain, error = _held_out_gain(pairs, best.problem)
        sure[effect_id] = gain / error if error > 0.0 else 0.0
    return sorted(
        (i for i, z in sure.items() if z <= best.problem.method.explained_fraction.beyond), key=lambda i: sure[i]
    )


def _held_out_gain(folds: list[_Fold], problem: Problem) -> tuple[float, float]:
    """Return by how much χ² falls on samples held back, and its standard error from white noise."""
    gain = parted = 0.0
    for fold in folds:
        before, after = (
            problem.whitened(problem.measured - f.predicted)[np.flatnonzero(fold.unseen)]
            for f in (fold.before, fold.after)
        )
        gain, parted = gain + energy(before) - energy(after), parted + energy(before - after)
    return gain, 2.0 * float(np.sqrt(parted))


def _channel_gap(folds: list[_Fold], problem: Problem, channel: str) -> ChannelGap:
    measured = problem.measured
    before = _pooled(folds, problem, channel, [measured - f.before.predicted for f in folds])
    after = _pooled(folds, problem, channel, [measured - f.after.predicted for f in folds])
    return ChannelGap(before, after, problem.noise_floor(channel))


def _explained_fraction(channels: Iterable[ChannelGap]) -> float:
    gap = residual_gap = 0.0
    for one in channels:
        gap += max(one.rmse_before - one.noise_floor, 0.0) / one.noise_floor
        residual_gap += max(one.rmse_after - one.noise_floor, 0.0) / one.noise_floor
    return float(np.clip(1.0 - residual_gap / gap, 0.0, 1.0)) if gap > 0 else 0.0


def _forecast(folds: list[_Fold], best: Fit) -> tuple[float, float, float]:
    """Forecast the shrink from the fitted parts alone.

    Before: the two fitted twins part by so much. After: the parameters' uncertainty carried to the
    unseen samples, and what the hypothesis leaves on those it has seen. Where that has no structure it
    is an error of the noise level, and widens the interval alone.
    """
    problem, spreads, config = best.problem, [], best.problem.method.explained_fraction
    for fold in folds:
        # (samples,) standard deviation of the prediction by that of the parameters: the diagonal of J C Jᵀ alone, for
        # the whole matrix would be samples by samples.
        result = fold.after
        unweighted = result.problem.seeing(np.ones(len(result.problem.measured)))
        slopes = fit(unweighted, result.hypothesis, result.coordinates, steps=0).slopes
        spreads.append(np.sqrt(np.maximum(np.sum(result.covariance @ slopes * slopes, axis=0), 0.0)))
    is_noise, likely, pessimist, optimist = problem.model.is_clean(best), [], [], []
    for channel in problem.scored_channels:
        noise_floor = problem.noise_floor(channel)
        # What the hypothesis leaves above the floor. Where a measured force drives the chain its noise is part of it:
        # nothing removes it on other samples either.
        parts = [(problem.measured - best.predicted)[b.rows] for b in problem.blocks_of(channel)]
        error = np.concatenate(parts) / noise_floor
        # One standard error is taken off: what a right hypothesis leaves scatters about 1.
        structured = noise_floor * float(np.sqrt(max(0.0, float(np.mean(error**2)) - 1.0 - np.sqrt(2.0 / len(error)))))
        parted = _pooled(folds, problem, channel, [f.after.predicted - f.before.predicted for f in folds])
        spread = _pooled(folds, problem, channel, spreads)
        unexplained = 0.0 if is_noise else structured
        before = [float(np.sqrt(noise_floor**2 + parted**2 + part**2)) for part in (unexplained, structured)]
        likely.append(ChannelGap(before[0], float(np.sqrt(noise_floor**2 + unexplained**2 + spread**2)), noise_floor))
        after = float(np.sqrt(noise_floor**2 + (config.left_grows * structured) ** 2 + (2.0 * spread) ** 2))
        pessimist.append(ChannelGap(before[1], after, noise_floor))
        # What these runs do not tell of a parameter may turn out to be right.
        optimist.append(ChannelGap(before[0], float(np.sqrt(noise_floor**2 + unexplained**2)), noise_floor))
    predicted = _explained_fraction(likely)
    margin = max(config.min_margin, predicted - _explained_fraction(pessimist))
    return predicted, max(0.0, predicted - margin), min(1.0, max(predicted + margin, _explained_fraction(optimist)))


def on_unseen(group: tuple[Fit, ...], rejected: set[str]) -> tuple[tuple[Fit, ...], set[str]]:
    """Return rivals but those that add a cause that lowers nothing on unseen samples; and these causes."""
    best, in_play, idle = group[0], [group[0]], set()
    for other in group[1:]:
        added = set(other.ids) - set(best.ids)
        # Another form of a cause may hold what a second one is: nothing is left for that to lower.
        is_larger = set(best.ids) < set(other.ids) and not any(form_of(best, effect) for effect in best.effects)
        if is_larger and (added & rejected or (len(added) == 1 and unsupported(other, dict.fromkeys(added, best)))):
            idle |= added
        else:
            in_play.append(other)
    return tuple(in_play), idle
