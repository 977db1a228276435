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
from softcal.core.gap.model import GapPlace, ParameterEstimate, Partial, RankedCause
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect
from softcal.core.unit.uncertainty import NORMAL_90

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Judgement
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
    floor: float

    @classmethod
    def of(cls, fits: Iterable[Fit]) -> "Yardstick":
        """Take the measure from fits under one noise level."""
        every = list(fits)
        config = every[0].problem.method.evidence
        closest = min(every, key=lambda f: f.chi2)
        left, gap = structure(closest), max(f.chi2 for f in every) - closest.chi2
        seen = left.rms**2 * closest.problem.count if left.is_significant else 0.0
        driven = config.driven_cost if closest.problem.is_driven_by_force else 0.0
        return cls(closest.chi2, max(seen, config.exactness * gap, driven))

    def log_evidence(self, found: Fit) -> float:
        """Return the logarithm of prior times evidence of a hypothesis."""
        modes = found.problem.method.evidence.modes
        return -0.5 * (misfit(max(found.chi2 - self.chi2, 0.0) + self.floor, modes) + penalty(found))


def exact_log_evidence(found: Fit) -> float:
    """Return the logarithm of prior times evidence of a hypothesis whose equations hold exactly."""
    return -0.5 * (found.chi2 + penalty(found))


def penalty(found: Fit) -> float:
    """Return the penalty where a loose lead is one cause, however often it gaps.

    Each episode was paid for in full when it was placed. A size that these runs hardly determine pays
    less than Schwarz's ln n: −2·ln of posterior over prior (Laplace). An unusual size is less likely.
    """
    problem, most = found.problem, float(np.log(found.problem.count))
    config = problem.method.evidence
    more = max(found.hypothesis.episode_count - 1, 0)
    cheaper = more * (config.episode_cost - config.further_episode_cost) * most
    if problem.is_driven_by_force:
        # What its noise feigns is in the floor already.
        cheaper += config.driven_cost * len(found.ids)
    spared, unusual, on_bound = 0.0, 0.0, 0
    for effect, values in zip(found.effects, found.effect_values, strict=True):
        size, at = problem.scale.sized(effect.parameters[0]), found.hypothesis.place_of(effect.id)
        ends = [end for end in (size.low, size.high) if end not in (0.0, size.neutral)]
        on_bound += size.scale == "linear" and any(abs(values[0] - end) < 0.01 * abs(end) for end in ends)
        variance = 0.0 if problem.is_driven_by_force else float(found.covariance[at, at])
        if variance > 0.0 and not effect.is_episodic:
            width = config.usual_range * fit_scale(size) / np.sqrt(2.0 * np.pi * variance)
            spared += size.weight * max(0.0, most - 2.0 * float(np.log(max(width, 1.0))))
        if size.neutral == 0.0:
            # Of two sets that these runs cannot tell apart the one of usual sizes is likelier: Cauchy's prior.
            unusual += 2.0 * float(np.log1p((values[0] / (config.usual_range * size.usual)) ** 2))
    return found.penalty - (cheaper + spared) + unusual + config.bound_cost * on_bound


def log_evidences(fits: Fits) -> dict[tuple[str, ...], float]:
    """Return the log of prior times evidence of every hypothesis, all under one noise level."""
    yardstick = Yardstick.of(fits.values())
    return {ids: yardstick.log_evidence(found) for ids, found in fits.items()}


def probabilities(logs: Mapping[tuple[str, ...], float], effects: Iterable[str]) -> dict[str, float]:
    """Return for every effect the probability that it is present, from log evidences.

    Effects that were screened away have no hypothesis and get 0; the numbers need not sum to 1.
    """
    weights = weights_of(logs)
    return {e: sum(w for ids, w in weights.items() if e in ids) for e in effects}


def weights_of(logs: Mapping[tuple[str, ...], float]) -> dict[tuple[str, ...], float]:
    """Return the probability of every hypothesis, from log evidences."""
    return dict(zip(logs, softmax(list(logs.values())).tolist(), strict=True))


