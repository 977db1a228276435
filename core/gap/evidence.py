"""How probable each effect is, what cannot be told apart, what is a rest; how every cause stands in a report.

What a hypothesis leaves may be a rest that nothing in the list says. Then a cause of the list may only imitate a part
of that rest. A cause that is there takes most of what is left once all others are fitted, and has one size in every
part of every run, whatever the rest does. One that imitates takes a part, and asks for more here and less there.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import expit, logit, softmax

from softcal.core.gap.fit import Fit, Regime, Tangent, form_of, structure
from softcal.core.gap.linear import energy, fit_scale, from_fit, orthonormal
from softcal.core.gap.method import PresenceConfig
from softcal.core.gap.model import FaultLocation, ParameterEstimate, Partial, RankedCause
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect
from softcal.core.unit.uncertainty import NORMAL_90

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Assessment
    from softcal.core.gap.search import Search

Fits = Mapping[tuple[str, ...], Fit]


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
    def of(cls, fits: Iterable[Fit]) -> "Yardstick":
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
    yardstick = Yardstick.of(fits.values())
    return {ids: yardstick.log_evidence(result) for ids, result in fits.items()}


def probabilities(logs: Mapping[tuple[str, ...], float], effects: Iterable[str]) -> dict[str, float]:
    """Return for every effect the probability that it is present, from log evidences.

    Effects that were screened away have no hypothesis and get 0; the numbers need not sum to 1.
    """
    weights = weights_of(logs)
    return {e: sum(w for ids, w in weights.items() if e in ids) for e in effects}


def weights_of(logs: Mapping[tuple[str, ...], float]) -> dict[tuple[str, ...], float]:
    """Return the probability of every hypothesis, from log evidences."""
    return dict(zip(logs, softmax(list(logs.values())).tolist(), strict=True))


def competing_hypotheses(
    fits: Fits, best: Fit, logs: Mapping[tuple[str, ...], float], not_excluded: tuple[Fit, ...] = ()
) -> tuple[Fit, ...]:
    """Return the best hypothesis, those held open, and those the evidence cannot rule out.

    One that adds a cause counts where the evidence for that is neither negligible nor decisive.
    """
    if not best.ids:
        return (best,)
    config = best.problem.method.rival
    top = logs[best.ids]
    near = [fits[ids] for ids in sorted(logs, key=lambda i: -logs[i]) if logs[ids] > top - config.odds]
    in_play: list[Fit] = [best, *not_excluded]
    for result in near:
        ids = set(result.ids)
        # A larger set of causes holds the evidence of the smaller one and says nothing new.
        if ids and not any(ids >= set(other.ids) for other in in_play):
            in_play.append(result)
    max_causes = max(config.most_causes, len(best.ids) + 1)
    # Hypotheses with one cause more that can be neither named nor left out.
    best_ids = set(best.ids)
    larger = [f for ids, f in fits.items() if set(ids) > best_ids and len(ids) == len(best_ids) + 1]
    ahead = {f.ids: exact_log_evidence(f) - exact_log_evidence(best) for f in larger}
    min_log = max(ahead.values(), default=0.0) - config.odds
    # Another form of one cause may be two in the catalogue's equations: a joint is frame and toe.
    is_in_other_form = any(form.effect is e for e in best.effects for form in best.problem.model.forms_of(e.id))
    within = config.odds if is_in_other_form else config.added
    max_z = max(best.problem.method.structure.dirty_z, config.structure_left * structure(best).z)
    for result in sorted(larger, key=lambda f: -ahead[f.ids]):
        gain, behind = ahead[result.ids], top - logs[result.ids]
        is_near = behind < within or (behind < config.negligible and gain > config.exact)
        if gain < min_log or not is_near or structure(result).z >= max_z or any(result.ids == f.ids for f in in_play):
            continue
        if len({*result.ids}.union(*(other.ids for other in in_play))) <= max_causes:
            in_play.append(result)
    return tuple(in_play[: config.most])


def confused_pairs(group: tuple[Fit, ...]) -> list[list[str]]:
    """Return the pairs of effects that stand for each other in rival hypotheses.

    A cause beside another rival's stands for what the equation of the largest of those leaves.
    """
    best = set(group[0].ids)
    pairs: list[list[str]] = []
    for other in group[1:]:
        of_best = sorted(best - set(other.ids))
        of_other = sorted(set(other.ids) - best)
        shared = sorted(best & set(other.ids), key=lambda i: -energy(signature(group[0], i)))
        crossed_pairs = [[a, b] for a in of_best for b in of_other] or [
            [shared[0], extra] for extra in (*of_best, *of_other)
        ]
        pairs += [pair for pair in crossed_pairs if pair not in pairs]
    return pairs


def hidden_fraction(result: Fit, effect_id: str) -> float:
    """Return which share of an effect's signature, at its size, the refitted base would swallow."""
    change = signature(result, effect_id)
    size = energy(change)
    if size <= 0.0:
        return 1.0
    # To first order: a full refit for each effect would take as long as the diagnosis.
    visible = Tangent(result, base_only=True).visible(change)
    return float(np.clip(1.0 - energy(visible) / size, 0.0, 1.0))


