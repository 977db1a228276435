"""How probable each effect is: evidence of all fitted hypotheses, tempered by the structure the best one leaves."""

from collections.abc import Mapping

import numpy as np

from softcal.core.gap.fit import Fit
from softcal.core.gap.residual import structure
from softcal.core.twin.catalogue import EFFECTS


def overdispersion(best: Fit) -> float:
    """Return by how much the squared residual of the best hypothesis is inflated, at least 1.

    What is left and correlated counts as noise of its own when hypotheses are compared: a difference of χ² is worth
    1/overdispersion of what it would be in white noise.
    """
    left = structure(best)
    return float(max(1.0, 1.0 + 8.0 * left.rms**2)) if left.is_significant else 1.0


def log_evidence(found: Fit, dispersion: float) -> float:
    """Return the logarithm of prior times evidence of a hypothesis, by Schwarz's criterion."""
    return -0.5 * (found.chi2 / dispersion + found.penalty)


def probabilities(fits: Mapping[tuple[str, ...], Fit], dispersion: float) -> dict[str, float]:
    """Return for every effect of the catalogue the probability that it is present.

    Effects that were screened away have no hypothesis of their own and get 0; the numbers need not sum to 1.
    """
    logs = {ids: log_evidence(found, dispersion) for ids, found in fits.items()}
    top = max(logs.values())
    weights = {ids: float(np.exp(value - top)) for ids, value in logs.items()}
    total = sum(weights.values())
    return {e: sum(w for ids, w in weights.items() if e in ids) / total for e in EFFECTS}
