"""How wrong the estimates of a unit in use may be: for its interval, its predicted error and its state.

All numbers are standard deviations or their squares in scales of the calibrated use, and independent: squares add up.
What may be use as well as drift is no alarm: nothing of it is applied, and the state of the rows says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.operation.method import UncertaintyConfig
from softcal.core.recording import Array

UNCOMPARED = "much of the use could not be compared with any that is known"
MOVED_WHILE_LEARNT = "the use moved while it was learnt: sensor or use"
REST_ELSEWHERE = "a new use rests where none that is known does: sensor or use"
OPEN = "a drift is seen that is not followed, for a change of use would look the same"
JUMP = "a sudden change is not explained"
QUEUE = "a queue was mapped far from the calibration: a drift, or another use"
"""Why estimates may be wrong."""

COMPARE = "compare a known load"
"""What to do: one known load tells use from drift."""


@dataclass(frozen=True, eq=False)
class DriftEvidence:
    """What is known of a drift when its doubt is asked for.

    Args:
        drift, applied_drift: (2,) shift and log gain, estimated and applied.
        variance: variance of the estimated drift.
        process_variance: variance that may have come since the last cycle.
        rest_path: how far the rest has gone in all.
        operation_variance: expected square of the error of a gain that may have been use, and of a shift, a preload.
        unobserved: drift that may have come in use that could not be compared.
        is_learning: whether that is the unit's first use, which is still being learnt.
        unexplained_jump: size of an unexplained jump.
        learning_shift: how far level or scale moved while the first use was learnt.
        rest_offset: how far the rest of a new use lies from all that are known.
        lag: how far the filter is behind, beyond chance.
        rest_distance: how far the latest use that is not known rests from all that are.
    """

    drift: Array
    applied_drift: Array
    variance: float
    process_variance: float
    rest_path: float
    operation_variance: float
    unobserved: float
    is_learning: bool
    unexplained_jump: float
    learning_shift: float
    rest_offset: float
    lag: float
    rest_distance: float = 0.0

    @property
    def unapplied(self) -> float:
        """Square of the drift that is estimated and not applied."""
        return float(np.sum((self.drift - self.applied_drift) ** 2))

    @property
    def size(self) -> float:
        """Square of the correction."""
        return float(self.applied_drift @ self.applied_drift)


@dataclass(frozen=True)
class DriftUncertainty:
    """How wrong the corrected output may be, for its interval and for the predicted error (`growth`).

    The squares of what may be use as well as drift, by why, hold the map.
    """

    interval_inflation: float
    error_inflation: float
    ambiguous: Mapping[str, float]


def with_remedy(cause: str) -> str:
    """Return why, and what to do."""
    return f"{cause}; {COMPARE}"


def estimate_uncertainty(evidence: DriftEvidence, config: UncertaintyConfig) -> DriftUncertainty:
    """Add up what is in doubt.

    Interval and predicted error hold three things: the error of the applied correction, what may have come since the
    last cycle or in use that was not compared, and what was not explained. The error of the correction is its variance,
    a share of its size, how far it is behind, a share of the whole way of the rest, and that its gain may have been
    use. The interval adds all of the estimated drift that was not applied. Of a use that is not known it adds how far
    that rests from those that are, and a gain as large. Of the drift the predicted error adds only what exceeds chance,
    and of that the part that is as likely drift as use. It leaves out use that was not compared while the first use is
    still being learnt.
    """
    # What was not applied cannot be wrong by chance: the variance counts as far as the correction goes.
    share = min(1.0, evidence.size / max(float(evidence.drift @ evidence.drift), 1e-24))
    variance = share * (evidence.variance + evidence.lag**2)
    variance += config.correction**2 * (evidence.size + evidence.rest_path**2)
    variance += evidence.operation_variance + evidence.process_variance
    unexplained = evidence.unexplained_jump**2 + evidence.learning_shift**2 + evidence.rest_offset**2
    unobserved = evidence.unobserved**2
    counted = 0.0 if evidence.is_learning else unobserved
    unapplied, excess = evidence.unapplied, max(0.0, evidence.unapplied - evidence.variance)
    return DriftUncertainty(
        interval_inflation=float(
            np.sqrt(variance + unobserved + unexplained + unapplied + 2 * evidence.rest_distance**2)
        ),
        error_inflation=float(np.sqrt(variance + counted + unexplained + 0.5 * excess)),
        ambiguous={
            UNCOMPARED: counted,
            MOVED_WHILE_LEARNT: evidence.learning_shift**2,
            REST_ELSEWHERE: evidence.rest_offset**2,
            JUMP: evidence.unexplained_jump**2,
            OPEN: max(0.0, unapplied - config.certain * evidence.variance) + (1 - share) * evidence.lag**2,
        },
    )