@dataclass(frozen=True)
class Consistency:
    """How a cause stands to the rest that its hypothesis leaves.

    Args:
        energy_share: share of the cause in the energy of cause and rest, of what no other fitted parameter imitates.
        disagreement: root mean square by which the parts of all runs ask for another size, relative to the fitted one.
        cancelled: share of what the base leaves of its signature that the other causes cancel: two that imitate a
            third by their difference cancel nearly all.
        is_on_bound: whether a parameter ends on a bound: its law wants to be another one.
    """

    energy_share: float
    disagreement: float
    cancelled: float = 0.0
    is_on_bound: bool = False

    def genuine_chance(self, config: PresenceConfig) -> float:
        """Return how likely a cause that stands so to a rest is there, and imitates nothing."""
        apart = np.log(min(max(self.disagreement, 1e-3), 1e300) / config.disagreement)
        odds = logit(np.clip(self.energy_share, 0.0, 1.0))
        against = config.of_disagreement * apart - config.of_cancelled * np.log1p(-min(self.cancelled, 1.0 - 1e-9))
        against += config.of_bound * self.is_on_bound
        return float(expit(config.of_share * (odds - config.share_odds) - against))


def signature(result: Fit, effect_id: str) -> Array:
    """Return (samples,) change of the whitened prediction when an effect of a fit is switched off."""
    smaller, is_retained = result.hypothesis.without(effect_id)
    without = result.problem.predict(smaller, result.coordinates[is_retained])
    return result.problem.whitened(result.predicted - without)


def rest_energy(result: Fit, noise_chance: float) -> float:
    """Return how much of χ² is a rest that is no noise; 0 where noise leaves as much often enough.

    Args:
        noise_chance: how likely noise alone leaves as much, a p-value.
    """
    if noise_chance > result.problem.method.floor.chance:
        return 0.0
    count, residual = result.problem.count, structure(result)
    # A noise level read off the residual itself holds a part of the rest: at least two standard errors of χ².
    min_energy = 2.0 * float(np.sqrt(2.0 * count))
    return max(energy(result.residual) - count, residual.rms**2 * count if residual.is_significant else 0.0, min_energy)