def rivals(
    fits: Fits, best: Fit, logs: Mapping[tuple[str, ...], float], held_open: tuple[Fit, ...] = ()
) -> tuple[Fit, ...]:
    """Return the best hypothesis, those held open, and those the evidence cannot rule out.

    One that adds a cause counts where the evidence for that is neither negligible nor decisive.
    """
    if not best.ids:
        return (best,)
    config = best.problem.method.rival
    top = logs[best.ids]
    near = [fits[ids] for ids in sorted(logs, key=lambda i: -logs[i]) if logs[ids] > top - config.odds]
    in_play: list[Fit] = [best, *held_open]
    for found in near:
        ids = set(found.ids)
        # A larger set of causes holds the evidence of the smaller one and says nothing new.
        if ids and not any(ids >= set(other.ids) for other in in_play):
            in_play.append(found)
    most = max(config.most_causes, len(best.ids) + 1)
    # Hypotheses with one cause more that can be neither named nor left out.
    best_ids = set(best.ids)
    larger = [f for ids, f in fits.items() if set(ids) > best_ids and len(ids) == len(best_ids) + 1]
    ahead = {f.ids: exact_log_evidence(f) - exact_log_evidence(best) for f in larger}
    least = max(ahead.values(), default=0.0) - config.odds
    # Another form of one cause may be two in the catalogue's equations: a joint is frame and toe.
    is_in_other_form = any(form.effect is e for e in best.effects for form in best.problem.model.forms_of(e.id))
    within = config.odds if is_in_other_form else config.added
    most_z = max(best.problem.method.structure.dirty_z, config.structure_left * structure(best).z)
    for found in sorted(larger, key=lambda f: -ahead[f.ids]):
        gain, behind = ahead[found.ids], top - logs[found.ids]
        is_near = behind < within or (behind < config.negligible and gain > config.exact)
        if gain < least or not is_near or structure(found).z >= most_z or any(found.ids == f.ids for f in in_play):
            continue
        if len({*found.ids}.union(*(other.ids for other in in_play))) <= most:
            in_play.append(found)
    return tuple(in_play[: config.most])


def confused_pairs(group: tuple[Fit, ...]) -> list[list[str]]:
    """Return the pairs of effects that stand for each other in rival hypotheses.

    A cause beside another rival's stands for what the equation of the largest of those leaves.
    """
    best = set(group[0].ids)
    pairs: list[list[str]] = []
    for other in group[1:]:
        mine = sorted(best - set(other.ids))
        theirs = sorted(set(other.ids) - best)
        shared = sorted(best & set(other.ids), key=lambda i: -energy(signature(group[0], i)))
        between = [[a, b] for a in mine for b in theirs] or [[shared[0], extra] for extra in (*mine, *theirs)]
        pairs += [pair for pair in between if pair not in pairs]
    return pairs


def hidden_fraction(found: Fit, effect_id: str) -> float:
    """Return which share of an effect's signature, at its size, the refitted base would swallow."""
    own = signature(found, effect_id)
    size = energy(own)
    if size <= 0.0:
        return 1.0
    # To first order: a full refit for each effect would take as long as the diagnosis.
    seen = Tangent(found, base_only=True).visible(own)
    return float(np.clip(1.0 - energy(seen) / size, 0.0, 1.0))


