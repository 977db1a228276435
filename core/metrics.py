"""Error figures of an estimate beside its reference, and the interval of a share."""

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


def wilson(count: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share after Wilson (1927); from 0 to 1 without a case."""
    # Who needs an error figure alone does not wait for scipy.stats.
    if not of:
        return 0.0, 1.0
    interval = scipy.stats.binomtest(count, of).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)
