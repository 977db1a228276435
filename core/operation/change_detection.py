"""Changes that are no drift: a re-seated sensor, and another use. What tells them, and what is made of them.

No use moves the output at rest. A cycle that took as long and swung as far as usual, but came to rest at another level,
is therefore the first one of a re-seated sensor. If the sensor moved in mid-cycle, mean and standard deviation of that
cycle mix both positions. Its rest belongs to one of them and can be used.

A new use is learnt from cycles of no known one with the drift taken out; its rest says something of the sensor.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.operation.activity import CalibratedOperation, learn_activity
from softcal.core.operation.attribution import movement
from softcal.core.operation.cycles import Cycle, end_spread
from softcal.core.operation.drift_filter import DriftFilter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import (
    JUMPED,
    ON_HOLD,
    ON_TRIAL,
    OPERATION_CHANGED,
    PRELOAD_FELL,
    REST_MOVED,
    TrackerState,
)
from softcal.core.recording import Array


@dataclass(frozen=True, eq=False)
class JumpReaction:
    """What becomes of a cycle that changed suddenly; the filter stays at the old place where none is measured."""

    verdict: str
    reason: str
    filter: DriftFilter | None = None


class ChangeDetector:
    """Finds changes and reacts to them, in the state of a tracker."""

    def __init__(self, operation: CalibratedOperation, method: DriftTracking) -> None:
        self._operation, self._method = operation, method
        self._min_jump = method.attribution.step, method.jump.log_gain

    def surprise(self, now: TrackerState, cycle: Cycle, index: int) -> tuple[Array, Array]:
        """Return the innovation: measured drift less the predicted one, and its covariance."""
        activity = now.activities[index]
        mean, covariance = now.filter.predict_measurement(index)
        return activity.estimate_drift(cycle, self._operation.rest_is_low) - mean, covariance + activity.noise

    def is_jump(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle is not where drift takes it: too far off, or of another size in a machine's use."""
        activity = now.activities[index]
        surprise, expected = self.surprise(now, cycle, index)
        # From (shift, log gain) to (movement of the rest, log gain): use moves the shift, but no rest.
        measurement = np.array([[1.0, np.exp(now.filter.drift[1]) * activity.rest], [0.0, 1.0]])
        threshold = self._method.jump.sigmas * np.sqrt(np.diag(measurement @ expected @ measurement.T))
        if np.any(np.abs(measurement @ surprise) > np.maximum(threshold, self._min_jump)):
            return True
        if not activity.is_imposed or now.recent_activity != index or not now.recent_log_gains:
            return False
        # The size stepped from that of the cycles before: a drift gets there little by little.
        step = activity.estimate_drift(cycle, self._operation.rest_is_low)[1] - float(np.mean(now.recent_log_gains))
        sd = math.sqrt(float(activity.noise[1, 1]) * (1 + 1 / len(now.recent_log_gains)))
        return bool(abs(step) > self._method.jump.sigmas * sd)

    def is_like_last_jumps(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle is nearer to those since a jump than to the prediction (Mahalanobis distance).

        After a change of use some of its cycles lie within reach of the old use. Followed, they would drag the drift
        after the use.
        """
        if len(now.jumps) < self._method.jump.cycles:
            return False
        activity, (surprise, _) = now.activities[index], self.surprise(now, cycle, index)
        drifts = [activity.estimate_drift(c, self._operation.rest_is_low) for c in (*now.jumps, cycle)]
        apart = drifts[-1] - np.mean(drifts[:-1], axis=0)
        jump_distance, prediction_distance = (float(d @ np.linalg.solve(activity.noise, d)) for d in (apart, surprise))
        return jump_distance < prediction_distance

    def classify_jump(self, now: TrackerState, cycle: Cycle, index: int) -> JumpReaction:
        """Hold a sudden change until like cycles say what it was, then follow it or not."""
        config, activity, drift = self._method.jump, now.activities[index], now.filter.drift
        max_cycles = self._method.learning.cycles
        measured = activity.estimate_drift(cycle, self._operation.rest_is_low)
        before = [activity.estimate_drift(c, self._operation.rest_is_low) for c in now.jumps[-max_cycles + 1 :]]
        # The difference of two cycles has twice the variance of one.
        apart = config.sigmas * np.sqrt(2 * np.diag(activity.noise))
        # A cycle unlike the others starts the count anew: the change was not over yet.
        if before and np.any(np.abs(measured - np.mean(before, axis=0)) > apart):
            before = []
        now.jumps = [*now.jumps[len(now.jumps) - len(before) :], cycle]
        level = np.mean([*before, measured], axis=0)
        step = level - now.filter.predict_measurement(index)[0]
        now.unexplained_jump = float(np.hypot(*step))
        if len(now.jumps) < config.cycles:
            if self.try_rest(now, cycle, index):
                return JumpReaction(ON_TRIAL, REST_MOVED)
            return JumpReaction(ON_HOLD, f"a sudden change; {config.cycles} like cycles decide what it is")
        # Without a rest a jump of the sensor and one of the use are the same numbers.
        if not activity.has_rest:
            return JumpReaction(ON_HOLD, "a sudden change of sensor or use, which no known rest can tell apart")
        rest_step = now.attribution.sensor_step(activity, drift, step)
        crept = now.attribution.creep(activity.rest, float(step[1]))
        threshold = max(self._min_jump[0], config.sigmas * activity.rest_scatter)
        is_rest_fixed = min(abs(rest_step), abs(rest_step - crept)) <= threshold
        if is_rest_fixed or now.attribution.is_towards_zero_load(activity, drift, step):
            now.unexplained_jump = 0.0
            if not is_rest_fixed:
                now.rest_offset = max(now.rest_offset, math.sqrt(0.5) * abs(rest_step))
            if len(now.jumps) == max_cycles and self._learn(now, now.jumps):
                now.jumps.clear()
            return JumpReaction(ON_HOLD, OPERATION_CHANGED if is_rest_fixed else PRELOAD_FELL)
        before, after = drift[0], drift[0] + rest_step
        is_far = abs(rest_step) > config.max_jump[0] and abs(after) >= abs(before)
        if is_far or abs(after) > self._method.drift.max_drift[0]:
            now.alarm = "a sudden change larger than is ever followed; check the sensor and its mounting"
            return JumpReaction(ON_HOLD, now.alarm)
        return self._follow(now, index, level, rest_step)

    def _follow(self, now: TrackerState, index: int, level: Array, rest_step: float) -> JumpReaction:
        """Follow a re-seating; of one with more gain than its rest vouches for, the rest alone."""
        config, activity = self._method.jump, now.activities[index]
        predicted = now.filter.predict_measurement(index)[0]
        reason = "the rest and all levels moved at once: re-seated"
        if abs(level[1] - predicted[1]) > now.attribution.gain_per_shift(activity.rest) * abs(rest_step):
            level = predicted + np.array([rest_step, 0.0])
            reason = "the rest moved at once, and the use changed with it: re-seated"
        # Wide process noise lets the filter go to the new place at once instead of averaging over old cycles.
        free = now.filter.predict(np.diag((np.array(config.max_jump) / self._method.activity.tolerance_sigmas) ** 2))
        cycles = self._method.drift.memory_cycles
        now.attribution = now.attribution.after_reseating(now.filter.drift, now.covariance, rest_step, cycles)
        now.trend, now.to_settle, now.recent_log_gains = np.zeros_like(now.trend), 0, []
        return JumpReaction(JUMPED, reason, free.update(index, level, activity.noise / config.cycles))

    def try_rest(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Follow the rest of one cycle until the next one, where it shows a re-seating."""
        activity, zero = now.activities[index], now.attribution.zero
        # Harder use moves the turning point of a preloaded sensor, though not its output at zero load.
        if zero is None or abs(activity.rest - zero) > self._method.attribution.preload:
            return False
        step = cycle.rest(self._operation.rest_is_low) - activity.rest - movement(now.filter.drift, activity.rest)
        threshold = max(self._min_jump[0], self._method.jump.sigmas * activity.rest_scatter)
        # The rest of a use that has none, or that moves as far as ever, shows nothing.
        if not activity.has_rest or not threshold < abs(step) <= self._method.jump.max_jump[0]:
            return False
        # A rest of two levels, one before and one after the move, is spread more than a usual rest.
        unsteady = cycle.scale * end_spread(cycle.shape, self._operation.rest_is_low)
        typical_spread = float(np.exp(activity.log_scale + now.filter.drift[1]))
        typical_spread *= end_spread(activity.shape, self._operation.rest_is_low)
        is_steady = unsteady <= typical_spread + self._min_jump[0] / 2
        is_within = abs(now.filter.drift[0] + step) <= self._method.drift.max_drift[0]
        now.trial_shift = step if is_steady and is_within else 0.0
        return now.trial_shift != 0

    def is_like_but_for_shape(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle took as long as those of an activity and swung about as far, whatever its shape."""
        activity = now.activities[index]
        longer = np.log(cycle.duration_s) - activity.log_duration
        larger = np.log(cycle.scale) - activity.log_scale - now.filter.drift[1]
        return bool(abs(longer) <= activity.tolerance[2] and abs(larger) <= self._method.jump.max_jump[1])

    def learn_from(self, now: TrackerState, cycle: Cycle) -> bool:
        """Take one more cycle of no known activity; return whether a new one was learnt with it."""
        config = self._method.learning
        now.unknown_cycles = [*now.unknown_cycles[-config.max_cycles + 1 :], cycle]
        now.rest_offset = max(now.rest_offset_before, self._rest_offset(now, now.unknown_cycles))
        span_s = cycle.end_s - now.unknown_cycles[0].end_s
        is_long = span_s >= config.length * self._operation.duration_s or len(now.unknown_cycles) == config.max_cycles
        enough = config.cycles if now.joined == 1 else 2 * config.cycles
        if len(now.unknown_cycles) >= enough and is_long and self._learn(now, now.unknown_cycles):
            now.unknown_cycles.clear()
            return True
        max_cycles = config.max_cycles if now.joined == 1 else enough
        more = [count for count in self._method.cycle.joined if count > now.joined]
        if more and not now.activities and is_long and len(now.unknown_cycles) >= max_cycles:
            # Means over several random presses are alike where single presses are not.
            if now.joined == 1:
                durations_s = np.array([cycle.duration_s for cycle in now.unknown_cycles])
                levels = np.array([cycle.level for cycle in now.unknown_cycles])
                now.cycle_s = float(np.median(durations_s))
                # The mean level over the time of the cycles, and its standard deviation.
                now.opening_level = float(np.average(levels, weights=durations_s))
                variance = float(np.average((levels - now.opening_level) ** 2, weights=durations_s))
                now.opening_level_sd = math.sqrt(variance / len(levels))
            now.joined = more[0]
            now.unknown_cycles.clear()
        return False

    def _learn(self, now: TrackerState, cycles: list[Cycle]) -> bool:
        """Learn an activity from cycles with the drift known now taken out."""
        shift, gain = float(now.filter.drift[0]), float(np.exp(now.filter.drift[1]))
        # The drift known now is taken out first, or it would become part of what the activity is compared with.
        calibrated = [c.standardised(shift, gain) for c in cycles]
        learning = learn_activity(calibrated, self._operation.rest_is_low, self._method, self._operation.curve)
        activity = learning.activity
        if activity is None:
            return False
        if not now.activities:
            # How far level and scale surely moved until a first activity was learnt.
            now.learning_shift = now.attribution.significant_size(learning.trend, learning.trend_sd)
            if now.opening_level_sd:
                since = np.array([activity.level - now.opening_level])
                sd = np.array([math.hypot(now.opening_level_sd, math.sqrt(activity.drift_covariance[0, 0]))])
                now.learning_shift = math.hypot(now.learning_shift, now.attribution.significant_size(since, sd))
        # The calibrated activity is never forgotten: it alone knows the zero of the drift.
        if len(now.activities) == self._method.learning.activities:
            oldest = 1 if self._operation.learning.activity is not None else 0
            del now.activities[oldest]
            now.filter = now.filter.without(oldest)
        regularity = activity.regularity if len(cycles) >= self._method.activity.machine_cycles else 0.0
        now.activities.append(replace(activity, regularity=regularity))
        now.rest_offset_before = now.rest_offset
        now.filter = now.filter.with_learnt(activity.drift_covariance)
        now.latest, now.recent_log_gains = len(now.activities) - 1, []
        return True

    def _rest_offset(self, now: TrackerState, cycles: list[Cycle]) -> float:
        """Return how far the rest of strange cycles surely lies from where any known use rests, in scales.

        No use goes below the output of no load. One that stays above the known rests is as likely a preload as a sensor
        that has moved. Of a first use nobody knows yet whether it is preloaded.
        """
        attribution = self._method.attribution
        if len(cycles) < self._method.activity.min_cycles:
            return 0.0
        distance, sd, turning = self._rest_beyond_others(now, cycles)
        now.rest_distance = abs(self._rest_beyond_others(now, cycles[-self._method.activity.min_cycles :])[0])
        sd = math.hypot(sd, math.sqrt(float(now.filter.drift_covariance()[0, 0])))
        significant = now.attribution.significant_size(np.array([distance]), np.array([sd]))
        if distance < 0:
            return max(0.0, significant - attribution.step)
        if not now.activities:
            return 0.0
        return math.sqrt(0.5) * max(0.0, significant - max(turning, attribution.step))

    def _rest_beyond_others(self, now: TrackerState, cycles: list[Cycle]) -> tuple[float, float, float]:
        """Return where the rest of cycles lies against zero load and any known rest, in scales of the calibrated use.

        Beyond the nearest one, positive on the loaded side, 0 between them; the standard deviation of the mean rest;
        and how far the unloaded ends spread: a use that turns without resting stays off zero by it.
        """
        operation = self._operation
        levels = [a.rest for a in now.activities if a.has_rest] + ([] if operation.zero is None else [operation.zero])
        levels.append(((operation.low if operation.rest_is_low else operation.high) - operation.mean) / operation.scale)
        expected = float(now.filter.drift[0]) + float(np.exp(now.filter.drift[1])) * np.array(levels)
        rests = np.array([cycle.rest(operation.rest_is_low) for cycle in cycles])
        distance = min(float(rests.mean() - expected.min()), 0.0) + max(float(rests.mean() - expected.max()), 0.0)
        turning = float(np.mean([cycle.scale * end_spread(cycle.shape, operation.rest_is_low) for cycle in cycles]))
        return distance if operation.rest_is_low else -distance, float(rests.std()) / len(rests) ** 0.5, turning
