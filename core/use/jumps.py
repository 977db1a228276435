"""Sudden changes of a sensor in use: re-seated, or used otherwise? What tells them, and what is followed of them.

No use moves the output at rest. A cycle that took as long and swung as far as usual, but came to rest at another level,
is therefore the first one of a re-seated sensor. If the sensor moved in mid-cycle, mean and standard deviation of that
cycle mix both positions. Its rest belongs to one of them and can be used.
"""

import math
from dataclasses import dataclass

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.activity import Activity, CalibratedUse
from softcal.core.use.cycles import Cycle
from softcal.core.use.filter import DriftFilter
from softcal.core.use.learning import UseLearner
from softcal.core.use.method import JumpConfig, UseMethod
from softcal.core.use.observation import HELD, JUMPED, PRELOAD_GONE, REST_MOVED, TRIED, USE_CHANGED, TrackerState
from softcal.core.use.trust import movement


@dataclass(frozen=True, eq=False)
class JumpReaction:
    """What becomes of a cycle that changed suddenly; the filter stays at the old place where none is measured."""

    verdict: str
    reason: str
    measured: DriftFilter | None = None


class SuddenChanges:
    """Finds sudden changes and reacts to them, in the state of a tracker.

    Args:
        memory: cycles over which the gain that came with a re-seating is found.
        learner: of new activities; None where every cycle is compared with the calibration recording alone.
    """

    def __init__(self, use: CalibratedUse, method: UseMethod, memory: float, learner: UseLearner | None) -> None:
        self._use, self._method, self._memory, self._learner = use, method, memory, learner

    def surprise(self, now: TrackerState, cycle: Cycle, index: int) -> tuple[Array, Array]:
        """Return the innovation: measured drift less the predicted one, and its covariance."""
        activity = now.activities[index]
        mean, covariance = now.filter.seen_by(index)
        return activity.drift_of(cycle, self._use.rest_is_low) - mean, covariance + activity.noise

    def is_jump(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle is not where drift takes it: too far off, or of another size in a machine's use."""
        return self._is_too_far(now, cycle, index) or self._is_programme(now, cycle, index)

    def _is_too_far(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether the innovation of a cycle, at its rest or in its log gain, is too large for drift."""
        config = self._method.jump
        surprise, expected = self.surprise(now, cycle, index)
        gain = np.exp(now.filter.drift[1])
        # From (shift, log gain) to (movement of the rest, log gain): use moves the shift, but no rest.
        sight = np.array([[1.0, gain * now.activities[index].rest], [0.0, 1.0]])
        sigma = np.sqrt(np.diag(sight @ expected @ sight.T))
        return bool(np.any(np.abs(sight @ surprise) > np.maximum(config.sigmas * sigma, config.floor)))

    def _is_programme(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether the size of a cycle stepped from that of the ones before, in a use that a machine times.

        A drift gets there little by little.
        """
        activity = now.activities[index]
        if not activity.is_imposed or now.recent_of != index or not now.recent:
            return False
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
        level = self._level(now, cycle, activity)
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
        stands = min(abs(moved), abs(moved - crept)) <= max(config.floor[0], config.rest_sigmas * activity.rest_scatter)
        if stands or now.trust.is_lighter(activity, drift, step):
            now.unresolved = 0.0
            if not stands:
                now.stray = max(now.stray, math.sqrt(1 - self._method.trust.use_share) * abs(moved))
            if self._learner is not None and len(now.jumps) == config.most and self._learner.learn(now, now.jumps):
                now.jumps.clear()
            return JumpReaction(HELD, USE_CHANGED if stands else PRELOAD_GONE)
        before, after = drift[0], drift[0] + moved
        is_far = abs(moved) > config.largest[0] and abs(after) >= abs(before)
        if is_far or abs(after) > self._method.drift.largest[0]:
            now.alarm = "a sudden change larger than is ever followed; check the sensor and its mounting"
            return JumpReaction(HELD, now.alarm)
        return self._follow(now, index, level, moved)

    def _level(self, now: TrackerState, cycle: Cycle, activity: Activity) -> Array:
        """Add a cycle to the like ones since a jump; return the drift they show."""
        config = self._method.jump
        measured = activity.drift_of(cycle, self._use.rest_is_low)
        before = [activity.drift_of(c, self._use.rest_is_low) for c in now.jumps[-config.most + 1 :]]
        # The difference of two cycles has twice the variance of one.
        apart = config.sigmas * np.sqrt(2 * np.diag(activity.noise))
        # A cycle unlike the others starts the count anew: the change was not over yet.
        if before and np.any(np.abs(measured - np.mean(before, axis=0)) > apart):
            before = []
        now.jumps = [*now.jumps[len(now.jumps) - len(before) :], cycle]
        return np.asarray(np.mean([*before, measured], axis=0))

    def _follow(self, now: TrackerState, index: int, level: Array, moved: float) -> JumpReaction:
        """Follow a re-seating; of one with more gain than its rest vouches for, the rest alone."""
        config, activity = self._method.jump, now.activities[index]
        seen = now.filter.seen_by(index)[0]
        reason = "the rest and all levels moved at once: re-seated"
        if abs(level[1] - seen[1]) > now.trust.gain_per_shift(activity.rest) * abs(moved):
            level = seen + np.array([moved, 0.0])
            reason = "the rest moved at once, and the use changed with it: re-seated"
        # Wide process noise lets the filter go to the new place at once instead of averaging over old cycles.
        free = now.filter.moved(np.diag((np.array(config.largest) / config.largest_sigmas) ** 2))
        now.trust = now.trust.reseated(now.filter.drift, now.seen, moved, round(self._memory))
        now.trend, now.to_settle, now.recent = np.zeros_like(now.trend), 0, []
        return JumpReaction(JUMPED, reason, free.measured(index, level, activity.noise / config.cycles))

    def try_rest(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Follow the rest of one cycle until the next one, where it shows a re-seating."""
        activity, zero = now.activities[index], now.trust.zero
        # Harder use moves the turning point of a preloaded sensor, though not its output at zero load.
        if zero is None or abs(activity.rest - zero) > self._method.activity.rest_scatter:
            return False
        step = _rest_step(cycle, activity, now.filter.drift, self._use.rest_is_low, self._method.jump)
        now.trial = step if abs(now.filter.drift[0] + step) <= self._method.drift.largest[0] else 0.0
        return now.trial != 0

    def is_like_but_for_shape(self, now: TrackerState, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle took as long as those of an activity and swung about as far, whatever its shape."""
        activity = now.activities[index]
        longer = np.log(cycle.duration_s) - activity.log_duration
        larger = np.log(cycle.scale) - activity.log_scale - now.filter.drift[1]
        return bool(abs(longer) <= activity.tolerance[2] and abs(larger) <= self._method.jump.largest[1])


def _rest_step(cycle: Cycle, activity: Activity, drift: Array, rest_is_low: bool, config: JumpConfig) -> float:
    """Return how far the rest of a cycle is from where it was expected, 0 where that is no re-seating."""
    step = cycle.rest(rest_is_low) - activity.rest - movement(drift, activity.rest)
    floor = config.floor[0]
    least = max(floor, config.rest_sigmas * activity.rest_scatter)
    # The rest of a use that has none, or that moves as far as ever, shows nothing.
    if not activity.has_rest or not least < abs(step) <= config.largest[0]:
        return 0.0
    end = slice(0, config.end_quantiles) if rest_is_low else slice(-config.end_quantiles, None)
    # A rest of two levels, one before and one after the move, is spread more than a usual rest.
    unsteady = cycle.scale * float(np.ptp(cycle.shape[end]))
    usual = float(np.exp(activity.log_scale + drift[1]) * np.ptp(activity.shape[end]))
    return float(step) if unsteady <= usual + floor / 2 else 0.0
