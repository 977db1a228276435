"""Error figures of an estimate beside its reference, and the interval of a share."""

from collections.abc import Sequence

import numpy as np
import scipy

from softcal.core.recording import Array


def finite_or_none(value: float) -> float | None:
    """Return a number, or None where JSON has no word for it (NaN, infinity)."""
    return value if np.isfinite(value) else None


def rms(values: Array) -> float:
    """Return the root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0


def rmse(estimate: Array, reference: Array) -> float:
    """Return the root mean square error over rows where both are finite; NaN without any."""
    error = (estimate - reference)[np.isfinite(estimate) & np.isfinite(reference)]
    return float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")


def quantile(values: Array, shares: float | Sequence[float] | Array) -> Array:
    """Return `np.quantile` of (n,) values to the last digit, n > 0: a unit asks for fifty, and most have few values."""
    ordered, position = np.sort(values), (len(values) - 1) * np.asarray(shares)
    below = position.astype(np.intp)
    low, high, part = ordered[below], ordered[np.minimum(below + 1, len(values) - 1)], position - below
    step = high - low
    between = np.where(part < 0.5, low + step * part, high - step * (1.0 - part))
    # Sorted, NaN is last.
    return between if ordered[-1] == ordered[-1] else np.full_like(between, np.nan)


def wilson(count: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share after Wilson (1927); from 0 to 1 without a case."""
    # Who needs an error figure alone does not wait for scipy.stats.
    if not of:
        return 0.0, 1.0
    interval = scipy.stats.binomtest(count, of).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)
