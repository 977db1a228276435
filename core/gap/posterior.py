"""How probable each effect is, by equations that may be a little wrong; what cannot be told apart."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.coordinates import fit_scale
from softcal.core.gap.fit import Fit
from softcal.core.gap.linear import energy
from softcal.core.gap.method import METHOD
from softcal.core.gap.residual import structure
from softcal.core.gap.screen import Tangent
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS, FORMS

EVIDENCE, RIVAL = METHOD.evidence, METHOD.rival

Fits = Mapping[tuple[str, ...], Fit]


def misfit(excess: float) -> float:
    """Return −2·ln of the likelihood of an excess of χ² when every equation may be a little wrong.

    The difference between equation and rig is `modes` normal coordinates of unknown common size, at the
    size that fits best. A large excess counts by its logarithm: by which factor a hypothesis lowers
    what the others leave, not how many σ that is.
    """
    modes = EVIDENCE.modes
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
        closest = min(every, key=lambda f: f.chi2)
        left, gap = structure(closest), max(f.chi2 for f in every) - closest.chi2
        seen = left.rms**2 * closest.problem.count if left.is_significant else 0.0
        driven = EVIDENCE.driven_cost if closest.problem.is_driven_by_force else 0.0
        return cls(closest.chi2, max(seen, EVIDENCE.exactness * gap, driven))

    def log_evidence(self, found: Fit) -> float:
        """Return the logarithm of prior times evidence of a hypothesis."""
        return -0.5 * (misfit(max(found.chi2 - self.chi2, 0.0) + self.floor) + penalty(found))


def exact_log_evidence(found: Fit) -> float:
    """Return the logarithm of prior times evidence of a hypothesis whose equations hold exactly."""
    return -0.5 * (found.chi2 + penalty(found))


def penalty(found: Fit) -> float:
    """Return the penalty where a loose lead is one cause, however often it gaps.

    Each episode was paid for in full when it was placed. A size that these runs hardly determine pays
    less than Schwarz's ln n: −2·ln of posterior over prior (Laplace). An unusual size is less likely.
    """
    problem, most = found.problem, float(np.log(found.problem.count))
    more = max(found.hypothesis.episode_count - 1, 0)
    cheaper = more * (EVIDENCE.episode_cost - EVIDENCE.further_episode_cost) * most
    if problem.is_driven_by_force:
        # What its noise feigns is in the floor already.
        cheaper += EVIDENCE.driven_cost * len(found.ids)
    spared, unusual, on_bound = 0.0, 0.0, 0
    for effect, values in zip(found.effects, found.effect_values, strict=True):
        size, at = problem.scale.sized(effect.parameters[0]), found.hypothesis.place_of(effect.id)
        ends = [end for end in (size.low, size.high) if end not in (0.0, size.neutral)]
        on_bound += size.scale == "linear" and any(abs(values[0] - end) < 0.01 * abs(end) for end in ends)
        variance = 0.0 if problem.is_driven_by_force else float(found.covariance[at, at])
        if variance > 0.0 and not effect.is_episodic:
            width = EVIDENCE.usual_range * fit_scale(size) / np.sqrt(2.0 * np.pi * variance)
            spared += size.weight * max(0.0, most - 2.0 * float(np.log(max(width, 1.0))))
        if size.neutral == 0.0:
            # Of two sets that these runs cannot tell apart the one of usual sizes is likelier: Cauchy's prior.
            unusual += 2.0 * float(np.log1p((values[0] / (EVIDENCE.usual_range * size.usual)) ** 2))
    return found.penalty - (cheaper + spared) + unusual + EVIDENCE.bound_cost * on_bound


def log_evidences(fits: Fits) -> dict[tuple[str, ...], float]:
    """Return the log of prior times evidence of every hypothesis, all under one noise level."""
    yardstick = Yardstick.of(fits.values())
    return {ids: yardstick.log_evidence(found) for ids, found in fits.items()}


def probabilities(logs: Mapping[tuple[str, ...], float], effects: Iterable[str] = tuple(EFFECTS)) -> dict[str, float]:
    """Return for every effect the probability that it is present, from log evidences.

    Effects that were screened away have no hypothesis and get 0; the numbers need not sum to 1.
    """
    top = max(logs.values())
    weights = {ids: float(np.exp(value - top)) for ids, value in logs.items()}
    total = sum(weights.values())
    return {e: sum(w for ids, w in weights.items() if e in ids) / total for e in effects}


def rivals(
    fits: Fits, best: Fit, logs: Mapping[tuple[str, ...], float], held_open: tuple[Fit, ...] = ()
) -> tuple[Fit, ...]:
    """Return the best hypothesis, those held open, and those the evidence cannot rule out.

    One that adds a cause counts where the evidence for that is neither negligible nor decisive.
    """
    if not best.ids:
        return (best,)
    top = logs[best.ids]
    near = [fits[ids] for ids in sorted(logs, key=lambda i: -logs[i]) if logs[ids] > top - RIVAL.odds]
    in_play: list[Fit] = [best, *held_open]
    for found in near:
        ids = set(found.ids)
        # A larger set of causes holds the evidence of the smaller one and says nothing new.
        if ids and not any(ids >= set(other.ids) for other in in_play):
            in_play.append(found)
    most = max(RIVAL.most_causes, len(best.ids) + 1)
    # Hypotheses with one cause more that can be neither named nor left out.
    best_ids = set(best.ids)
    larger = [f for ids, f in fits.items() if set(ids) > best_ids and len(ids) == len(best_ids) + 1]
    ahead = {f.ids: exact_log_evidence(f) - exact_log_evidence(best) for f in larger}
    least = max(ahead.values(), default=0.0) - RIVAL.odds
    # Another form of one cause may be two in the catalogue's equations: a joint is frame and toe.
    is_in_other_form = any(form.effect is e for e in best.effects for form in FORMS.get(e.id, ()))
    within = RIVAL.odds if is_in_other_form else RIVAL.added
    most_z = max(METHOD.structure.dirty_z, RIVAL.structure_left * structure(best).z)
    for found in sorted(larger, key=lambda f: -ahead[f.ids]):
        gain, behind = ahead[found.ids], top - logs[found.ids]
        is_near = behind < within or (behind < RIVAL.negligible and gain > RIVAL.exact)
        if gain < least or not is_near or structure(found).z >= most_z or any(found.ids == f.ids for f in in_play):
            continue
        if len({*found.ids}.union(*(other.ids for other in in_play))) <= most:
            in_play.append(found)
    return tuple(in_play[: RIVAL.most])


def confused_pairs(group: tuple[Fit, ...]) -> list[list[str]]:
    """Return the pairs of effects that stand for each other in rival hypotheses.

    A cause beside another rival's stands for what the equation of the largest of those leaves.
    """
    best = set(group[0].ids)
    pairs: list[list[str]] = []
    for other in group[1:]:
        mine = sorted(best - set(other.ids))
        theirs = sorted(set(other.ids) - best)
        shared = sorted(best & set(other.ids), key=lambda i: -energy(_signature(group[0], i)))
        between = [[a, b] for a in mine for b in theirs] or [[shared[0], extra] for extra in (*mine, *theirs)]
        pairs += [pair for pair in between if pair not in pairs]
    return pairs


def hidden_fraction(found: Fit, effect_id: str) -> float:
    """Return which share of an effect's signature, at its size, the refitted base would swallow."""
    signature = _signature(found, effect_id)
    size = energy(signature)
    if size <= 0.0:
        return 1.0
    # To first order: a full refit for each effect would take as long as the diagnosis.
    seen = Tangent(found, base_only=True).visible(signature)
    return float(np.clip(1.0 - energy(seen) / size, 0.0, 1.0))


def _signature(found: Fit, effect_id: str) -> Array:
    """(samples,) change of the whitened prediction when an effect of a fit is switched off."""
    smaller, left = found.hypothesis.without(effect_id)
    without = found.problem.predict(smaller, found.coordinates[left])
    return found.problem.whitened(found.predicted - without)