@dataclass(frozen=True)
class Consistency:
    """How a cause stands to the rest that its hypothesis leaves.

    Args:
        taken: share of the cause in the energy of cause and rest, of what no other fitted parameter imitates.
        disagreement: root mean square by which the parts of all runs ask for another size, relative to the fitted one.
        cancelled: share of what the base leaves of its signature that the other causes cancel: two that imitate a
            third by their difference cancel nearly all.
        is_on_bound: whether a parameter ends on a bound: its law wants to be another one.
    """

    taken: float
    disagreement: float
    cancelled: float = 0.0
    is_on_bound: bool = False

    def genuine_chance(self, config: PresenceConfig) -> float:
        """Return how likely a cause that stands so to a rest is there, and imitates nothing."""
        apart = np.log(min(max(self.disagreement, 1e-3), 1e300) / config.disagreement)
        odds = logit(np.clip(self.taken, 0.0, 1.0))
        against = config.of_disagreement * apart - config.of_cancelled * np.log1p(-min(self.cancelled, 1.0 - 1e-9))
        against += config.of_bound * self.is_on_bound
        return float(expit(config.of_share * (odds - config.share_odds) - against))


def signature(found: Fit, effect_id: str) -> Array:
    """Return (samples,) change of the whitened prediction when an effect of a fit is switched off."""
    smaller, left = found.hypothesis.without(effect_id)
    without = found.problem.predict(smaller, found.coordinates[left])
    return found.problem.whitened(found.predicted - without)


def rest_energy(found: Fit, noise_chance: float) -> float:
    """Return how much of χ² is a rest that is no noise; 0 where noise leaves as much often enough.

    Args:
        noise_chance: how likely noise alone leaves as much, a p-value.
    """
    if noise_chance > found.problem.method.floor.chance:
        return 0.0
    count, left = found.problem.count, structure(found)
    # A noise level read off the residual itself holds a part of the rest: at least two standard errors of χ².
    least = 2.0 * float(np.sqrt(2.0 * count))
    return max(energy(found.residual) - count, left.rms**2 * count if left.is_significant else 0.0, least)


def consistency_of(found: Fit, effect_id: str, rest: float) -> Consistency:
    """Return how a cause of a fit stands to the rest that the fit leaves, in units of χ²."""
    config, mine, at = found.problem.model.presence_config, signature(found, effect_id), found.hypothesis.slices
    # Of its signature what no other fitted parameter imitates.
    others = np.delete(found.jacobian, range(at[effect_id].start, at[effect_id].stop), axis=0)
    basis = orthonormal(others, 1e-10)
    seen = np.asarray(mine - (basis @ mine) @ basis)
    whole = energy(seen)
    if whole <= 0.0:
        return Consistency(0.0, np.inf)
    asked = 0.0
    for block in found.problem.blocks:
        for part in np.array_split(np.arange(block.place.start, block.place.stop), config.parts):
            own = energy(seen[part])
            # A part where the cause does not act asks for nothing.
            if own > config.acts * whole:
                asked += float(seen[part] @ found.residual[part]) ** 2 / own
    beside_base = energy(Tangent(found, base_only=True).visible(mine))
    cancelled = float(np.clip(1.0 - whole / beside_base, 0.0, 1.0)) if beside_base > 0.0 else 0.0
    is_on_bound = any(name.startswith(f"{effect_id}.") for name in bounds_reached(found))
    return Consistency(whole / (whole + rest), float(np.sqrt(asked / whole)), cancelled, is_on_bound)


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


def estimates_of(found: Fit, effect_id: str) -> dict[str, ParameterEstimate]:
    """Return value and 90 % interval of an effect's parameters; none where the fit lacks it."""
    effect = next((e for e in found.effects if e.id == effect_id), None)
    if effect is None:
        return {}
    at, out = found.hypothesis.slices[effect_id], {}
    margins = NORMAL_90 * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))[at]
    for parameter, x, margin in zip(effect.parameters, found.coordinates[at], margins, strict=True):
        p = found.problem.scale.sized(parameter)
        ends = sorted(from_fit(p, float(x + side * margin)) for side in (-1.0, 1.0))
        three = (from_fit(p, float(x)), *ends)
        value, low, high = (float(np.nan_to_num(v, posinf=p.high, neginf=p.low)) for v in three)
        out[p.name] = ParameterEstimate(value, low, high, p.unit)
    return out


