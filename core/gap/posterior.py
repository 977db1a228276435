"""How probable each effect is, by hypotheses that are not trusted to the last sigma."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.coordinates import fit_scale
from softcal.core.gap.fit import DRIVEN_COST, EPISODE_COST, Fit
from softcal.core.gap.residual import structure
from softcal.core.twin.catalogue import EFFECTS

Fits = Mapping[tuple[str, ...], Fit]

DISCREPANCY_MODES = 20.0
"""Degrees of freedom of the smooth difference between a catalogue equation and what a rig does."""


FURTHER_EPISODE_COST = 0.2
"""Parameters that an episode after the first counts as when causes are compared."""

BOUND_COST = 60.0
"""What a cause pays whose size ends on its bound: it stands for something else."""

EXACTNESS = 5e-5
"""Share of the gap's energy below which no equation is believed: 0.7 % of its amplitude."""

USUAL_RANGE = 3.0
"""Sizes that a rig may show, in usual ones: the width of the prior of a size."""


def misfit(excess: float) -> float:
    """Return −2·ln of the likelihood of an excess of χ² when every equation may be a little wrong.

    The difference between equation and rig is taken as `DISCREPANCY_MODES` normal coordinates of unknown common size,
    at the size that fits best. An excess below counts as in white noise, one above it by its logarithm: by which factor
    a hypothesis lowers what the others leave, not how many σ that is.
    """
    modes = DISCREPANCY_MODES
    return excess if excess < modes else modes * (1.0 + float(np.log(excess / modes)))


@dataclass(frozen=True)
class Yardstick:
    """What hypotheses of one case are measured by.

    Args:
        chi2: of the hypothesis that comes closest to the recordings.
        floor: χ² of the structure that even this one leaves, or must be allowed to leave.
    """

    chi2: float
    floor: float

    @classmethod
    def of(cls, fits: Iterable[Fit]) -> "Yardstick":
        """Take the measure from fits under one noise level."""
        every = list(fits)
        closest = min(every, key=lambda f: f.chi2)
        left, gap = structure(closest), max(f.chi2 for f in every) - closest.chi2
        seen = left.rms**2 * closest.problem.count if left.is_significant else 0.0
        driven = DRIVEN_COST if closest.problem.is_driven_by_force else 0.0
        return cls(closest.chi2, max(seen, EXACTNESS * gap, driven))

    def log_evidence(self, found: Fit) -> float:
        """Return the logarithm of prior times evidence of a hypothesis."""
        return -0.5 * (misfit(max(found.chi2 - self.chi2, 0.0) + self.floor) + penalty(found))


def exact_log_evidence(found: Fit) -> float:
    """Return the logarithm of prior times evidence of a hypothesis whose equations hold exactly."""
    return -0.5 * (found.chi2 + penalty(found))


def penalty(found: Fit) -> float:
    """Return the penalty with episodes after the first at a fraction: a loose lead is one cause, however often it gaps.

    Each episode was paid for in full when it was placed. A size that these runs hardly determine pays less than
    Schwarz's ln n, which takes it that every sample tells of it.
    """
    more = max(found.hypothesis.episode_count - 1, 0)
    cheaper = more * (EPISODE_COST - FURTHER_EPISODE_COST) * float(np.log(found.problem.count))
    if found.problem.is_driven_by_force:
        # What its noise feigns is in the floor already.
        cheaper += DRIVEN_COST * len(found.hypothesis.ids)
    else:
        cheaper += _spared(found)
    return found.penalty - cheaper + BOUND_COST * sizes_on_bound(found)


def _spared(found: Fit) -> float:
    """What sizes pay less than Schwarz's ln n: −2·ln of posterior over prior (Laplace)."""
    spared, most = 0.0, float(np.log(found.problem.count))
    for effect in found.hypothesis.effects:
        at = found.hypothesis.place_of(effect.id)
        size, variance = found.problem.scale.sized(effect.parameters[0]), float(found.covariance[at, at])
        if variance > 0.0 and not effect.is_episodic:
            width = USUAL_RANGE * fit_scale(size) / np.sqrt(2.0 * np.pi * variance)
            spared += size.weight * max(0.0, most - 2.0 * float(np.log(max(width, 1.0))))
    return spared


def sizes_on_bound(found: Fit) -> int:
    """Return how many causes have ended at the largest size that a rig can show."""
    rows = zip(found.hypothesis.effects, found.effect_values, strict=True)
    sizes = [(found.problem.scale.sized(effect.parameters[0]), values[0]) for effect, values in rows]
    return sum(
        size.scale == "linear"
        and any(abs(value - end) < 0.01 * abs(end) for end in (size.low, size.high) if end not in (0.0, size.neutral))
        for size, value in sizes
    )


def log_evidences(fits: Fits) -> dict[tuple[str, ...], float]:
    """Return the log of prior times evidence of every hypothesis, all under one noise level."""
    yardstick = Yardstick.of(fits.values())
    return {ids: yardstick.log_evidence(found) for ids, found in fits.items()}


def probabilities(logs: Mapping[tuple[str, ...], float], effects: Iterable[str] = tuple(EFFECTS)) -> dict[str, float]:
    """Return for every effect, of the catalogue where nothing else is said, the probability that it is present.

    Effects that were screened away have no hypothesis of their own and get 0; the numbers need not sum to 1.

    Args:
        logs: logarithm of prior times evidence by hypothesis.
    """
    top = max(logs.values())
    weights = {ids: float(np.exp(value - top)) for ids, value in logs.items()}
    total = sum(weights.values())
    return {e: sum(w for ids, w in weights.items() if e in ids) / total for e in effects}
