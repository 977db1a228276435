"""What a tracker says of each cycle, and all that it keeps."""

from dataclasses import dataclass, field

import numpy as np

from softcal.core.operation.activity import Activity
from softcal.core.operation.attribution import DriftAttribution
from softcal.core.operation.cycles import Cycle
from softcal.core.operation.drift_filter import DriftFilter
from softcal.core.operation.stored_state import array_field
from softcal.core.recording import Array

FOLLOWED, ON_HOLD, ON_TRIAL, JUMPED, UNWATCHED = "followed", "held", "tried", "jumped", "unwatched"
REST_MOVED = "the rest moved at once; the next cycles decide what it is"
OPERATION_CHANGED = "the rest is where it was: the use changed, not the sensor"
PRELOAD_FELL = "the rest came nearer to zero load: less preload, or a sensor that moved"
OPERATION_OR_GAIN = "the cycles changed in size about a rest that stands: use or gain, which only a reference can tell"
PRELOADED = "not watched: this use never comes to zero load; a preload that changes is taken for drift"
QUEUE_DIFFERS = "not watched: queues of this length differ too much by chance to show a drift; a longer queue is needed"
LEARNING_OPERATION = "not watched yet: the first use is still being learnt, and a drift before that is not seen"


@dataclass(frozen=True)
class Observation:
    """What one cycle said.

    Args:
        verdict: `followed`, `held`, `tried`, `jumped`, or `unwatched` while the first use is being learnt.
        reason: why, in words; empty where the drift was followed.
        shift, log_gain: drift after it, in scales of the calibrated use.
        activity: index of the activity it belongs to, -1 for none.
    """

    t_s: float
    verdict: str
    reason: str
    shift: float
    log_gain: float
    shift_sd: float
    log_gain_sd: float
    activity: int


@dataclass
class TrackerState:
    """What a restart needs besides the calibrated use.

    Args:
        activities: known ones, the calibrated one first.
        to_settle: cycles left before the estimate is applied; `carried`, (2,), is applied until then.
        trend: (2, 2) exponential means of the innovations, a quick and a slow one.
        jumps: like cycles since a jump that is not yet explained.
        trial_shift: shift that is applied on trial until the next cycle.
        unobserved_s: seconds of use since the drift was last measured.
        unexplained_jump: size of an unexplained jump, in scales; 0 where there is none.
        joined, cycle_s: usual cycles that are taken together as one, and the duration of a single one.
        learning_shift: how far level and scale moved while the first use was learnt, in scales; 0 where that may be
            chance.
        rest_offset: how far the rest of the latest strange cycles, or of a use learnt from them, lies from all that
            were known; 0 where that may be chance.
        rest_offset_before: the same when these cycles began.
        recent_log_gains, recent_activity: log gains of the last few cycles that were compared, and their activity.
        rest_distance: how far the latest strange cycles rest from all that are known, be it chance or not.
        believed_drift: (2,) part of the drift that the same use of an ageing sensor shows.
        similarity: how like the latest cycles were to the calibrated ones, 0 to 1.
        opening_level, opening_level_sd: level over the first cycles, in scales; both 0 while single cycles are
            compared.
    """

    filter: DriftFilter
    attribution: DriftAttribution
    activities: list[Activity]
    to_settle: int
    trend: Array = field(metadata=array_field(2, 2))
    carried_drift: Array = field(metadata=array_field(2))
    believed_drift: Array = field(metadata=array_field(2))
    unknown_cycles: list[Cycle]
    jumps: list[Cycle]
    latest: int = 0
    last_s: float | None = None
    trial_shift: float = 0.0
    was_recognised: bool = False
    unobserved_s: float = 0.0
    alarm: str = ""
    unexplained_jump: float = 0.0
    joined: int = 1
    cycle_s: float = 0.0
    first_s: float | None = None
    learning_shift: float = 0.0
    rest_offset: float = 0.0
    rest_offset_before: float = 0.0
    recent_log_gains: list[float] = field(default_factory=list)
    recent_activity: int = -1
    log_durations: list[float] = field(default_factory=list)
    rest_distance: float = 0.0
    similarity: float = 1.0
    opening_level: float = 0.0
    opening_level_sd: float = 0.0

    @property
    def covariance(self) -> Array:
        """(2, 2) covariance of the drift against the oldest known activity.

        The latest one was learnt from the drift as it was believed then: it shows every movement since, no origin.
        """
        return self.filter.predict_measurement(0)[1] if self.activities else self.filter.drift_covariance()

    @property
    def sensor_drift(self) -> Array:
        """(2,) shift and log gain believed to be the sensor's: never more than is estimated."""
        return np.clip(self.believed_drift, np.minimum(self.filter.drift, 0), np.maximum(self.filter.drift, 0))

    @property
    def applied_drift(self) -> Array:
        """(2,) shift and log gain that the correction takes out."""
        if self.to_settle:
            return self.carried_drift
        drift, sensor = self.filter.drift, self.sensor_drift
        significant = self.attribution.applied_drift(drift, self.covariance)
        # Each is a lower bound of what is drift.
        applied = np.where(np.abs(drift - sensor) < np.abs(drift - significant), sensor, significant)
        return np.asarray(applied + np.array([self.trial_shift, 0.0]))
