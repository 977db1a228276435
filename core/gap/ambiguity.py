"""What cannot be told apart on these runs: rivals, and what of an effect the base swallows."""

from collections.abc import Mapping

import numpy as np

from softcal.core.gap.fit import Fit
from softcal.core.gap.linear import energy
from softcal.core.gap.posterior import Fits, exact_log_evidence
from softcal.core.gap.residual import DIRTY_Z, structure
from softcal.core.gap.screen import Tangent
from softcal.core.recording import Array
from softcal.core.twin.catalogue import FORMS

RIVAL_LOG_ODDS = 5.0
"""A hypothesis within this log evidence of the best (ΔBIC < 10) is a rival: weak evidence."""

MOST_RIVALS = 3

MOST_CAUSES = 3
"""Causes that an honest set may hold, or one more than the best hypothesis has."""

ADDED_LOG_ODDS = 1.0
"""A cause more is a rival down to this log evidence behind the best hypothesis ..."""

EXACT_LOG_ODDS = 2.0
"""... and where this log evidence would be ahead of it if every equation held exactly: what it takes away is then that
cause or what the equation of another one leaves, and these runs cannot tell which."""

NEGLIGIBLE_LOG_ODDS = 15.0
"""So far behind the best hypothesis a cause more is ruled out, even if every equation held."""

STRUCTURE_LEFT = 0.25
"""Share of the structure left beside which a cause more mops up what another equation explains."""


def rivals(
    fits: Fits, best: Fit, logs: Mapping[tuple[str, ...], float], held_open: tuple[Fit, ...] = ()
) -> tuple[Fit, ...]:
    """Return the best hypothesis and those the evidence cannot rule out.

    One that merely adds a cause to another counts only where the evidence for that cause is neither negligible nor
    decisive.

    Args:
        held_open: larger hypotheses that are in play whatever their evidence.
    """
    if not best.hypothesis.ids:
        return (best,)
    top = logs[best.hypothesis.ids]
    near = [fits[ids] for ids in sorted(logs, key=lambda i: -logs[i]) if logs[ids] > top - RIVAL_LOG_ODDS]
    kept: list[Fit] = [best, *held_open]
    for found in near:
        ids = set(found.hypothesis.ids)
        # A larger set of causes holds the evidence of the smaller one: as its rival it says nothing new.
        if ids and not any(ids >= set(other.hypothesis.ids) for other in kept):
            kept.append(found)
    most = max(MOST_CAUSES, len(best.hypothesis.ids) + 1)
    for found in _open_additions(fits, best, logs):
        if any(found.hypothesis.ids == other.hypothesis.ids for other in kept):
            continue
        if len({*found.hypothesis.ids}.union(*(other.hypothesis.ids for other in kept))) <= most:
            kept.append(found)
    return tuple(kept[:MOST_RIVALS])


def _open_additions(fits: Fits, best: Fit, logs: Mapping[tuple[str, ...], float]) -> list[Fit]:
    """Return hypotheses with one cause more that can be neither named nor left out."""
    ids = set(best.hypothesis.ids)
    larger = [found for other, found in fits.items() if set(other) > ids and len(other) == len(ids) + 1]
    ahead = [exact_log_evidence(found) - exact_log_evidence(best) for found in larger]
    behind = [logs[best.hypothesis.ids] - logs[found.hypothesis.ids] for found in larger]
    least = max(ahead, default=0.0) - RIVAL_LOG_ODDS
    # Another realisation of one cause may be two causes in the catalogue's equations: a joint is a frame with a toe.
    is_in_other_form = any(form.effect is e for e in best.hypothesis.effects for form in FORMS.get(e.id, ()))
    within = RIVAL_LOG_ODDS if is_in_other_form else ADDED_LOG_ODDS
    most_z = max(DIRTY_Z, STRUCTURE_LEFT * structure(best).z)
    is_open = [
        a >= least and (b < within or (b < NEGLIGIBLE_LOG_ODDS and a > EXACT_LOG_ODDS)) and structure(found).z < most_z
        for found, a, b in zip(larger, ahead, behind, strict=True)
    ]
    order = sorted(np.flatnonzero(is_open), key=lambda k: -ahead[k])
    return [larger[k] for k in order]


def confused_pairs(group: tuple[Fit, ...]) -> list[list[str]]:
    """Return the pairs of effects that stand for each other in rival hypotheses.

    A cause that one rival has beside those of another stands for what the equation of the largest of those leaves.
    """
    best = set(group[0].hypothesis.ids)
    pairs: list[list[str]] = []
    for other in group[1:]:
        mine = sorted(best - set(other.hypothesis.ids))
        theirs = sorted(set(other.hypothesis.ids) - best)
        shared = sorted(best & set(other.hypothesis.ids), key=lambda i: -energy(_signature(group[0], i)))
        between = [[a, b] for a in mine for b in theirs] or [[shared[0], extra] for extra in (*mine, *theirs)]
        pairs += [pair for pair in between if pair not in pairs]
    return pairs


def hidden_fraction(found: Fit, effect_id: str) -> float:
    """Return which share of an effect's signature, at the fitted size, the refitted base would swallow on these runs.

    The signature is the change of the prediction when the effect is switched off; the rest of the hypothesis stays.
    """
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
