"""New uses: learnt from cycles of no known one with the drift taken out, and what their rest says of the sensor."""

import math
from dataclasses import replace

import numpy as np

from softcal.core.use.activity import Activity, CalibratedUse, Lesson, learn_activity
from softcal.core.use.cycles import Cycle
from softcal.core.use.method import UseMethod
from softcal.core.use.observation import TrackerState


class UseLearner:
    """Learns activities into the state of a tracker."""

    def __init__(self, use: CalibratedUse, method: UseMethod) -> None:
        self._use, self._method = use, method

    def take(self, now: TrackerState, cycle: Cycle) -> bool:
        """Take one more cycle of no known activity; return whether a new one was learnt with it."""
        config = self._method.learning
        now.strangers = [*now.strangers[-config.most_cycles + 1 :], cycle]
        now.stray = max(now.stray_before, self._stray(now, now.strangers))
        span_s = cycle.end_s - now.strangers[0].end_s
        is_long = span_s >= config.length * self._use.duration_s or len(now.strangers) == config.most_cycles
        enough = config.cycles if now.joined == 1 else config.joined_cycles
        if len(now.strangers) >= enough and is_long and self.learn(now, now.strangers):
            now.strangers.clear()
            return True
        most = config.most_cycles if now.joined == 1 else enough
        if not now.activities and is_long and len(now.strangers) >= most:
            self._join_more(now)
        return False

    def learn(self, now: TrackerState, cycles: list[Cycle]) -> bool:
        """Learn an activity from cycles with the drift known now taken out."""
        shift, gain = float(now.filter.drift[0]), float(np.exp(now.filter.drift[1]))
        # The drift known now is taken out first, or it would become part of what the activity is compared with.
        calibrated = [c.standardised(shift, gain) for c in cycles]
        lesson = learn_activity(calibrated, self._use.rest_is_low, self._method.activity, self._use.curve)
        activity = lesson.activity
        if activity is None:
            return False
        if not now.activities:
            now.missed = self._moved_meanwhile(now, lesson, activity)
        # The calibrated activity is never forgotten: it alone knows the zero of the drift.
        if len(now.activities) == self._method.learning.activities:
            oldest = 1 if self._use.lesson.activity is not None else 0
            del now.activities[oldest]
            now.filter = now.filter.without(oldest)
        is_imposed = activity.is_imposed and len(cycles) >= self._method.activity.machine_cycles
        now.activities.append(replace(activity, is_imposed=is_imposed))
        now.stray_before = now.stray
        now.filter = now.filter.with_learnt(activity.doubt)
        now.latest, now.recent = len(now.activities) - 1, []
        return True

    def _join_more(self, now: TrackerState) -> None:
        """Take more cycles together: means over several random presses are alike where single presses are not."""
        more = [count for count in self._method.cycle.joined if count > now.joined]
        if more:
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

    def _moved_meanwhile(self, now: TrackerState, lesson: Lesson, activity: Activity) -> float:
        """Return how far level and scale surely moved until a first activity was learnt, in scales."""
        during = now.trust.sure_size(lesson.trend, lesson.trend_sd)
        if not now.opening_sd:
            return during
        since = np.array([activity.level - now.opening])
        sd = np.array([math.hypot(now.opening_sd, math.sqrt(activity.doubt[0, 0]))])
        return math.hypot(during, now.trust.sure_size(since, sd))

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
        return math.sqrt(1 - trust.use_share) * max(0.0, sure - max(turning, trust.step))

    def _beyond(self, now: TrackerState, cycles: list[Cycle]) -> tuple[float, float, float]:
        """Return where the rest of cycles lies against zero load and any known rest, in scales of the calibrated use.

        Beyond the nearest one, positive on the loaded side, 0 between them; the standard deviation of the mean rest;
        and how far the unloaded ends spread: a use that turns without resting stays off zero by it.
        """
        use, config = self._use, self._method.jump
        levels = [a.rest for a in now.activities if a.has_rest] + ([] if use.zero is None else [use.zero])
        levels.append(((use.low if use.rest_is_low else use.high) - use.mean) / use.scale)
        expected = float(now.filter.drift[0]) + float(np.exp(now.filter.drift[1])) * np.array(levels)
        rests = np.array([cycle.rest(use.rest_is_low) for cycle in cycles])
        away = min(float(rests.mean() - expected.min()), 0.0) + max(float(rests.mean() - expected.max()), 0.0)
        end = slice(0, config.end_quantiles) if use.rest_is_low else slice(-config.end_quantiles, None)
        turning = float(np.mean([cycle.scale * np.ptp(cycle.shape[end]) for cycle in cycles]))
        return away if use.rest_is_low else -away, float(rests.std()) / len(rests) ** 0.5, turning
