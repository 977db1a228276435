"""Split-conformal bounds over units: what a few audited units of a lot say about every other unit of it.

The only assumption is that audited and other units are exchangeable: the audited ones were drawn at random.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import betaincinv

from softcal.core.errors import InputError
from softcal.core.recording import Array


def least_risk(count: int) -> float:
    """Return the smallest risk for which `count` audited units give a finite bound: 1 / (k + 1)."""
    return 1 / (count + 1)


def least_units(risk: float) -> int:
    """Return how many audited units the smallest finite bound at a risk needs: 9 for 0.1, 19 for 0.05."""
    _check_share("risk", risk)
    return int(np.ceil(1 / risk - 1 - 1e-9))


def share_beyond(count: int, risk: float, confidence: float) -> float:
    """Return the share of all units beyond the conformal bound that is not exceeded with this confidence.

    The bound is the r-th smallest of k scores of audited units, r = ceil((1 - risk)(k + 1)): one more unit exceeds it
    with probability `risk` at most (Vovk, Gammerman and Shafer 2005; Lei et al. 2018), on average over audits that
    might have been drawn. For the audits that were drawn, the share beyond the r-th smallest of k is
    Beta(k - r + 1, r) for continuous scores (Wilks 1941); this is its quantile. 1 where k is too small for the risk.
    """
    _check_share("confidence", confidence)
    # A thousandth of a millionth: (1 - 0.1) * 10 must not be rounded up to 10.
    rank = max(int(np.ceil((1 - risk) * (count + 1) - 1e-9)), 1)
    return 1.0 if rank > count else float(betaincinv(count - rank + 1, rank, confidence))


def pooled_scale(groups: Sequence[Array], coverage: float, has_unseen: bool = False) -> float:
    """Return the factor on an interval's half-width by which it covers this share of the samples of one more unit.

    Every unit weighs the same, however long its recording. `has_unseen` gives the unit to come a weight of its own at
    infinity: the bound of hierarchical conformal prediction (Dunn, Wasserman and Ramdas 2023; Lee, Barber and Willett
    2023), which holds for any spread between units. Without it the coverage is that of the audited units: right on
    average as their number grows, and far narrower where they are few.

    Args:
        groups: per audited unit, (n,) |residual| over half-width of its samples.
        coverage: share of samples, between 0 and 1.
    """
    _check_share("coverage", coverage)
    if not groups:
        raise InputError("no audited unit: a scale for the intervals needs one at least")
    scores = np.concatenate(groups)
    # Weights by unit, not by sample: a long recording is no more evidence on other units than a short one.
    units = len(groups) + (1 if has_unseen else 0)
    weight = np.repeat([1 / (units * len(group)) for group in groups], [len(group) for group in groups])
    order = np.argsort(scores)
    # Cumulative sums round: without the margin an exact share would take one sample too many.
    reached = np.searchsorted(np.cumsum(weight[order]), coverage - 1e-12)
    return float("inf") if reached == len(order) else float(scores[order][reached])


def _check_share(name: str, value: float) -> None:
    if not 0 < value < 1:
        raise InputError(f"{name} {value:g}; a number between 0 and 1 was expected, such as 0.1")
