"""How far the gap shrinks: forecast, then measured on samples that no fit has seen."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.gap.case import Mask
from softcal.core.gap.evidence import Yardstick
from softcal.core.gap.fit import Fit, fit, form_of
from softcal.core.gap.linear import combine, energy
from softcal.core.gap.method import ShrinkConfig
from softcal.core.gap.problem import Hypothesis, Problem
from softcal.core.gap.residual import ChannelGap, Shrink
from softcal.core.recording import Array


@dataclass(frozen=True)
class Quantified:
    """The gap per channel before and after, and by how much it shrinks."""

    gap: dict[str, ChannelGap]
    shrink: Shrink
    protocol: str
    chosen: tuple[tuple[str, ...], ...] = ()
    """Causes that are chosen where each part of the samples, in turn, is held back."""
    held_out_gain: float = 0.0
    gain_error: float = 0.0
    """By how much χ² falls on samples no fit has seen, and its standard error. It tells smaller effects than the shrink
    does: that one compares roots of mean squares with a noise level that is estimated too."""
    config: ShrinkConfig = ShrinkConfig()

    @property
    def stands(self) -> bool:
        """Whether the causes lower the gap on samples held back, by more than its noise."""
        return self.held_out_gain > self.config.beyond * self.gain_error and self.shrink.held_out > 0.0


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
        yardstick = Yardstick.of((*now, *foretold))
        config = problem.method.shrink
        least = max(map(yardstick.log_evidence, now)) - config.near
        near = sorted((f for f in foretold if yardstick.log_evidence(f) > least), key=lambda f: f.bic)
        fitted = [fit(problem, f.hypothesis, f.coordinates, steps=6) for f in near[: config.most_chosen_from]]
        yardstick = Yardstick.of((*now, *fitted))
        return replace(self, after=max((*now, *fitted), key=yardstick.log_evidence))


def quantify(base: Fit, best: Fit, others: Iterable[Fit] = (), is_given: bool = False) -> Quantified:
    """Refit base and hypothesis without a part of the samples, forecast the shrink there, then look.

    Whole runs are held back in turn; with one run, or an effect of one run, stretches of every run are.
    The forecast is of the best hypothesis. What is measured on a part is what the hypothesis reaches
    that would have been chosen without it: causes look too good on the samples they were chosen by.

    Args:
        others: hypotheses that may be chosen where a part is held back, fitted to all samples.
        is_given: measure this hypothesis on every part, whatever would be chosen there.
    """
    folds, protocol = _folds(base.problem, best.hypothesis)
    seen = [_refit(base, best, unseen) for unseen in folds]
    if not best.ids:
        gap = {c: _channel_gap(seen, best.problem, c) for c in best.problem.scored_channels}
        return Quantified(gap, Shrink(0.0, 0.0, 0.0, 0.0), protocol)
    # Every fold has the base; what belongs to one run foretells no other.
    rivals = [
        other
        for other in others
        if other.ids not in ((), best.ids) and not any(effect.belongs_to_run for effect in other.effects)
    ]
    chosen = seen if is_given else [fold.chosen(rivals) for fold in seen]
    gap = {c: _channel_gap(chosen, best.problem, c) for c in best.problem.scored_channels}
    config = best.problem.method.shrink
    shrink = Shrink.checked(_forecast(seen, best), _shrink_of(gap.values()), config)
    ids = tuple(fold.after.ids for fold in chosen)
    return Quantified(gap, shrink, protocol, ids, *_held_out_gain(chosen, best.problem), config)


def _folds(problem: Problem, hypothesis: Hypothesis) -> tuple[list[Mask], str]:
    config = problem.method.shrink
    presses = np.flatnonzero([run.kind == "press" for run in problem.case.runs])
    # What belongs to one run cannot be foretold by another.
    is_by_run = len(presses) > 1 and not any(effect.belongs_to_run for effect in hypothesis.effects)
    parts = presses if is_by_run else np.arange(config.parts)
    unseen = np.zeros((len(parts), len(problem.measured)), dtype=np.bool_)
    for block in problem.blocks:
        stretch = (problem.case.runs[block.run].elapsed_s / config.block_s).astype(int) % config.parts
        unseen[:, block.place] = parts[:, np.newaxis] == (block.run if is_by_run else stretch)
    return list(unseen), f"{'one run after the other' if is_by_run else 'stretches of every run'} held back"


def _refit(base: Fit, best: Fit, unseen: Mask) -> _Fold:
    problem = best.problem.seeing((~unseen).astype(np.float64))
    # Few steps: the parameters of the whole case are a start close by.
    before = fit(problem, base.hypothesis, base.coordinates, steps=6)
    after = before if best is base else fit(problem, best.hypothesis, best.coordinates, steps=6)
    return _Fold(unseen, before, after)


def held_out_error(base: Fit, found: Fit) -> float:
    """Return the error of a hypothesis on samples held back in turn, RMS in units of the noise."""
    problem, squares, count = found.problem, 0.0, 0
    for unseen in _folds(problem, found.hypothesis)[0]:
        after = _refit(base, found, unseen).after
        errors = problem.whitened(problem.measured - after.predicted)[unseen]
        squares, count = squares + energy(errors), count + len(errors)
    return float(np.sqrt(squares / max(count, 1)))


def _pooled(folds: list[_Fold], problem: Problem, channel: str, errors: list[Array]) -> float:
    squares, count = 0.0, 0
    for fold, error in zip(folds, errors, strict=True):
        # Presses alone count: they are what a twin is for, weights and resistors only calibrate it.
        for block in problem.blocks_of(channel, "press"):
            members = error[block.place][fold.unseen[block.place]]
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
    return sorted((i for i, z in sure.items() if z <= best.problem.method.shrink.beyond), key=lambda i: sure[i])


def _held_out_gain(folds: list[_Fold], problem: Problem) -> tuple[float, float]:
    """Return by how much χ² falls on samples held back, and its standard error from white noise."""
    gain = parted = 0.0
    for fold in folds:
        before, after = (
            problem.whitened(problem.measured - f.predicted)[fold.unseen] for f in (fold.before, fold.after)
        )
        gain, parted = gain + energy(before) - energy(after), parted + energy(before - after)
    return gain, 2.0 * float(np.sqrt(parted))


def _channel_gap(folds: list[_Fold], problem: Problem, channel: str) -> ChannelGap:
    measured = problem.measured
    before = _pooled(folds, problem, channel, [measured - f.before.predicted for f in folds])
    after = _pooled(folds, problem, channel, [measured - f.after.predicted for f in folds])
    return ChannelGap(before, after, problem.floor(channel))


def _shrink_of(channels: Iterable[ChannelGap]) -> float:
    gap = left = 0.0
    for one in channels:
        gap += max(one.rmse_before - one.noise_floor, 0.0) / one.noise_floor
        left += max(one.rmse_after - one.noise_floor, 0.0) / one.noise_floor
    return float(np.clip(1.0 - left / gap, 0.0, 1.0)) if gap > 0 else 0.0


def _forecast(folds: list[_Fold], best: Fit) -> tuple[float, float, float]:
    """Forecast the shrink from the fitted parts alone.

    Before: the two fitted twins part by so much. After: the parameters' uncertainty carried to the
    unseen samples, and what the hypothesis leaves on those it has seen. Where that has no structure it
    is an error of the noise level, and widens the interval alone.
    """
    problem, spreads = best.problem, []
    for fold in folds:
        # (samples,) standard deviation of the prediction by that of the parameters: the diagonal of J C Jᵀ alone, for
        # the whole matrix would be samples by samples.
        found = fold.after
        whole = found.problem.seeing(np.ones(len(found.problem.measured)))
        slopes = fit(whole, found.hypothesis, found.coordinates, steps=0).slopes
        carried = np.array([combine(row, slopes) for row in found.covariance])
        spreads.append(np.asarray(np.sqrt(np.maximum(np.sum(carried * slopes, axis=0), 0.0))))
    is_noise, likely, pessimist, optimist = problem.model.is_clean(best), [], [], []
    for channel in problem.scored_channels:
        floor = problem.floor(channel)
        # What the hypothesis leaves above the floor. Where a measured force drives the chain its noise is part of it:
        # nothing removes it on other samples either.
        parts = [(problem.measured - best.predicted)[b.place] for b in problem.blocks_of(channel)]
        error = np.concatenate(parts) / floor
        # One standard error is taken off: what a right hypothesis leaves scatters about 1.
        left = floor * float(np.sqrt(max(0.0, float(np.mean(error**2)) - 1.0 - np.sqrt(2.0 / len(error)))))
        parted = _pooled(folds, problem, channel, [f.after.predicted - f.before.predicted for f in folds])
        spread = _pooled(folds, problem, channel, spreads)
        unexplained = 0.0 if is_noise else left
        before = [float(np.sqrt(floor**2 + parted**2 + part**2)) for part in (unexplained, left)]
        likely.append(ChannelGap(before[0], float(np.sqrt(floor**2 + unexplained**2 + spread**2)), floor))
        after = float(np.sqrt(floor**2 + (1.6 * left) ** 2 + (2.0 * spread) ** 2))
        pessimist.append(ChannelGap(before[1], after, floor))
        # What these runs do not tell of a parameter may turn out to be right.
        optimist.append(ChannelGap(before[0], float(np.sqrt(floor**2 + unexplained**2)), floor))
    predicted = _shrink_of(likely)
    margin = max(problem.method.shrink.least_margin, predicted - _shrink_of(pessimist))
    return predicted, max(0.0, predicted - margin), min(1.0, max(predicted + margin, _shrink_of(optimist)))


def on_unseen(group: tuple[Fit, ...], gone: set[str]) -> tuple[tuple[Fit, ...], set[str]]:
    """Return rivals but those that add a cause that lowers nothing on unseen samples; and these causes."""
    best, in_play, idle = group[0], [group[0]], set()
    for other in group[1:]:
        added = set(other.ids) - set(best.ids)
        # Another form of a cause may hold what a second one is: nothing is left for that to lower.
        is_larger = set(best.ids) < set(other.ids) and not any(form_of(best, effect) for effect in best.effects)
        if is_larger and (added & gone or (len(added) == 1 and unsupported(other, dict.fromkeys(added, best)))):
            idle |= added
        else:
            in_play.append(other)
    return tuple(in_play), idle