def consistency_of(result: Fit, effect_id: str, rest: float) -> Consistency:
    """Return how a cause of a fit stands to the rest that the fit leaves, in units of χ²."""
    config, change, at = result.problem.model.presence_config, signature(result, effect_id), result.hypothesis.slices
    # Of its signature what no other fitted parameter imitates.
    others = np.delete(result.jacobian, range(at[effect_id].start, at[effect_id].stop), axis=0)
    basis = orthonormal(others, 1e-10)
    visible = np.asarray(change - (basis @ change) @ basis)
    visible_energy = energy(visible)
    if visible_energy <= 0.0:
        return Consistency(0.0, np.inf)
    pulled = 0.0
    for block in result.problem.blocks:
        for part in np.array_split(np.arange(block.rows.start, block.rows.stop), config.parts):
            part_energy = energy(visible[part])
            # A part where the cause does not act asks for nothing.
            if part_energy > config.acts * visible_energy:
                pulled += float(visible[part] @ result.residual[part]) ** 2 / part_energy
    beyond_base = energy(Tangent(result, base_only=True).visible(change))
    cancelled = float(np.clip(1.0 - visible_energy / beyond_base, 0.0, 1.0)) if beyond_base > 0.0 else 0.0
    is_on_bound = any(name.startswith(f"{effect_id}.") for name in bounds_reached(result))
    return Consistency(
        visible_energy / (visible_energy + rest), float(np.sqrt(pulled / visible_energy)), cancelled, is_on_bound
    )


def list_completeness(noise_chance: float, rest_share: float, has_unlisted: bool, config: PresenceConfig) -> float:
    """Return how likely nothing unmodelled is left.

    Args:
        noise_chance: how likely noise alone leaves as much, a p-value.
        rest_share: share of the gap that is left beside the causes.
        has_unlisted: whether a departure outside the list explains more than the list does.
    """
    if has_unlisted:
        return config.unlisted
    # The most a p-value can say for a rest: Bayes factor −e·p·ln p (Sellke, Bayarri and Berger 2001).
    p = min(max(noise_chance, 1e-300), float(np.exp(-1.0)))
    odds = config.complete_odds * -float(np.e * p * np.log(p))
    by_noise = odds / (1.0 + odds)
    # Another law of the same cause leaves a small part of a large gap.
    by_share = 1.0 / (1.0 + (max(rest_share, 0.0) / config.half_share) ** 2)
    return max(by_noise, by_share * config.open_law)


def estimates_of(result: Fit, effect_id: str) -> dict[str, ParameterEstimate]:
    """Return value and 90 % interval of an effect's parameters; none where the fit lacks it."""
    effect = next((e for e in result.effects if e.id == effect_id), None)
    if effect is None:
        return {}
    at, out = result.hypothesis.slices[effect_id], {}
    margins = NORMAL_90 * np.sqrt(np.maximum(np.diag(result.covariance), 0.0))[at]
    for parameter, x, margin in zip(effect.parameters, result.coordinates[at], margins, strict=True):
        p = result.problem.scale.sized(parameter)
        ends = sorted(from_fit(p, float(x + side * margin)) for side in (-1.0, 1.0))
        three = (from_fit(p, float(x)), *ends)
        value, low, high = (float(np.nan_to_num(v, posinf=p.high, neginf=p.low)) for v in three)
        out[p.name] = ParameterEstimate(value, low, high, p.unit)
    return out


def bounds_reached(result: Fit) -> dict[str, float]:
    """Return the parameters that a fit left on a bound, with values; a cause's as `cause.parameter`.

    A bound that switches a cause off is none.
    """
    base, rows = result.hypothesis.split(result.coordinates)
    free = [p for p, is_free in zip(result.hypothesis.of_all, result.problem.is_free, strict=True) if is_free]
    pairs = [(p.name, p, v) for p, v in zip(result.hypothesis.of_all, base, strict=True) if p in free]
    for effect, values in zip(result.effects, rows, strict=True):
        pairs += [(f"{effect.id}.{p.name}", p, v) for p, v in zip(effect.parameters, values, strict=True)]
    reached = {}
    for name, parameter, value in pairs:
        sized = result.problem.scale.sized(parameter)
        ends = [
            end for end in (sized.low, sized.high) if np.isfinite(end) and end != sized.neutral and not sized.is_fixed
        ]
        if any(math.isclose(value, end, rel_tol=1e-6, abs_tol=1e-9 * abs(sized.usual)) for end in ends):
            reached[name] = value
    return reached


