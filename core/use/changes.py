"""Changes that are no drift: a re-seated sensor, and another use. What tells them, and what is made of them.

No use moves the output at rest. A cycle that took as long and swung as far as usual, but came to rest at another level,
is therefore the first one of a re-seated sensor. If the sensor moved in mid-cycle, mean and standard deviation of that
cycle mix both positions. Its rest belongs to one of them and can be used.

A new use is learnt from cycles of no known one with the drift taken out; its rest says something of the sensor.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.activity import CalibratedUse, learn_activity
from softcal.core.use.cycles import Cycle, end_spread
from softcal.core.use.filter import DriftFilter
from softcal.core.use.method import UseMethod
from softcal.core.use.observation import HELD, JUMPED, PRELOAD_GONE, REST_MOVED, TRIED, USE_CHANGED, TrackerState
from softcal.core.use.trust import movement


@dataclass(frozen=True, eq=False)
class JumpReaction:
    """What becomes of a cycle that changed suddenly; the filter stays at the old place where none is measured."""

    verdict: str
    reason: str
    measured: DriftFilter | None = None


class Changes:
    """Finds changes and reacts to them, in the state of a tracker."""

    def __init__(self, use: CalibratedUse, method: UseMethod) -> None:
        self._use, self._method = use, method
        self._floor = method.trust.step, method.jump.log_gain

    def surprise(self, now: TrackerState, cycle: Cycle, index: int) -> tuple[Array, Array]:
        """Return the innovation: measured drift less the predicted one, and its covariance."""
        activity = now.activities[index]
        mean, covariance = now.filter.seen_by(index)
        return activity.drift_of(cycle, self._use.rest_is_low) - mean, covariance + activity.noise

    def is_jump(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle is not where drift takes it: too far off, or of another size in a machine's use."""
        activity = now.activities[index]
        surprise, expected = self.surprise(now, cycle, index)
        # From (shift, log gain) to (movement of the rest, log gain): use moves the shift, but no rest.
        sight = np.array([[1.0, np.exp(now.filter.drift[1]) * activity.rest], [0.0, 1.0]])
        least = self._method.jump.sigmas * np.sqrt(np.diag(sight @ expected @ sight.T))
        if np.any(np.abs(sight @ surprise) > np.maximum(least, self._floor)):
            return True
        if not activity.is_imposed or now.recent_of != index or not now.recent:
            return False
        # The size stepped from that of the cycles before: a drift gets there little by little.
        step = activity.drift_of(cycle, self._use.rest_is_low)[1] - float(np.mean(now.recent))
        sd = math.sqrt(float(activity.noise[1, 1]) * (1 + 1 / len(now.recent)))
        return bool(abs(step) > self._method.jump.sigmas * sd)

    def is_like_jumps(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle is nearer to those since a jump than to the prediction (Mahalanobis distance).

        After a change of use some of its cycles lie within reach of the old use. Followed, they would drag the drift
        after the use.
        """
        if len(now.jumps) < self._method.jump.cycles:
            return False
        activity, (surprise, _) = now.activities[index], self.surprise(now, cycle, index)
        drifts = [activity.drift_of(c, self._use.rest_is_low) for c in (*now.jumps, cycle)]
        apart = drifts[-1] - np.mean(drifts[:-1], axis=0)
        near, far = (float(d @ np.linalg.solve(activity.noise, d)) for d in (apart, surprise))
        return near < far

    def meet(self, now: TrackerState, cycle: Cycle, index: int) -> JumpReaction:
        """Hold a sudden change until like cycles say what it was, then follow it or not."""
        config, activity, drift = self._method.jump, now.activities[index], now.filter.drift
        most = self._method.learning.cycles
        measured = activity.drift_of(cycle, self._use.rest_is_low)
        before = [activity.drift_of(c, self._use.rest_is_low) for c in now.jumps[-most + 1 :]]
        # The difference of two cycles has twice the variance of one.
        apart = config.sigmas * np.sqrt(2 * np.diag(activity.noise))
        # A cycle unlike the others starts the count anew: the change was not over yet.
        if before and np.any(np.abs(measured - np.mean(before, axis=0)) > apart):
            before = []
        now.jumps = [*now.jumps[len(now.jumps) - len(before) :], cycle]
        level = np.mean([*before, measured], axis=0)
        step = level - now.filter.seen_by(index)[0]
        now.unresolved = float(np.hypot(*step))
        if len(now.jumps) < config.cycles:
            if self.try_rest(now, cycle, index):
                return JumpReaction(TRIED, REST_MOVED)
            return JumpReaction(HELD, f"a sudden change; {config.cycles} like cycles decide what it is")
        # Without a rest a jump of the sensor and one of the use are the same numbers.
        if not activity.has_rest:
            return JumpReaction(HELD, "a sudden change of sensor or use, which no known rest can tell apart")
        moved = now.trust.jumped(activity, drift, step)
        crept = now.trust.creep(activity.rest, float(step[1]))
        stands = min(abs(moved), abs(moved - crept)) <= max(self._floor[0], config.sigmas * activity.rest_scatter)
        if stands or now.trust.is_lighter(activity, drift, step):
            now.unresolved = 0.0
            if not stands:
                now.stray = max(now.stray, math.sqrt(0.5) * abs(moved))
            if len(now.jumps) == most and self._learn(now, now.jumps):
                now.jumps.clear()
            return JumpReaction(HELD, USE_CHANGED if stands else PRELOAD_GONE)
        before, after = drift[0], drift[0] + moved
        is_far = abs(moved) > config.largest[0] and abs(after) >= abs(before)
        if is_far or abs(after) > self._method.drift.largest[0]:
            now.alarm = "a sudden change larger than is ever followed; check the sensor and its mounting"
            return JumpReaction(HELD, now.alarm)
        return self._follow(now, index, level, moved)

    def _follow(self, now: TrackerState, index: int, level: Array, moved: float) -> JumpReaction:
        """Follow a re-seating; of one with more gain than its rest vouches for, the rest alone."""
        config, activity = self._method.jump, now.activities[index]
        seen = now.filter.seen_by(index)[0]
        reason = "the rest and all levels moved at once: re-seated"
        if abs(level[1] - seen[1]) > now.trust.gain_per_shift(activity.rest) * abs(moved):
            level = seen + np.array([moved, 0.0])
            reason = "the rest moved at once, and the use changed with it: re-seated"
        # Wide process noise lets the filter go to the new place at once instead of averaging over old cycles.
        free = now.filter.moved(np.diag((np.array(config.largest) / self._method.activity.tolerance_sigmas) ** 2))
        now.trust = now.trust.reseated(now.filter.drift, now.seen, moved, self._method.drift.memory_cycles)
        now.trend, now.to_settle, now.recent = np.zeros_like(now.trend), 0, []
        return JumpReaction(JUMPED, reason, free.measured(index, level, activity.noise / config.cycles))

    def try_rest(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Follow the rest of one cycle until the next one, where it shows a re-seating."""
        activity, zero = now.activities[index], now.trust.zero
        # Harder use moves the turning point of a preloaded sensor, though not its output at zero load.
        if zero is None or abs(activity.rest - zero) > self._method.trust.preload:
            return False
        step = cycle.rest(self._use.rest_is_low) - activity.rest - movement(now.filter.drift, activity.rest)
        least = max(self._floor[0], self._method.jump.sigmas * activity.rest_scatter)
        # The rest of a use that has none, or that moves as far as ever, shows nothing.
        if not activity.has_rest or not least < abs(step) <= self._method.jump.largest[0]:
            return False
        # A rest of two levels, one before and one after the move, is spread more than a usual rest.
        unsteady = cycle.scale * end_spread(cycle.shape, self._use.rest_is_low)
        usual = float(np.exp(activity.log_scale + now.filter.drift[1]))
        usual *= end_spread(activity.shape, self._use.rest_is_low)
        is_steady = unsteady <= usual + self._floor[0] / 2
        is_within = abs(now.filter.drift[0] + step) <= self._method.drift.largest[0]
        now.trial = step if is_steady and is_within else 0.0
        return now.trial != 0

    def is_like_but_for_shape(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle took as long as those of an activity and swung about as far, whatever its shape."""
        activity = now.activities[index]
        longer = np.log(cycle.duration_s) - activity.log_duration
        larger = np.log(cycle.scale) - activity.log_scale - now.filter.drift[1]
        return bool(abs(longer) <= activity.tolerance[2] and abs(larger) <= self._method.jump.largest[1])

    def take(self, now: TrackerState, cycle: Cycle) -> bool:
        """Take one more cycle of no known activity; return whether a new one was learnt with it."""
        config = self._method.learning
        now.strangers = [*now.strangers[-config.most_cycles + 1 :], cycle]
        now.stray = max(now.stray_before, self._stray(now, now.strangers))
        span_s = cycle.end_s - now.strangers[0].end_s
        is_long = span_s >= config.length * self._use.duration_s or len(now.strangers) == config.most_cycles
        enough = config.cycles if now.joined == 1 else 2 * config.cycles
        if len(now.strangers) >= enough and is_long and self._learn(now, now.strangers):
            now.strangers.clear()
            return True
        most = config.most_cycles if now.joined == 1 else enough
        more = [count for count in self._method.cycle.joined if count > now.joined]
        if more and not now.activities and is_long and len(now.strangers) >= most:
            # Means over several random presses are alike where single presses are not.
            if now.joined == 1:
                durations_s = np.array([cycle.duration_s for cycle in now.strangers])
                levels = np.array([cycle.level for cycle in now.strangers])
                now.single_s = float(np.median(durations_s))
                # The mean level over the time of the cycles, and its standard deviation.
                now.opening = float(np.average(levels, weights=durations_s))
                variance = float(np.average((levels - now.opening) ** 2, weights=durations_s))
                now.opening_sd = math.sqrt(variance / len(levels))
            now.joined = more[0]
            now.strangers.clear()
        return False

    def _learn(self, now: TrackerState, cycles: list[Cycle]) -> bool:
        """Learn an activity from cycles with the drift known now taken out."""
        shift, gain = float(now.filter.drift[0]), float(np.exp(now.filter.drift[1]))
        # The drift known now is taken out first, or it would become part of what the activity is compared with.
        calibrated = [c.standardised(shift, gain) for c in cycles]
        lesson = learn_activity(calibrated, self._use.rest_is_low, self._method, self._use.curve)
        activity = lesson.activity
        if activity is None:
            return False
        if not now.activities:
            # How far level and scale surely moved until a first activity was learnt.
            now.missed = now.trust.sure_size(lesson.trend, lesson.trend_sd)
            if now.opening_sd:
                since = np.array([activity.level - now.opening])
                sd = np.array([math.hypot(now.opening_sd, math.sqrt(activity.doubt[0, 0]))])
                now.missed = math.hypot(now.missed, now.trust.sure_size(since, sd))
        # The calibrated activity is never forgotten: it alone knows the zero of the drift.
        if len(now.activities) == self._method.learning.activities:
            oldest = 1 if self._use.lesson.activity is not None else 0
            del now.activities[oldest]
            now.filter = now.filter.without(oldest)
        regularity = activity.regularity if len(cycles) >= self._method.activity.machine_cycles else 0.0
        now.activities.append(replace(activity, regularity=regularity))
        now.stray_before = now.stray
        now.filter = now.filter.with_learnt(activity.doubt)
        now.latest, now.recent = len(now.activities) - 1, []
        return True

    def _stray(self, now: TrackerState, cycles: list[Cycle]) -> float:
        """Return how far the rest of strange cycles surely lies from where any known use rests, in scales.

        No use goes below the output of no load. One that stays above the known rests is as likely a preload as a sensor
        that has moved. Of a first use nobody knows yet whether it is preloaded.
        """
        trust = self._method.trust
        if len(cycles) < self._method.activity.min_cycles:
            return 0.0
        away, sd, turning = self._beyond(now, cycles)
        now.away = abs(self._beyond(now, cycles[-self._method.activity.min_cycles :])[0])
        sd = math.hypot(sd, math.sqrt(float(now.filter.doubt()[0, 0])))
        sure = now.trust.sure_size(np.array([away]), np.array([sd]))
        if away < 0:
            return max(0.0, sure - trust.step)
        if not now.activities:
            return 0.0
        return math.sqrt(0.5) * max(0.0, sure - max(turning, trust.step))

    def _beyond(self, now: TrackerState, cycles: list[Cycle]) -> tuple[float, float, float]:
        """Return where the rest of cycles lies against zero load and any known rest, in scales of the calibrated use.

        Beyond the nearest one, positive on the loaded side, 0 between them; the standard deviation of the mean rest;
        and how far the unloaded ends spread: a use that turns without resting stays off zero by it.
        """
        use = self._use
        levels = [a.rest for a in now.activities if a.has_rest] + ([] if use.zero is None else [use.zero])
        levels.append(((use.low if use.rest_is_low else use.high) - use.mean) / use.scale)
        expected = float(now.filter.drift[0]) + float(np.exp(now.filter.drift[1])) * np.array(levels)
        rests = np.array([cycle.rest(use.rest_is_low) for cycle in cycles])
        away = min(float(rests.mean() - expected.min()), 0.0) + max(float(rests.mean() - expected.max()), 0.0)
        turning = float(np.mean([cycle.scale * end_spread(cycle.shape, use.rest_is_low) for cycle in cycles]))
        return away if use.rest_is_low else -away, float(rests.std()) / len(rests) ** 0.5, turning
