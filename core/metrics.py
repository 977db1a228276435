"""Error figures of an estimate beside its reference."""

from dataclasses import dataclass

import numpy as np

from softcal.core.recording import Array


def rmse(estimate: Array, reference: Array) -> float:
    """Return the root mean square error over rows where both are finite; NaN where there is none.

    Args:
        estimate: (n,) in the reference unit; NaN during warm-up.
        reference: (n,) in the same unit.
    """
    error = (estimate - reference)[np.isfinite(estimate) & np.isfinite(reference)]
    return float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")


def nrmse(estimate: Array, reference: Array) -> float:
    """Return the RMSE over the range of the reference (1 = the full scale seen)."""
    return rmse(estimate, reference) / float(np.ptp(reference))


def r_squared(estimate: Array, reference: Array) -> float:
    """Return the share of the reference's variance that the estimate explains."""
    return 1.0 - rmse(estimate, reference) ** 2 / float(np.var(reference))


def hysteresis_pct_fs(output: Array, reference: Array, bins: int = 20) -> float:
    """Return the largest gap between loading and unloading at equal reference, in % of the output's range.

    Args:
        output: (n,) sensor output in time order.
        reference: (n,) reference beside it.
        bins: levels of the reference at which the branches are compared.
    """
    slope = np.gradient(reference)
    edges = np.linspace(reference.min(), reference.max(), bins + 1)
    level = np.clip(np.digitize(reference, edges) - 1, 0, bins - 1)
    gaps = [0.0]
    for k in range(bins):
        up, down = output[(level == k) & (slope > 0)], output[(level == k) & (slope < 0)]
        if len(up) and len(down):
            gaps.append(abs(float(up.mean()) - float(down.mean())))
    return 100.0 * max(gaps) / float(np.ptp(output))


@dataclass(frozen=True)
class ScoreRow:
    """One unit's errors as in the paper's Table 1, in the reference unit.

    Args:
        before: f on the raw unit.
        after: f on the mapped unit.
        own: a network trained on the unit's own labels.
    """

    before: float
    after: float
    own: float

    @property
    def after_over_own(self) -> float:
        return self.after / self.own

    @property
    def before_over_own(self) -> float:
        return self.before / self.own