def fault_locations(
    causes: Sequence[RankedCause], channel: str, regime: Reason, detail: Callable[[str], Reason]
) -> list[FaultLocation]:
    """Return the places of named causes, each with its part of what all of them take."""
    total = sum(c.shrink or 0.0 for c in causes) or 1.0
    return [FaultLocation(c.stage, channel, regime, (c.shrink or 0.0) / total, detail(c.effect)) for c in causes]


def with_residual_location(locations: Sequence[FaultLocation], rest: FaultLocation) -> list[FaultLocation]:
    """Return the places of causes, scaled by what they take, with the place of a rest."""
    rest = replace(rest, detail=reason("gap.seen.rest", share=rest.share))
    return [*(replace(location, share=(1.0 - rest.share) * location.share) for location in locations), rest]


def regime_locations(stage: str, regimes: Sequence[Regime], code: str) -> list[FaultLocation]:
    """Return the first four regimes in which the gap stands out as places at a stage."""
    return [
        FaultLocation(stage, r.channel, r.name, r.share, reason(code, share=r.share, lift=r.lift)) for r in regimes[:4]
    ]


def partial_of(search: "Search", assessment: "Assessment") -> Partial | None:
    """Return the set and its share of the gap where a rest is left; what comes nearest where no set stands."""
    if assessment.verdict not in ("unknown", "explained_in_part"):
        return None
    closest = assessment.best if assessment.best.ids else nearest(search)
    share = search.explained_share(closest)
    return Partial(closest.ids, share) if closest.ids and share > 0.0 else None


def nearest(search: "Search") -> Fit:
    """Return the simplest hypothesis that takes nearly the most of the gap away."""
    max_share = max(search.share(result) for result in search.fits.values())
    fits = list(search.fits.values())
    enough = max_share - fits[0].problem.method.verdict.near_share
    near = [result for result in fits if search.share(result) >= enough]
    return min(near, key=lambda result: (len(result.ids), result.chi2))


def ranked_causes(
    search: "Search",
    best: Fit,
    effects: Sequence[Effect],
    fits: tuple[Fit, ...],
    chances: dict[str, float],
    explained_fraction: float,
) -> tuple[RankedCause, ...]:
    """Return every effect with how it stands, the likeliest first.

    Args:
        fits: where parameters are taken from, the first that has them; else from the effect alone.
        explained_fraction: share of the gap that goes on samples held back, split among the best causes.
    """
    ids = best.ids
    excess = max(search.base.chi2 - search.base.problem.count, 0.0)
    one_less = {i: search.fits.get(tuple(j for j in ids if j != i)) for i in ids}
    # The explained χ² is split among several causes: the mean of adding each first and last.
    worth = dict.fromkeys(ids, 1.0)
    for effect_id in ids if len(ids) > 1 else ():
        alone, rest = search.fits.get((effect_id,)), one_less[effect_id]
        first = search.base.chi2 - alone.chi2 if alone else 0.0
        last = rest.chi2 - best.chi2 if rest else 0.0
        worth[effect_id] = max(0.5 * (first + last), 0.0)
    total = sum(worth.values()) or 1.0
    forms = {e.id: form_of(best, e) for e in best.effects}

    def share_of(better: Fit | None, worse: Fit | None) -> float | None:
        if better is None or worse is None or excess <= 0.0:
            return None
        return float(np.clip((worse.chi2 - better.chi2) / excess, 0.0, 1.0))

    def cause(effect: Effect) -> RankedCause:
        result = next((f for f in fits if effect.id in f.ids), search.fits.get((effect.id,)))
        return RankedCause(
            effect.id,
            effect.stage,
            chances[effect.id],
            worth[effect.id] / total * explained_fraction if effect.id in worth else None,
            estimates_of(result, effect.id) if result is not None else {},
            forms.get(effect.id, ""),
            alone=share_of(search.fits.get((effect.id,)), search.base),
            added=share_of(best, one_less.get(effect.id)),
        )

    return tuple(sorted(map(cause, effects), key=lambda c: (-c.probability, -(c.shrink or 0.0))))
