"""What cannot be told apart on these runs: rival hypotheses, and the share of an effect that the base swallows."""

from collections.abc import Mapping

import numpy as np

from softcal.core.gap.fit import BASE, Fit, Hypothesis
from softcal.core.gap.linear import energy
from softcal.core.gap.posterior import log_evidence
from softcal.core.gap.screen import Tangent

RIVAL_LOG_ODDS = 5.0
"""A hypothesis within this log evidence of the best (ΔBIC < 10) is a rival: weak to positive evidence only."""

MOST_RIVALS = 3


def rivals(fits: Mapping[tuple[str, ...], Fit], best: Fit, dispersion: float) -> tuple[Fit, ...]:
    """Return the best hypothesis and those the evidence cannot rule out, without those that merely add to another."""
    logs = {ids: log_evidence(found, dispersion) for ids, found in fits.items()}
    top = logs[best.hypothesis.ids]
    near = [fits[ids] for ids in sorted(logs, key=lambda i: -logs[i]) if logs[ids] > top - RIVAL_LOG_ODDS]
    kept: list[Fit] = [best]
    for found in near:
        ids = set(found.hypothesis.ids)
        if (
            found.hypothesis.ids == best.hypothesis.ids
            or not ids
            or any(ids > set(other.hypothesis.ids) for other in kept)
        ):
            continue
        kept.append(found)
    return tuple(kept[:MOST_RIVALS])


def confused_pairs(group: tuple[Fit, ...]) -> list[list[str]]:
    """Return the pairs of effects that stand for each other in rival hypotheses."""
    best = set(group[0].hypothesis.ids)
    pairs = []
    for other in group[1:]:
        mine = sorted(best - set(other.hypothesis.ids))
        theirs = sorted(set(other.hypothesis.ids) - best)
        pairs += [[a, b] for a in mine for b in theirs if [a, b] not in pairs]
    return pairs


def hidden_fraction(found: Fit, effect_id: str) -> float:
    """Return which share of an effect's signature, at the fitted size, the refitted base would swallow on these runs.

    The signature is the change of the prediction when the effect is switched off; the rest of the hypothesis stays.
    """
    hypothesis = found.hypothesis
    coordinates, at = found.coordinates, len(BASE)
    kept, effects = list(range(at)), []
    for effect in hypothesis.effects:
        width = len(effect.parameters)
        if effect.id != effect_id:
            kept += range(at, at + width)
            effects.append(effect)
        at += width
    smaller = Hypothesis(tuple(effects), hypothesis.episodes)
    without = found.problem.predict(smaller, coordinates[kept])
    signature = (found.predicted - without) * found.problem.weights
    size = energy(signature)
    if size <= 0.0:
        return 1.0
    seen = Tangent(found, base_only=True).visible(signature)
    return float(np.clip(1.0 - energy(seen) / size, 0.0, 1.0))