def bounds_reached(found: Fit) -> dict[str, float]:
    """Return the parameters that a fit left on a bound, with values; a cause's as `cause.parameter`.

    A bound that switches a cause off is none.
    """
    base, rows = found.hypothesis.split(found.coordinates)
    free = [p for p, is_free in zip(found.hypothesis.of_all, found.problem.is_free, strict=True) if is_free]
    pairs = [(p.name, p, v) for p, v in zip(found.hypothesis.of_all, base, strict=True) if p in free]
    for effect, values in zip(found.effects, rows, strict=True):
        pairs += [(f"{effect.id}.{p.name}", p, v) for p, v in zip(effect.parameters, values, strict=True)]
    reached = {}
    for name, parameter, value in pairs:
        own = found.problem.scale.sized(parameter)
        ends = [end for end in (own.low, own.high) if np.isfinite(end) and end != own.neutral and not own.is_fixed]
        if any(math.isclose(value, end, rel_tol=1e-6, abs_tol=1e-9 * abs(own.usual)) for end in ends):
            reached[name] = value
    return reached


def places_of(
    causes: Sequence[RankedCause], channel: str, regime: Reason, detail: Callable[[str], Reason]
) -> list[GapPlace]:
    """Return the places of named causes, each with its part of what all of them take."""
    total = sum(c.shrink or 0.0 for c in causes) or 1.0
    return [GapPlace(c.stage, channel, regime, (c.shrink or 0.0) / total, detail(c.effect)) for c in causes]


def beside_rest(places: Sequence[GapPlace], rest: GapPlace) -> list[GapPlace]:
    """Return the places of causes, scaled by what they take, with the place of a rest."""
    rest = replace(rest, detail=reason("gap.seen.rest", share=rest.share))
    return [*(replace(place, share=(1.0 - rest.share) * place.share) for place in places), rest]


def regime_places(stage: str, seen: Sequence[Regime], code: str) -> list[GapPlace]:
    """Return the first four regimes in which the gap stands out as places at a stage."""
    return [GapPlace(stage, r.channel, r.name, r.share, reason(code, share=r.share, lift=r.lift)) for r in seen[:4]]


def partial_of(search: "Search", judgement: "Judgement") -> Partial | None:
    """Return the set and its share of the gap where a rest is left; what comes nearest where no set stands."""
    if judgement.verdict not in ("unknown", "explained_in_part"):
        return None
    closest = judgement.best if judgement.best.ids else nearest(search)
    share = search.explained_share(closest)
    return Partial(closest.ids, share) if closest.ids and share > 0.0 else None


def nearest(search: "Search") -> Fit:
    """Return the simplest hypothesis that takes nearly the most of the gap away."""
    most = max(search.share(found) for found in search.fits.values())
    fits = list(search.fits.values())
    enough = most - fits[0].problem.method.verdict.near_share
    near = [found for found in fits if search.share(found) >= enough]
    return min(near, key=lambda found: (len(found.ids), found.chi2))


def ranked_causes(
    search: "Search",
    best: Fit,
    effects: Sequence[Effect],
    fits: tuple[Fit, ...],
    chances: dict[str, float],
    held_out: float,
) -> tuple[RankedCause, ...]:
    """Return every effect with how it stands, the likeliest first.

    Args:
        fits: where parameters are taken from, the first that has them; else from the effect alone.
        held_out: share of the gap that goes on samples held back, split among the best causes.
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
        found = next((f for f in fits if effect.id in f.ids), search.fits.get((effect.id,)))
        return RankedCause(
            effect.id,
            effect.stage,
            chances[effect.id],
            worth[effect.id] / total * held_out if effect.id in worth else None,
            estimates_of(found, effect.id) if found is not None else {},
            forms.get(effect.id, ""),
            alone=share_of(search.fits.get((effect.id,)), search.base),
            added=share_of(best, one_less.get(effect.id)),
        )

    return tuple(sorted(map(cause, effects), key=lambda c: (-c.probability, -(c.shrink or 0.0))))
