"""Acceptance sampling of a lot: what so many audited units with so many failures say, and how many audits that takes.

By attributes after ISO 2859-2 and by variables after ISO 3951-2, restated as bounds on the share of failing units.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import betaincinv, nctdtrit, ndtri

from softcal.core.errors import InputError
from softcal.core.unit.method import ReleaseConfig


@dataclass(frozen=True)
class Promise:
    """What is promised about the released units of a lot.

    Args:
        risk: largest share of released units beyond the limit.
        confidence: probability that lots released by the rule keep to it.

    Raises:
        InputError: one of them is no share.
    """

    risk: float = ReleaseConfig.risk
    confidence: float = ReleaseConfig.confidence

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 < value < 1:
                raise InputError(f"{name} {value:g}; a number between 0 and 1 was expected, such as 0.1 for 1 in 10")


def failing_share(checked: int, failed: int, confidence: float) -> float:
    """Return the one-sided upper bound of the failing share of a process (Clopper and Pearson 1934)."""
    # All that were checked have failed: the quantile is not defined there, and 1 is its limit.
    return 1.0 if failed >= checked else float(betaincinv(failed + 1, checked - failed, confidence))


def audits_by_count(promise: Promise, failed: int = 0) -> int:
    """Return how many audits with so many failures show the promise by counting alone: 22 for 0.1, 0.9 and none."""
    checked = failed + 1
    while failing_share(checked, failed, promise.confidence) > promise.risk:
        checked += 1
    return checked


@cache
def tolerance_factor(count: float, degrees: float, promise: Promise) -> float:
    """Return k: mean + k * SD lies above all but the share `risk` of a normal quantity, with this confidence.

    k = t'(confidence; degrees, z sqrt(n)) / sqrt(n), t' the noncentral t and z the normal quantile of 1 - risk
    (ISO 16269-6; the acceptability constant of ISO 3951 for a given consumer's risk).

    Args:
        count: number of observations behind the mean.
        degrees: degrees of freedom behind the SD; count - 1 where both come from one sample.
    """
    if count < 1 or degrees < 1:
        return float("inf")
    shift = ndtri(1 - promise.risk) * np.sqrt(count)
    return float(nctdtrit(degrees, shift, promise.confidence) / np.sqrt(count))
