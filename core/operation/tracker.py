"""How far a sensor has drifted since its calibration, from the cycles of its use; and when that cannot be told.

With m and s the mean and scale of the calibrated use, drift is a level shift mu and a log gain lambda,

    (output - m) / s = mu + exp(lambda) (calibrated output - m) / s,

estimated over cycles by a Kalman filter on a random walk (Kalman 1960). The measurements are the cycles of known
activities; their scatter within an activity is the measurement noise. Three changes are told apart:

- drift: small innovations, which the filter follows, faster while their mean has one sign for long (an adaptive
  process noise in place of a fixed forgetting factor);
- a re-seated sensor: an abrupt change (a jump) that moves the level of rest;
- another use: another distribution, speed or duration of the cycles, or an abrupt change that leaves the rest alone.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from softcal.core.operation.activity import CalibratedOperation, timing_regularity, trend_sd
from softcal.core.operation.attribution import DriftAttribution
from softcal.core.operation.change_detection import ChangeDetector
from softcal.core.operation.cycles import Cycle
from softcal.core.operation.drift_filter import DriftFilter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import (
    FOLLOWED,
    LEARNING_OPERATION,
    ON_HOLD,
    ON_TRIAL,
    OPERATION_OR_GAIN,
    PRELOADED,
    REST_MOVED,
    UNWATCHED,
    Observation,
    TrackerState,
)
from softcal.core.operation.stored_state import from_state, to_state
from softcal.core.operation.uncertainty import DriftEvidence, DriftUncertainty, estimate_uncertainty
from softcal.core.recording import Array


class DriftTracker:
    """Follows the drift of one unit, cycle by cycle; learns new activities from the best estimates so far."""

    def __init__(self, operation: CalibratedOperation, method: DriftTracking = DriftTracking()) -> None:  # noqa: B008 - frozen
        self._operation, self._method = operation, method
        calibrated_activity, drift = operation.learning.activity, method.drift
        # Without a calibrated activity the drift is counted from the first one learnt.
        state = DriftFilter.start(np.array(drift.start_sd) * (calibrated_activity is not None))
        if calibrated_activity is not None:
            state = state.with_independent(calibrated_activity.drift_covariance)
        # A trend seen in the calibration recording itself may go on.
        spread = np.array(drift.prior) ** 2 + operation.learning.trend**2 * (calibrated_activity is not None)
        self._walk = np.diag(spread) / operation.duration_s
        self._drift_share = 0.0
        if calibrated_activity is not None:
            # What moved while a machine repeated its loads was the sensor, beyond what its least scatter makes of one.
            chance = float(trend_sd(method.activity.min_scatter, 1))
            start = DriftAttribution(operation.zero, config=method.attribution)
            significant = start.significant_size(operation.learning.trend, operation.learning.trend_sd)
            self._drift_share = calibrated_activity.regularity * significant**2 / (significant**2 + chance**2)
        self._overdue_s = method.cycle.overdue * operation.typical_cycle_s
        self._detector = ChangeDetector(operation, method)
        self._settling = max(1, math.ceil(method.stream.settling / operation.cycle_samples))
        self._now = TrackerState(
            filter=state,
            attribution=DriftAttribution(operation.zero, config=method.attribution),
            activities=[] if calibrated_activity is None else [calibrated_activity],
            to_settle=self._settling,
            trend=np.zeros((2, 2)),
            carried_drift=np.zeros(2),
            believed_drift=np.zeros(2),
            unknown_cycles=[],
            jumps=[],
        )

    @property
    def alarm(self) -> str:
        """Why a calibration with a reference is due; empty while it is not."""
        return self._now.alarm

    @property
    def is_unsettled(self) -> bool:
        """Whether a sudden change waits for more cycles to say what it was."""
        return self._now.unexplained_jump > 0

    @property
    def is_learning(self) -> bool:
        """Whether no use is known yet that could be compared with."""
        return not self._now.activities

    @property
    def min_cycle_s(self) -> float:
        """Seconds that a cycle must last at least, shorter ones being joined; 0 while single cycles are compared."""
        return self._now.joined * self._now.cycle_s

    def observe(self, cycle: Cycle) -> Observation:
        """Take one cycle of the raw output."""
        now = self._now
        now.first_s = cycle.end_s if now.first_s is None else now.first_s
        walked = self._walked(cycle.end_s)
        now.filter = now.filter.predict(walked)
        now.last_s, now.trial_shift = cycle.end_s, 0.0
        if cycle.is_complete:
            earlier = now.log_durations[-self._method.activity.machine_cycles + 1 :]
            now.log_durations = [*earlier, math.log(cycle.duration_s)]
        # Free motion without return is no cycle; what it shows of the level says nothing about the sensor.
        if not cycle.is_complete:
            now.unknown_cycles.clear()
            now.was_recognised = False
            return self._hold(cycle, "no cycle of use was completed in the longest time one may take")
        standard = cycle.standardised(self._operation.mean, self._operation.scale)
        candidates = [k for k, activity in enumerate(now.activities) if activity.distance(standard) <= 1]
        # A cycle of no known activity is not like the calibrated ones.
        similarity = now.activities[0].similarity(standard) if candidates else 0.0
        now.similarity += (similarity - now.similarity) / self._method.drift.memory_cycles
        if not candidates:
            return self._compare_unknown(standard)
        now.unknown_cycles.clear()
        now.rest_offset, now.rest_distance = now.rest_offset_before, 0.0
        now.was_recognised = True
        # Use goes on as it was more often than it changes: of several that fit the latest, unless only another does.
        candidates.sort(key=lambda k: k != now.latest)
        fitting = [k for k in candidates if not self._detector.is_jump(now, standard, k)]
        return self._compare(standard, (fitting or candidates)[0], walked)

    def start(self) -> Observation:
        return self._observation(0.0, ON_HOLD, "", -1)

    def reconnect(self) -> None:
        """Allow for what may have happened in an interruption of unknown length."""
        now = self._now
        now.last_s, now.trial_shift, now.was_recognised = None, 0.0, False
        now.carried_drift, now.to_settle = now.applied_drift, self._settling
        now.filter = now.filter.predict(np.diag(np.array(self._method.drift.start_sd) ** 2))
        now.jumps.clear()
        now.unknown_cycles.clear()

    def expire(self, t_s: float) -> None:
        """End a trial whose next cycle is overdue by a time."""
        if self._now.last_s is not None and t_s - self._now.last_s > self._overdue_s + self.min_cycle_s:
            self._now.trial_shift = 0.0

    def _walked(self, t_s: float) -> Array:
        """Return the (2, 2) process noise since the last cycle."""
        return self._walk * (0.0 if self._now.last_s is None else max(0.0, t_s - self._now.last_s))

    def correction(self) -> tuple[float, float]:
        """Return gain and offset that carry the output now to the output at calibration, as far as evidence goes."""
        shift, log_gain = self._now.applied_drift
        gain = float(np.exp(-log_gain))
        return gain, self._operation.mean - gain * float(self._operation.mean + self._operation.scale * shift)

    def uncertainty_at(self, t_s: float) -> DriftUncertainty:
        """Return how wrong the corrected output may be at a time."""
        now = self._now
        drift, applied = now.filter.drift, now.applied_drift
        lengths = min(1.0, now.unobserved_s / self._operation.duration_s)
        unobserved = self._method.jump.sigmas * self._method.drift.unobserved * lengths
        lag = 0.0
        if now.activities:
            # The larger mean innovation beyond chance: how far the filter is behind a drift.
            weight = np.array(self._method.drift.trend_weight)
            expected = float(np.trace(now.filter.predict_measurement(now.latest)[1] + now.activities[now.latest].noise))
            chance = self._method.uncertainty.certain * expected * weight / (2 - weight)
            lag = math.sqrt(max(0.0, float(np.max(np.sum(now.trend**2, axis=1) - chance))))
        return estimate_uncertainty(
            DriftEvidence(
                drift=drift,
                applied_drift=applied,
                variance=float(np.trace(now.filter.drift_covariance())),
                process_variance=float(np.trace(self._walked(t_s))),
                rest_path=now.attribution.rest_path,
                operation_variance=now.attribution.operation_variance(drift, applied - now.sensor_drift),
                unobserved=unobserved,
                is_learning=self._is_learning(t_s),
                unexplained_jump=now.unexplained_jump,
                learning_shift=now.learning_shift,
                rest_offset=now.rest_offset,
                rest_distance=now.rest_distance,
                lag=lag,
            ),
            self._method.uncertainty,
        )

    def _is_learning(self, t_s: float) -> bool:
        """Return whether no use is known yet, and the time in which one may be learnt is not over."""
        now = self._now
        if now.activities or now.first_s is None:
            return False
        return t_s - now.first_s < self._method.learning.first_operation_s

    def _compare(self, cycle: Cycle, index: int, walked: Array) -> Observation:
        now = self._now
        activity = now.activities[index]
        if self._detector.is_jump(now, cycle, index) or self._detector.is_like_last_jumps(now, cycle, index):
            reaction = self._detector.classify_jump(now, cycle, index)
            if reaction.verdict == ON_HOLD:
                return self._hold(cycle, reaction.reason, index)
            if reaction.filter is not None:
                self._accept(reaction.filter, index)
            return self._observation(cycle.end_s, reaction.verdict, reaction.reason, index)
        # One cycle within reach of the old use does not end another: after several the others are forgotten.
        jumps = now.jumps[: len(now.jumps) // 2]
        surprise, expected = self._detector.surprise(now, cycle, index)
        # Process noise R / n^2 makes the steady filter average over about n cycles.
        # Shift and log gain lag alike: where one lags more, a use that grows slowly reads as a sensor that drifts.
        share = self._pace(surprise, expected) / self._method.drift.memory_cycles**2
        share += float(np.max(np.diag(walked) / np.diag(activity.noise)))
        predicted = now.filter.predict(share * activity.noise - walked)
        measured = predicted.update(index, activity.estimate_drift(cycle, self._operation.rest_is_low), activity.noise)
        # Beyond this the map was never tested; an estimate there would be extrapolated twice.
        if np.any(np.abs(measured.drift) > self._method.drift.max_drift):
            now.alarm = "the drift has left the range that is followed"
            return self._hold(cycle, now.alarm, index)
        now.activities[index] = activity.with_cycle(cycle, 1 / self._method.drift.memory_cycles)
        # A person who has just put the sensor on presses otherwise for a while.
        now.to_settle = max(0, now.to_settle - 1)
        # The log gain of the last few cycles of one activity.
        before = now.recent_log_gains if now.recent_activity == index else []
        log_gain = float(now.activities[index].estimate_drift(cycle, self._operation.rest_is_low)[1])
        now.recent_log_gains, now.recent_activity = [*before[-self._method.activity.min_cycles + 1 :], log_gain], index
        self._accept(measured, index)
        now.jumps = jumps
        if now.attribution.is_operation_as_likely(now.filter.drift, now.covariance, now.applied_drift):
            return self._observation(cycle.end_s, ON_HOLD, OPERATION_OR_GAIN, index)
        is_preload = now.attribution.may_be_preload and np.any(now.applied_drift)
        return self._observation(cycle.end_s, FOLLOWED, PRELOADED if is_preload else "", index)

    def _accept(self, measured: DriftFilter, index: int) -> None:
        now = self._now
        now.believed_drift = now.believed_drift + self._drift_weight() * (measured.drift - now.filter.drift)
        now.filter, now.latest, now.unobserved_s = measured, index, 0.0
        # A use that was known before the latest was learnt shows where the sensor is.
        if index < len(now.activities) - 1:
            now.rest_offset = now.rest_offset_before = 0.0
        activity = now.activities[index]
        # A person may go on with what a machine was calibrated with.
        is_timed = len(now.log_durations) >= self._method.activity.min_cycles and self._regularity() > 0
        timed = activity if is_timed else replace(activity, regularity=0.0)
        now.attribution = now.attribution.after_cycle(timed, measured.drift, now.covariance, 1 / self._settling)
        now.jumps.clear()
        now.alarm, now.unexplained_jump = "", 0.0

    def _drift_weight(self) -> float:
        """Return the weight of drift against use for what cycles show now, 0 to 1.

        It is the product of how surely the sensor drifted while it was calibrated, how like the calibrated ones the
        latest cycles are, and how regularly they come.
        """
        return self._drift_share * self._now.similarity * self._regularity()

    def _regularity(self) -> float:
        return timing_regularity(np.array(self._now.log_durations), self._method.activity)

    def _pace(self, surprise: Array, expected: Array) -> float:
        """Return the factor on the process noise: above 1 while innovations keep one sign beyond chance."""
        now, config = self._now, self._method.drift
        weight = np.array(config.trend_weight)
        now.trend = now.trend + weight[:, None] * (surprise - now.trend)
        # Variance of an exponential mean of independent values.
        chance = weight / (2 - weight)
        distance = np.sum(now.trend.T * np.linalg.solve(expected, now.trend.T), axis=0) / chance
        # At its fastest a filter of the usual memory averages over nothing.
        return float(np.clip(distance.max() / config.pace, 1, config.memory_cycles**2))

    def _compare_unknown(self, cycle: Cycle) -> Observation:
        now = self._now
        now.jumps.clear()
        followed_recognised, now.was_recognised, now.unexplained_jump = now.was_recognised, False, 0.0
        # A shift that may have come in use nobody compared is in doubt for every use that is learnt from it. A gain is
        # not: the next cycle within reach, of a larger or a smaller use, would be taken for one.
        unobserved = self._method.drift.unobserved**2 * cycle.duration_s / self._operation.duration_s
        now.filter = now.filter.predict(np.diag([unobserved, 0.0]))
        # A sensor re-seated in the midst of a cycle gives it another shape.
        if followed_recognised and self._detector.is_like_but_for_shape(now, cycle, now.latest):
            if self._detector.try_rest(now, cycle, now.latest):
                now.unexplained_jump = abs(now.trial_shift)
                return self._observation(cycle.end_s, ON_TRIAL, REST_MOVED, -1)
        if not self._detector.learn_from(now, cycle):
            return self._hold(cycle, "the use is none of those known")
        learnt = self._hold(cycle, "a new use was learnt from the estimates so far", len(now.activities) - 1)
        if len(now.activities) == 1:
            # The drift is counted from the first activity: nothing of it came before.
            now.unobserved_s = 0.0
        return learnt

    def _hold(self, cycle: Cycle, reason: str, index: int = -1) -> Observation:
        self._now.unobserved_s += cycle.duration_s
        if self._is_learning(cycle.end_s):
            return self._observation(cycle.end_s, UNWATCHED, LEARNING_OPERATION, index)
        return self._observation(cycle.end_s, ON_HOLD, reason, index)

    def _observation(self, t_s: float, verdict: str, reason: str, index: int) -> Observation:
        shift, log_gain = self._now.filter.drift.tolist()
        shift_sd, log_gain_sd = np.sqrt(np.diag(self._now.filter.drift_covariance())).tolist()
        return Observation(t_s, verdict, reason, shift, log_gain, shift_sd, log_gain_sd, index)

    def state(self) -> dict[str, object]:
        return to_state(self._now)

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state()` taken earlier.

        Raises:
            InputError: it was taken by a version that keeps other things in it.
        """
        now = from_state(TrackerState, state)
        # The thresholds are this method's, not those the state was taken with.
        self._now = replace(now, attribution=replace(now.attribution, config=self._method.attribution))
