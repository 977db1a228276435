"""What a few audited units of a lot say about every other unit of it, and how many audits that takes.

Acceptance sampling by attributes after ISO 2859-2 and by variables after ISO 3951-2, restated as bounds on the share of
failing units; and split-conformal bounds, which only assume that the audited ones were drawn at random.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.special import betaincinv, nctdtrit, ndtri

from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.unit.method import ReleaseConfig


def failing_share(checked: int, failed: int, confidence: float) -> float:
    """Return the one-sided upper bound of the failing share of a process (Clopper and Pearson 1934)."""
    # All that were checked have failed: the quantile is not defined there, and 1 is its limit.
    return 1.0 if failed >= checked else float(betaincinv(failed + 1, checked - failed, confidence))


def audits_by_count(risk: float, confidence: float, failed: int = 0) -> int:
    """Return how many audits with so many failures show a risk by counting alone: 22 for 0.1, 0.9 and none."""
    _check_share("risk", risk)
    _check_share("confidence", confidence)
    checked = failed + 1
    while failing_share(checked, failed, confidence) > risk:
        checked += 1
    return checked


@cache
def tolerance_factor(count: float, degrees: float, risk: float, confidence: float) -> float:
    """Return k: mean + k * SD lies above all but the share `risk` of a normal quantity, with this confidence.

    k = t'(confidence; degrees, z sqrt(n)) / sqrt(n), t' the noncentral t and z the normal quantile of 1 - risk
    (ISO 16269-6; the acceptability constant of ISO 3951 for a given consumer's risk).

    Args:
        count: number of observations behind the mean.
        degrees: degrees of freedom behind the SD; count - 1 where both come from one sample.
    """
    _check_share("risk", risk)
    _check_share("confidence", confidence)
    if count < 1 or degrees < 1:
        return float("inf")
    shift = ndtri(1 - risk) * np.sqrt(count)
    return float(nctdtrit(degrees, shift, confidence) / np.sqrt(count))


def min_risk(count: int) -> float:
    """Return the smallest risk for which `count` audited units give a finite bound: 1 / (k + 1)."""
    return 1 / (count + 1)


def min_units(risk: float) -> int:
    """Return how many audited units the smallest finite bound at a risk needs: 9 for 0.1, 19 for 0.05."""
    _check_share("risk", risk)
    return int(np.ceil(1 / risk - 1 - 1e-9))


def share_beyond(count: int, risk: float, confidence: float) -> float:
    """Return the share of all units beyond the conformal bound that is not exceeded with this confidence.

    The bound is the r-th smallest of k scores of audited units, r = ceil((1 - risk)(k + 1)): one more unit exceeds it
    with probability `risk` at most (Vovk, Gammerman and Shafer 2005; Lei et al. 2018), on average over audits that
    might have been drawn. For the audits that were drawn, the share beyond the r-th smallest of k is
    Beta(k - r + 1, r) for continuous scores (Wilks 1941). This is its quantile. 1 where k is too small for the risk.
    """
    _check_share("confidence", confidence)
    # A thousandth of a millionth: (1 - 0.1) * 10 must not be rounded up to 10.
    rank = max(int(np.ceil((1 - risk) * (count + 1) - 1e-9)), 1)
    return 1.0 if rank > count else float(betaincinv(count - rank + 1, rank, confidence))


def pooled_scale(groups: Sequence[Array], coverage: float, has_new_unit: bool = False) -> float:
    """Return the factor on an interval's half-width by which it covers this share of the samples of one more unit.

    Every unit weighs the same, however long its recording. `has_new_unit` gives the unit to come a weight of its own at
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
    units = len(groups) + (1 if has_new_unit else 0)
    weight = np.repeat([1 / (units * len(group)) for group in groups], [len(group) for group in groups])
    order = np.argsort(scores)
    # Cumulative sums round: without the margin an exact share would take one sample too many.
    index = np.searchsorted(np.cumsum(weight[order]), coverage - 1e-12)
    return float("inf") if index == len(order) else float(scores[order][index])


def _check_share(name: str, value: float) -> None:
    if not 0 < value < 1:
        raise InputError(f"{name} {value:g}; a number between 0 and 1 was expected, such as 0.1")


CRITERION_HEADER = ("if all hold", "beyond, on average", "beyond, at 90 %", "margin needed", "promise of 1 in 10")


def criterion_rows(config: ReleaseConfig, units: int | None = None) -> list[list[object]]:
    """Return one row per number of audits that leaves a unit over, none beyond the limit, under `CRITERION_HEADER`.

    The average and the share at a confidence hold for errors of any form. The margin is by how many standard deviations
    of the log ratio the mean must stay below the limit for the promise by variables (ISO 3951).
    """
    risk, confidence = config.risk, config.confidence
    counts = sorted({3, config.min_audits, min_units(risk), 10, 20, audits_by_count(risk, confidence)})
    rows: list[list[object]] = []
    for count in (count for count in counts if units is None or count < units):
        margin, share = tolerance_factor(count, count - 1, risk, confidence), failing_share(count, 0, confidence)
        by_margin = "by margin" if count >= min_units(risk) else "none"
        word = "by counting alone" if share <= risk else by_margin
        rows.append([f"{count} audits", f"{min_risk(count):.1%}", f"{share:.1%}", f"{margin:.2f} SD", word])
    return rows
