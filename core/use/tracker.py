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

from softcal.core.recording import Array
from softcal.core.use.activity import CalibratedUse, timing_regularity, trend_sd
from softcal.core.use.changes import Changes
from softcal.core.use.cycles import Cycle
from softcal.core.use.doubt import Doubt, Evidence, doubt
from softcal.core.use.filter import DriftFilter
from softcal.core.use.method import UseMethod
from softcal.core.use.observation import (
    FOLLOWED,
    HELD,
    NOT_WATCHED,
    PRELOADED,
    REST_MOVED,
    TRIED,
    UNWATCHED,
    USE_OR_GAIN,
    Observation,
    TrackerState,
)
from softcal.core.use.state_json import restored, state_of
from softcal.core.use.trust import Trust


class DriftTracker:
    """Follows the drift of one unit, cycle by cycle; learns new activities from the best estimates so far."""

    def __init__(self, use: CalibratedUse, method: UseMethod = UseMethod()) -> None:  # noqa: B008 - frozen
        self._use, self._method = use, method
        known, drift = use.lesson.activity, method.drift
        # Without a calibrated activity the drift is counted from the first one learnt.
        state = DriftFilter.start(np.array(drift.start_doubt) * (known is not None))
        if known is not None:
            state = state.with_independent(known.doubt)
        # A trend seen in the calibration recording itself may go on.
        spread = np.array(drift.prior) ** 2 + use.lesson.trend**2 * (known is not None)
        self._walk = np.diag(spread) / use.duration_s
        self._drift_share = 0.0
        if known is not None:
            # What moved while a machine repeated its loads was the sensor, beyond what its least scatter makes of one.
            chance = float(trend_sd(method.activity.least_scatter, 1))
            sure = Trust(use.zero, config=method.trust).sure_size(use.lesson.trend, use.lesson.trend_sd)
            self._drift_share = known.regularity * sure**2 / (sure**2 + chance**2)
        self._overdue_s = method.cycle.overdue * use.usual_s
        self._changes = Changes(use, method)
        self._settling = max(1, math.ceil(method.intake.settling / use.usual))
        self._now = TrackerState(
            filter=state,
            trust=Trust(use.zero, config=method.trust),
            activities=[] if known is None else [known],
            to_settle=self._settling,
            trend=np.zeros((2, 2)),
            carried=np.zeros(2),
            believed=np.zeros(2),
            strangers=[],
            jumps=[],
        )

    @property
    def alarm(self) -> str:
        """Why a calibration with a reference is due; empty while it is not."""
        return self._now.alarm

    @property
    def is_unsettled(self) -> bool:
        """Whether a sudden change waits for more cycles to say what it was."""
        return self._now.unresolved > 0

    @property
    def is_learning(self) -> bool:
        """Whether no use is known yet that could be compared with."""
        return not self._now.activities

    @property
    def least_s(self) -> float:
        """Seconds that a cycle must last at least, shorter ones being joined; 0 while single cycles are compared."""
        return self._now.joined * self._now.single_s

    def observe(self, cycle: Cycle) -> Observation:
        """Take one cycle of the raw output."""
        now = self._now
        now.first_s = cycle.end_s if now.first_s is None else now.first_s
        walked = self._walked(cycle.end_s)
        now.filter = now.filter.moved(walked)
        now.last_s, now.trial = cycle.end_s, 0.0
        if cycle.is_complete:
            now.timing = [*now.timing[-self._method.activity.machine_cycles + 1 :], math.log(cycle.duration_s)]
        # Free motion without return is no cycle; what it shows of the level says nothing about the sensor.
        if not cycle.is_complete:
            now.strangers.clear()
            now.was_known = False
            return self._held(cycle, "no cycle of use was completed in the longest time one may take")
        standard = cycle.standardised(self._use.mean, self._use.scale)
        candidates = [k for k, activity in enumerate(now.activities) if activity.strangeness(standard) <= 1]
        # A cycle of no known activity is not like the calibrated ones.
        likeness = now.activities[0].likeness(standard) if candidates else 0.0
        now.likeness += (likeness - now.likeness) / self._method.drift.memory_cycles
        if not candidates:
            return self._meet_stranger(standard)
        now.strangers.clear()
        now.stray, now.away = now.stray_before, 0.0
        now.was_known = True
        # Use goes on as it was more often than it changes: of several that fit the latest, unless only another does.
        candidates.sort(key=lambda k: k != now.latest)
        fitting = [k for k in candidates if not self._changes.is_jump(now, standard, k)]
        return self._compare(standard, (fitting or candidates)[0], walked)

    def start(self) -> Observation:
        return self._observation(0.0, HELD, "", -1)

    def reconnect(self) -> None:
        """Allow for what may have happened in an interruption of unknown length."""
        now = self._now
        now.last_s, now.trial, now.was_known = None, 0.0, False
        now.carried, now.to_settle = now.applied, self._settling
        now.filter = now.filter.moved(np.diag(np.array(self._method.drift.start_doubt) ** 2))
        now.jumps.clear()
        now.strangers.clear()

    def expire(self, t_s: float) -> None:
        """End a trial whose next cycle is overdue by a time."""
        if self._now.last_s is not None and t_s - self._now.last_s > self._overdue_s + self.least_s:
            self._now.trial = 0.0

    def _walked(self, t_s: float) -> Array:
        """Return the (2, 2) process noise since the last cycle."""
        return self._walk * (0.0 if self._now.last_s is None else max(0.0, t_s - self._now.last_s))

    def correction(self) -> tuple[float, float]:
        """Return gain and offset that carry the output now to the output at calibration, as far as evidence goes."""
        shift, log_gain = self._now.applied
        gain = float(np.exp(-log_gain))
        return gain, self._use.mean - gain * float(self._use.mean + self._use.scale * shift)

    def doubt_at(self, t_s: float) -> Doubt:
        """Return how wrong the corrected output may be at a time."""
        now = self._now
        drift, applied = now.filter.drift, now.applied
        lengths = min(1.0, now.unseen_s / self._use.duration_s)
        unseen = self._method.jump.sigmas * self._method.drift.unseen * lengths
        lag = 0.0
        if now.activities:
            # The larger mean innovation beyond chance: how far the filter is behind a drift.
            weight = np.array(self._method.drift.trend_weight)
            expected = float(np.trace(now.filter.seen_by(now.latest)[1] + now.activities[now.latest].noise))
            chance = self._method.doubt.certain * expected * weight / (2 - weight)
            lag = math.sqrt(max(0.0, float(np.max(np.sum(now.trend**2, axis=1) - chance))))
        return doubt(
            Evidence(
                drift=drift,
                applied=applied,
                chance=float(np.trace(now.filter.doubt())),
                walked=float(np.trace(self._walked(t_s))),
                moved=now.trust.moved,
                use_doubt=now.trust.use_doubt(drift, applied - now.sensor),
                unseen=unseen,
                is_learning=self._is_learning(t_s),
                unresolved=now.unresolved,
                missed=now.missed,
                stray=now.stray,
                away=now.away,
                lag=lag,
            ),
            self._method.doubt,
        )

    def _is_learning(self, t_s: float) -> bool:
        """Return whether no use is known yet, and the time in which one may be learnt is not over."""
        now = self._now
        if now.activities or now.first_s is None:
            return False
        return t_s - now.first_s < self._method.learning.first_use_s

    def _compare(self, cycle: Cycle, index: int, walked: Array) -> Observation:
        now = self._now
        activity = now.activities[index]
        if self._changes.is_jump(now, cycle, index) or self._changes.is_like_jumps(now, cycle, index):
            met = self._changes.meet(now, cycle, index)
            if met.verdict == HELD:
                return self._held(cycle, met.reason, index)
            if met.measured is not None:
                self._accept(met.measured, index)
            return self._observation(cycle.end_s, met.verdict, met.reason, index)
        # One cycle within reach of the old use does not end another: after several the others are forgotten.
        jumps = now.jumps[: len(now.jumps) // 2]
        surprise, expected = self._changes.surprise(now, cycle, index)
        # Process noise R / n^2 makes the steady filter average over about n cycles.
        # Shift and log gain lag alike: where one lags more, a use that grows slowly reads as a sensor that drifts.
        share = self._pace(surprise, expected) / self._method.drift.memory_cycles**2
        share += float(np.max(np.diag(walked) / np.diag(activity.noise)))
        moving = now.filter.moved(share * activity.noise - walked)
        measured = moving.measured(index, activity.drift_of(cycle, self._use.rest_is_low), activity.noise)
        # Beyond this the map was never tested; an estimate there would be extrapolated twice.
        if np.any(np.abs(measured.drift) > self._method.drift.largest):
            now.alarm = "the drift has left the range that is followed"
            return self._held(cycle, now.alarm, index)
        now.activities[index] = activity.refreshed(cycle, 1 / self._method.drift.memory_cycles)
        # A person who has just put the sensor on presses otherwise for a while.
        now.to_settle = max(0, now.to_settle - 1)
        # The log gain of the last few cycles of one activity.
        before = now.recent if now.recent_of == index else []
        log_gain = float(now.activities[index].drift_of(cycle, self._use.rest_is_low)[1])
        now.recent, now.recent_of = [*before[-self._method.activity.min_cycles + 1 :], log_gain], index
        self._accept(measured, index)
        now.jumps = jumps
        if now.trust.is_use_as_likely(now.filter.drift, now.seen, now.applied):
            return self._observation(cycle.end_s, HELD, USE_OR_GAIN, index)
        is_preload = now.trust.may_be_preload and np.any(now.applied)
        return self._observation(cycle.end_s, FOLLOWED, PRELOADED if is_preload else "", index)

    def _accept(self, measured: DriftFilter, index: int) -> None:
        now = self._now
        now.believed = now.believed + self._belief() * (measured.drift - now.filter.drift)
        now.filter, now.latest, now.unseen_s = measured, index, 0.0
        # A use that was known before the latest was learnt shows where the sensor is.
        if index < len(now.activities) - 1:
            now.stray = now.stray_before = 0.0
        activity = now.activities[index]
        # A person may go on with what a machine was calibrated with.
        is_timed = len(now.timing) >= self._method.activity.min_cycles and self._regularity() > 0
        known = activity if is_timed else replace(activity, regularity=0.0)
        now.trust = now.trust.after(known, measured.drift, now.seen, 1 / self._settling)
        now.jumps.clear()
        now.alarm, now.unresolved = "", 0.0

    def _belief(self) -> float:
        """Return the weight of drift against use for what cycles show now, 0 to 1.

        It is the product of how surely the sensor drifted while it was calibrated, how like the calibrated ones the
        latest cycles are, and how regularly they come.
        """
        return self._drift_share * self._now.likeness * self._regularity()

    def _regularity(self) -> float:
        return timing_regularity(np.array(self._now.timing), self._method.activity)

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

    def _meet_stranger(self, cycle: Cycle) -> Observation:
        now = self._now
        now.jumps.clear()
        was_known, now.was_known, now.unresolved = now.was_known, False, 0.0
        # A shift that may have come in use nobody compared is in doubt for every use that is learnt from it. A gain is
        # not: the next cycle within reach, of a larger or a smaller use, would be taken for one.
        unseen = self._method.drift.unseen**2 * cycle.duration_s / self._use.duration_s
        now.filter = now.filter.moved(np.diag([unseen, 0.0]))
        # A sensor re-seated in the midst of a cycle gives it another shape.
        if was_known and self._changes.is_like_but_for_shape(now, cycle, now.latest):
            if self._changes.try_rest(now, cycle, now.latest):
                now.unresolved = abs(now.trial)
                return self._observation(cycle.end_s, TRIED, REST_MOVED, -1)
        if not self._changes.take(now, cycle):
            return self._held(cycle, "the use is none of those known")
        learnt = self._held(cycle, "a new use was learnt from the estimates so far", len(now.activities) - 1)
        if len(now.activities) == 1:
            # The drift is counted from the first activity: nothing of it came before.
            now.unseen_s = 0.0
        return learnt

    def _held(self, cycle: Cycle, reason: str, index: int = -1) -> Observation:
        self._now.unseen_s += cycle.duration_s
        if self._is_learning(cycle.end_s):
            return self._observation(cycle.end_s, UNWATCHED, NOT_WATCHED, index)
        return self._observation(cycle.end_s, HELD, reason, index)

    def _observation(self, t_s: float, verdict: str, reason: str, index: int) -> Observation:
        shift, log_gain = self._now.filter.drift.tolist()
        shift_sd, log_gain_sd = np.sqrt(np.diag(self._now.filter.doubt())).tolist()
        return Observation(t_s, verdict, reason, shift, log_gain, shift_sd, log_gain_sd, index)

    def state(self) -> dict[str, object]:
        return state_of(self._now)

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state()` taken earlier.

        Raises:
            InputError: it was taken by a version that keeps other things in it.
        """
        restored_state = restored(TrackerState, state)
        # The thresholds are this method's, not those the state was taken with.
        self._now = replace(restored_state, trust=replace(restored_state.trust, config=self._method.trust))
