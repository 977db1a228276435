"""Is a cause there, and is the list complete: two numbers.

What a hypothesis leaves may be a rest that nothing in the list says. Then a cause of the list may only imitate a part
of that rest. A cause that is there takes most of what is left once all others are fitted, and has one size in every
part of every run, whatever the rest does. One that imitates takes a part, and asks for more here and less there.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from softcal.core.gap.fit import Fit
from softcal.core.gap.linear import combine, dots, energy
from softcal.core.gap.method import METHOD
from softcal.core.gap.residual import structure
from softcal.core.recording import Array

CONFIG = METHOD.presence


@dataclass(frozen=True)
class Consistency:
    """How a cause stands to the rest that its hypothesis leaves.

    Args:
        taken: share of the cause in the energy of cause and rest, of what no other fitted parameter imitates.
        disagreement: root mean square by which the parts of all runs ask for another size, relative to the fitted one.
    """

    taken: float
    disagreement: float

    @property
    def genuine_chance(self) -> float:
        """How likely a cause that stands so to a rest is there, and imitates nothing."""
        if self.taken >= 1.0:
            return 1.0
        if self.taken <= 0.0:
            return 0.0
        odds = float(np.log(self.taken / (1.0 - self.taken)))
        apart = float(np.log(max(self.disagreement, 1e-3) / CONFIG.disagreement))
        return float(expit(CONFIG.of_share * (odds - CONFIG.share_odds) - CONFIG.of_disagreement * apart))


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
    if noise_chance > METHOD.floor.chance:
        return 0.0
    count, left = found.problem.count, structure(found)
    # A noise level read off the residual itself holds a part of the rest: at least two standard errors of χ².
    least = 2.0 * float(np.sqrt(2.0 * count))
    return max(energy(found.residual) - count, left.rms**2 * count if left.is_significant else 0.0, least)


def consistency_of(found: Fit, effect_id: str, rest: float) -> Consistency:
    """Return how a cause of a fit stands to the rest that the fit leaves, in units of χ²."""
    seen = _visible_part(found, effect_id)
    whole = energy(seen)
    if whole <= 0.0:
        return Consistency(0.0, np.inf)
    asked = 0.0
    for block in found.problem.blocks:
        for part in np.array_split(np.arange(block.place.start, block.place.stop), CONFIG.parts):
            own = energy(seen[part])
            # A part where the cause does not act asks for nothing.
            if own > CONFIG.acts * whole:
                asked += float(seen[part] @ found.residual[part]) ** 2 / own
    return Consistency(whole / (whole + rest), float(np.sqrt(asked / whole)))


def _visible_part(found: Fit, effect_id: str) -> Array:
    """Return (samples,) what of an effect's signature no other fitted parameter imitates."""
    own, at = signature(found, effect_id), found.hypothesis.slices[effect_id]
    others = np.delete(found.jacobian, range(at.start, at.stop), axis=0)
    size = np.sqrt(np.sum(others**2, axis=1))
    others = others[size > 0.0] / size[size > 0.0][:, None]
    if not len(others):
        return own
    strength, axes = np.linalg.eigh(others @ others.T)
    kept = strength > 1e-10 * strength.max()
    basis = (axes[:, kept] / np.sqrt(strength[kept])).T @ others
    return np.asarray(own - combine(dots(basis, own), basis))


def list_completeness(noise_chance: float, rest_share: float, has_unlisted: bool) -> float:
    """Return how likely nothing unmodelled is left.

    Args:
        noise_chance: how likely noise alone leaves as much, a p-value.
        rest_share: share of the gap that is left beside the causes.
        has_unlisted: whether a departure outside the list explains more than the list does.
    """
    if has_unlisted:
        return CONFIG.unlisted
    # The most a p-value can say for a rest: Bayes factor −e·p·ln p (Sellke, Bayarri and Berger 2001).
    p = min(max(noise_chance, 1e-300), float(np.exp(-1.0)))
    odds = CONFIG.complete_odds * -float(np.e * p * np.log(p))
    by_noise = odds / (1.0 + odds)
    # Another law of the same cause leaves a small part of a large gap.
    by_share = 1.0 / (1.0 + (max(rest_share, 0.0) / CONFIG.half_share) ** 2)
    return max(by_noise, by_share * CONFIG.open_law)
