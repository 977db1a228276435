"""How audited units widen the 90 % intervals of the others: a factor on what was forecast, and an error beside it.

The factor alone would be a poor answer where units were pressed with different forces: an interval wide enough for nine
units in ten is then several times what most of them need at high loads, and still too narrow at low ones.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy.special import stdtrit

from softcal.core.errors import InputError
from softcal.core.quality.acceptance import pooled_scale
from softcal.core.recording import Array
from softcal.core.unit.method import ReleaseConfig
from softcal.core.unit.uncertainty import IntervalInflation

CLOSE = 1e-3
"""The added error is found to this share of itself."""


@dataclass(frozen=True, eq=False)
class AuditedSamples:
    """|residual| and half-width of the 90 % interval, as it was forecast, at (n,) samples of an audit."""

    residual: Array
    half: Array

    def ratio(self, inflation: IntervalInflation) -> Array:
        """Return |residual| over the half-width, widened: (n,)."""
        return np.asarray(self.residual / np.maximum(inflation(self.half), 1e-12))


def fit_interval_inflation(
    audits: Iterable[AuditedSamples], coverage: float, config: ReleaseConfig
) -> IntervalInflation:
    """Return the inflation that serves the samples on average and the units one by one.

    The factor is what the median unit asks for where that is less than 1. The added error is the smallest that
    does two things. It covers the audited units' samples to `coverage`, each unit weighing the same: the pooled version
    of hierarchical conformal prediction (Dunn, Wasserman and Ramdas 2023; Lee, Barber and Willett 2023). And one more
    unit has `min_coverage` of its samples covered, all but a share `risk` of the times. That is the
    prediction limit of the logarithm of the units' own factors (Student's t; Hahn 1970).

    Args:
        audits: one a unit; the first `max_audits` of them are read.

    Raises:
        InputError: there is no audited unit.
    """
    units = list(islice(audits, config.max_audits))
    if not units:
        raise InputError("no audited unit: to widen intervals takes one at least")
    median = float(np.median([np.quantile(unit.ratio(IntervalInflation()), coverage) for unit in units]))
    scale, step = min(1.0, median), max(float(np.median(unit.residual)) for unit in units) or CLOSE
    if _required_factor(units, IntervalInflation(scale), coverage, config) <= 1:
        return IntervalInflation(scale)
    low, high = 0.0, step
    while _required_factor(units, IntervalInflation(scale, high), coverage, config) > 1:
        low, high = high, 2 * high
    while high - low > CLOSE * high:
        middle = (low + high) / 2
        is_enough = _required_factor(units, IntervalInflation(scale, middle), coverage, config) <= 1
        low, high = (low, middle) if is_enough else (middle, high)
    return IntervalInflation(scale, high)


def _required_factor(
    units: Sequence[AuditedSamples], inflation: IntervalInflation, coverage: float, config: ReleaseConfig
) -> float:
    """Return the factor that the widened intervals would still need."""
    ratios = [unit.ratio(inflation) for unit in units]
    unit_factors = np.log([max(float(np.quantile(ratio, config.min_coverage)), 1e-12) for ratio in ratios])
    return max(pooled_scale(ratios, coverage), float(np.exp(_next_unit(unit_factors, config.risk))))


def _next_unit(values: Array, risk: float) -> float:
    """Return what one more value exceeds with probability `risk` where they are normal; of one, itself."""
    count = len(values)
    if count < 2:
        return float(values[0])
    spread = float(np.std(values, ddof=1)) * np.sqrt(1 + 1 / count)
    return float(values.mean() + stdtrit(count - 1, 1 - risk) * spread)
