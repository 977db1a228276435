"""How far a sensor has drifted since its calibration, from the cycles of its use; and when that cannot be told.

With m and s the mean and scale of the calibrated use, drift is a shift mu and a log gain lambda,

    (output - m) / s = mu + exp(lambda) (calibrated output - m) / s,

followed over cycles by a random-walk filter (Kalman 1960). Its measurement noise is what cycles of one activity differ
by; its measurements are the cycles whose standardised distribution, speed and duration are those of a known activity.
A change of use alters these; a drift of the sensor does not.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.activity import REST_SCATTER, Activity, CalibratedUse, learn_activity
from softcal.core.use.cycles import OVERDUE, Cycle
from softcal.core.use.filter import DriftFilter
from softcal.core.use.reseating import is_like_but_for_shape, rest_step
from softcal.core.use.trust import Trust, gain_per_shift, movement

DRIFT_PRIOR = np.array([0.02, 0.012])
"""Standard deviation of the drift over a time as long as the calibration recording, before any is seen."""

START_DOUBT = np.array([0.10, 0.05])
"""Standard deviation of what may have happened between the calibration and the start of a stream."""

STEADY_MEMORY, STEADY_SAMPLES = 20, 2560
"""Cycles, and samples, that a drift at rest is averaged over at least."""

SETTLING_SAMPLES = 256
"""So many samples of known use after a start, and of a rest that moved, are looked at before they count."""

TREND_WEIGHT = 0.1
"""Weight of the newest cycle in the mean surprise, which tells a drift under way from chance."""

PACE = 12.0
"""A mean surprise is chance while its squared distance from zero is below this; 2 is its mean without a drift."""

FASTEST = 400.0
"""A drift under way is followed with up to this many times the variance of one at rest."""

CORRECTION_DOUBT, WAY_DOUBT = 0.2, 0.12
"""Shares of a correction, and of the way the rest has gone in all, that are doubted however well they are known.

Drift is neither affine nor all of it seen, and a sensor that is on its way is followed late.
"""

UNSEEN_DRIFT = 0.15
"""Drift in scales that may have come, unseen, in held use as long as the calibration recording, and stays so much."""

JUMP_SIGMAS, JUMP_FLOOR = 4.0, np.array([0.08, 0.12])
"""A cycle whose rest or log gain is further than both from what was expected is a jump; so far a rest has moved."""

JUMP_CYCLES, MOST_JUMPS = 2, 8
"""So many like cycles after a jump decide what it was; so many are kept while they cannot."""

LARGEST_JUMP, LARGEST_DRIFT = np.array([1.0, 0.35]), np.array([1.5, 0.6])
"""The trust region: no jump and no drift beyond these is ever followed."""

NEW_ACTIVITY_CYCLES, MOST_STRANGERS = 6, 64
NEW_ACTIVITY_SHARE = 0.25
"""A new activity is learnt from at least so many cycles over this share of the calibration recording's length."""

MAX_ACTIVITIES = 3
REFRESH = 0.05
"""Weight of the newest cycle in the moving shape of an activity (improved mode)."""

FOLLOWED, HELD, TRIED, JUMPED = "followed", "held", "tried", "jumped"
REST_MOVED = "the rest moved at once; the next cycles decide what it is"
USE_OR_GAIN = "the cycles changed in size about a rest that stands: use or gain, which only a reference can tell"


@dataclass(frozen=True)
class Observation:
    """What one cycle said.

    Args:
        t_s: end of the cycle.
        verdict: `followed`, `held`, `tried` or `jumped`.
        reason: why, in words; empty where the drift was followed.
        shift, log_gain: drift after it, in scales of the calibrated use.
        shift_sd, log_gain_sd: their standard deviations.
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


class DriftTracker:
    """Follows the drift of one unit, cycle by cycle.

    Args:
        use: what the calibration recording taught.
        is_improved: whether new activities are learnt from the best estimates so far, and shapes may move; otherwise
            every cycle is compared with the calibration recording alone.
    """

    def __init__(self, use: CalibratedUse, is_improved: bool) -> None:
        self._use, self._is_improved = use, is_improved
        known = use.lesson.activity
        self._has_calibrated = known is not None
        self._activities = [] if known is None else [known]
        # Without a calibrated activity the drift is counted from the first one learnt.
        self._filter = DriftFilter.start(START_DOUBT * self._has_calibrated)
        if known is not None:
            self._filter = self._filter.with_independent(known.doubt)
        self._walk = np.diag(DRIFT_PRIOR**2 + use.lesson.trend**2 * self._has_calibrated) / use.duration_s
        self._overdue_s = OVERDUE * use.usual_s
        self._memory = max(STEADY_MEMORY, STEADY_SAMPLES / use.usual)
        self._trend = np.zeros(2)
        self._trust = Trust(use.zero)
        self._settling = max(1, math.ceil(SETTLING_SAMPLES / use.usual))
        self._to_settle, self._carried = self._settling, np.zeros(2)
        self._latest = 0
        self._last_s: float | None = None
        self._strangers: list[Cycle] = []
        self._jumps: list[Cycle] = []
        self._trial, self._was_known = 0.0, False
        self._unseen_s = 0.0
        self.alarm = ""
        self.unresolved = 0.0

    def observe(self, cycle: Cycle) -> Observation:
        """Take one cycle of the raw output."""
        self._filter = self._filter.moved(self._walked(cycle.end_s))
        self._last_s, self._trial = cycle.end_s, 0.0
        if not cycle.is_complete:
            self._strangers.clear()
            self._was_known = False
            return self._held(cycle, "no cycle of use was completed in the longest time one may take")
        standard = cycle.standardised(self._use.mean, self._use.scale)
        index = self._recognise(standard)
        if index < 0:
            return self._meet_stranger(standard)
        self._strangers.clear()
        self._was_known = True
        return self._compare(standard, index)

    @property
    def is_unsettled(self) -> bool:
        """Whether a sudden change waits for more cycles to say what it was."""
        return self.unresolved > 0

    def start(self) -> Observation:
        """Return what is known before the first cycle."""
        shift_sd, log_gain_sd = np.sqrt(np.diag(self._filter.doubt())).tolist()
        return Observation(0.0, HELD, "", 0.0, 0.0, shift_sd, log_gain_sd, -1)

    def reconnect(self) -> None:
        """Allow for what may have happened in an interruption of unknown length."""
        self._last_s, self._trial, self._was_known = None, 0.0, False
        self._carried, self._to_settle = self._applied(), self._settling
        self._filter = self._filter.moved(np.diag(START_DOUBT**2))
        self._jumps.clear()
        self._strangers.clear()

    def expire(self, t_s: float) -> None:
        """End a trial whose next cycle is overdue by a time."""
        if self._last_s is not None and t_s - self._last_s > self._overdue_s:
            self._trial = 0.0

    def _walked(self, t_s: float) -> Array:
        """Return the (2, 2) variance of what drift may have come since the last cycle."""
        return self._walk * (0.0 if self._last_s is None else max(0.0, t_s - self._last_s))

    def correction(self) -> tuple[float, float]:
        """Return gain and offset that carry the output now to the output at calibration, as far as evidence goes."""
        shift, log_gain = self._applied()
        gain = float(np.exp(-log_gain))
        return gain, self._use.mean - gain * float(self._use.mean + self._use.scale * shift)

    def doubt_at(self, t_s: float) -> tuple[float, float]:
        """Return two standard deviations of the drift left in the corrected output, in scales of the calibrated use.

        Both hold the doubt about what was applied, a share of it and of the way of the rest, that its gain was use,
        what a jump left open, and what may have come unseen. The first also holds all that was seen but not applied,
        and is for intervals; the second of what is beyond chance only as much as is as likely drift as use, and is for
        the predicted error.
        """
        drift, applied = self._filter.drift, self._applied()
        chance = float(np.trace(self._filter.doubt()))
        left = float(np.sum((drift - applied) ** 2))
        share = float(np.linalg.norm(applied)) / max(float(np.linalg.norm(drift)), 1e-12)
        known = share**2 * chance + CORRECTION_DOUBT**2 * float(applied @ applied)
        known += (WAY_DOUBT * self._trust.moved) ** 2 + self._trust.use_doubt(drift, applied)
        unseen = UNSEEN_DRIFT * min(1.0, self._unseen_s / self._use.duration_s)
        common = known + float(np.trace(self._walked(t_s))) + unseen**2 + self.unresolved**2
        beyond = (1 - self._trust.use_share) * max(0.0, left - chance)
        return float(np.sqrt(common + left)), float(np.sqrt(common + beyond))

    def _applied(self) -> Array:
        if self._to_settle:
            return self._carried
        applied = self._trust.applied(self._filter.drift, self._seen())
        return np.asarray(applied + np.array([self._trial, 0.0]))

    def _seen(self) -> Array:
        """Return the (2, 2) covariance of the drift as the latest activity shows it."""
        return self._filter.seen_by(self._latest)[1] if self._activities else self._filter.doubt()

    def _recognise(self, cycle: Cycle) -> int:
        """Return the activity a cycle belongs to, -1 for none; of several the latest, unless only another fits."""
        candidates = [k for k, activity in enumerate(self._activities) if activity.strangeness(cycle) <= 1]
        candidates.sort(key=lambda k: k != self._latest)
        fitting = [k for k in candidates if not self._is_jump(cycle, k)]
        return (fitting or candidates or [-1])[0]

    def _is_jump(self, cycle: Cycle, index: int) -> bool:
        """Return whether the rest or the gain a cycle shows is no drift, nor what cycles differ by."""
        surprise, expected = self._surprise(cycle, index)
        gain = np.exp(self._filter.drift[1])
        sight = np.array([[1.0, gain * self._activities[index].rest], [0.0, 1.0]])
        sigma = np.sqrt(np.diag(sight @ expected @ sight.T))
        return bool(np.any(np.abs(sight @ surprise) > np.maximum(JUMP_SIGMAS * sigma, JUMP_FLOOR)))

    def _is_like_jumps(self, cycle: Cycle, index: int) -> bool:
        """Return whether a cycle is nearer to those since a change of use than to what was expected.

        Were those of a changed use followed that happen to be within reach, they would drag the drift after the use.
        """
        if len(self._jumps) < JUMP_CYCLES:
            return False
        activity, (surprise, _) = self._activities[index], self._surprise(cycle, index)
        drifts = [activity.drift_of(c, self._use.rest_is_low) for c in (*self._jumps, cycle)]
        apart = drifts[-1] - np.mean(drifts[:-1], axis=0)
        near, far = (float(d @ np.linalg.solve(activity.noise, d)) for d in (apart, surprise))
        return near < far

    def _surprise(self, cycle: Cycle, index: int) -> tuple[Array, Array]:
        """Return how far the drift a cycle shows is from the one expected, and the covariance of that."""
        mean, covariance = self._filter.seen_by(index)
        activity = self._activities[index]
        return activity.drift_of(cycle, self._use.rest_is_low) - mean, covariance + activity.noise

    def _compare(self, cycle: Cycle, index: int) -> Observation:
        activity = self._activities[index]
        if self._is_jump(cycle, index) or self._is_like_jumps(cycle, index):
            return self._meet_jump(cycle, index)
        self._jumps.clear()
        surprise, expected = self._surprise(cycle, index)
        moving = self._filter.moved(self._pace(surprise, expected) * activity.noise / self._memory**2)
        measured = moving.measured(index, activity.drift_of(cycle, self._use.rest_is_low), activity.noise)
        if np.any(np.abs(measured.drift) > LARGEST_DRIFT):
            self.alarm = "the drift has left the range that is followed"
            return self._held(cycle, self.alarm, index)
        if self._is_improved:
            self._activities[index] = activity.refreshed(cycle, REFRESH)
        self._to_settle = max(0, self._to_settle - 1)
        self._accept(measured, index, 1 / self._settling)
        is_open = self._trust.is_use_as_likely(self._filter.drift, self._seen())
        return self._observation(cycle, FOLLOWED, USE_OR_GAIN if is_open else "", index)

    def _accept(self, measured: DriftFilter, index: int, weight: float) -> None:
        """Take a measurement for the drift."""
        self._filter, self._latest, self._unseen_s = measured, index, 0.0
        self._trust = self._trust.after(self._activities[index], measured.drift, self._seen(), weight)
        self._jumps.clear()
        self.alarm, self.unresolved = "", 0.0

    def _pace(self, surprise: Array, expected: Array) -> float:
        """Return how many times faster than at rest the drift is, from surprises that keep one sign."""
        self._trend = self._trend + TREND_WEIGHT * (surprise - self._trend)
        chance = TREND_WEIGHT / (2 - TREND_WEIGHT) * expected
        return float(np.clip(self._trend @ np.linalg.solve(chance, self._trend) / PACE, 1, FASTEST))

    def _meet_jump(self, cycle: Cycle, index: int) -> Observation:
        """Hold a sudden change until like cycles say what it was, then follow it or not."""
        activity = self._activities[index]
        level = self._jump_level(cycle, activity)
        step = level - self._filter.seen_by(index)[0]
        self.unresolved = float(np.hypot(*step))
        if len(self._jumps) < JUMP_CYCLES:
            if self._try(cycle, index):
                return self._observation(cycle, TRIED, REST_MOVED, index)
            return self._held(cycle, f"a sudden change; {JUMP_CYCLES} like cycles decide what it is", index)
        if np.any(np.abs(step) > LARGEST_JUMP) or np.any(np.abs(self._filter.drift + step) > LARGEST_DRIFT):
            self.alarm = "a sudden change larger than is ever followed; check the sensor and its mounting"
            return self._held(cycle, self.alarm, index)
        if not activity.has_rest:
            self.alarm = "a sudden change of sensor or use, which no known rest can tell apart"
            return self._held(cycle, self.alarm, index)
        moved = self._rest_moved(activity, step)
        if abs(moved) > max(JUMP_FLOOR[0], 4 * activity.rest_scatter):
            return self._follow_jump(cycle, index, level, moved)
        self.unresolved = 0.0
        if self._is_improved and len(self._jumps) == MOST_JUMPS and self._learn(self._jumps):
            self._jumps.clear()
        return self._held(cycle, "the rest is where it was: the use changed, not the sensor", index)

    def _jump_level(self, cycle: Cycle, activity: Activity) -> Array:
        """Add a cycle to the like ones since a jump; return the drift they show."""
        measured = activity.drift_of(cycle, self._use.rest_is_low)
        before = [activity.drift_of(c, self._use.rest_is_low) for c in self._jumps[-MOST_JUMPS + 1 :]]
        apart = JUMP_SIGMAS * np.sqrt(2 * np.diag(activity.noise))
        if before and np.any(np.abs(measured - np.mean(before, axis=0)) > apart):
            before = []
        self._jumps = [*self._jumps[len(self._jumps) - len(before) :], cycle]
        return np.asarray(np.mean([*before, measured], axis=0))

    def _try(self, cycle: Cycle, index: int) -> bool:
        """Follow the rest of one cycle until the next one, where it shows a re-seating."""
        activity, zero = self._activities[index], self._trust.zero
        # Harder use moves the turning point of a preloaded sensor, though not its output at zero load.
        if zero is None or abs(activity.rest - zero) > REST_SCATTER:
            return False
        bounds = (float(JUMP_FLOOR[0]), float(LARGEST_JUMP[0]))
        step = rest_step(cycle, activity, self._filter.drift, self._use.rest_is_low, bounds)
        self._trial = step if abs(self._filter.drift[0] + step) <= LARGEST_DRIFT[0] else 0.0
        return self._trial != 0

    def _rest_moved(self, activity: Activity, step: Array) -> float:
        """Return how far a jump moved the output at rest and at zero load alike, which no use does."""
        levels = [level for level in (activity.rest, self._trust.zero) if level is not None]
        drift = self._filter.drift
        moved = [movement(drift + step, level) - movement(drift, level) for level in levels]
        return min(moved, key=abs) if min(moved) * max(moved) > 0 else 0.0

    def _follow_jump(self, cycle: Cycle, index: int, level: Array, moved: float) -> Observation:
        """Follow a re-seating; of one with more gain than its rest vouches for, the rest alone."""
        seen = self._filter.seen_by(index)[0]
        reason = "the rest and all levels moved at once: re-seated"
        if abs(level[1] - seen[1]) > gain_per_shift(self._activities[index].rest) * abs(moved):
            level = seen + np.array([moved, 0.0])
            reason = "the rest moved at once, and the use changed with it: re-seated"
        free = self._filter.moved(np.diag((LARGEST_JUMP / 3) ** 2))
        self._trust = self._trust.reseated(self._filter.drift, self._seen(), moved, round(self._memory))
        self._trend, self._to_settle = np.zeros(2), 0
        self._accept(
            free.measured(index, level, self._activities[index].noise / JUMP_CYCLES), index, 1 / self._settling
        )
        return self._observation(cycle, JUMPED, reason, index)

    def _meet_stranger(self, cycle: Cycle) -> Observation:
        self._jumps.clear()
        was_known, self._was_known, self.unresolved = self._was_known, False, 0.0
        latest = self._latest
        # A sensor re-seated in the midst of a cycle gives it another shape.
        if was_known and is_like_but_for_shape(cycle, self._activities[latest], self._filter.drift, LARGEST_JUMP[1]):
            if self._try(cycle, latest):
                self.unresolved = abs(self._trial)
                return self._observation(cycle, TRIED, REST_MOVED, -1)
        if not self._is_improved:
            return self._held(cycle, "the use is not that of the calibration recording")
        self._strangers = [*self._strangers[-MOST_STRANGERS + 1 :], cycle]
        span_s = cycle.end_s - self._strangers[0].end_s
        is_long = span_s >= NEW_ACTIVITY_SHARE * self._use.duration_s or len(self._strangers) == MOST_STRANGERS
        if len(self._strangers) >= NEW_ACTIVITY_CYCLES and is_long and self._learn(self._strangers):
            self._strangers.clear()
            return self._held(cycle, "a new use was learnt from the estimates so far", len(self._activities) - 1)
        return self._held(cycle, "the use is none of those known")

    def _learn(self, cycles: list[Cycle]) -> bool:
        """Learn an activity from cycles with the drift known now taken out."""
        shift, gain = float(self._filter.drift[0]), float(np.exp(self._filter.drift[1]))
        calibrated = [c.standardised(shift, gain) for c in cycles]
        activity = learn_activity(calibrated, self._use.rest_is_low).activity
        if activity is None:
            return False
        if len(self._activities) == MAX_ACTIVITIES:
            oldest = 1 if self._has_calibrated else 0
            del self._activities[oldest]
            self._filter = self._filter.without(oldest)
        self._activities.append(activity)
        self._filter = self._filter.with_learnt(activity.doubt)
        self._latest = len(self._activities) - 1
        return True

    def _held(self, cycle: Cycle, reason: str, index: int = -1) -> Observation:
        self._unseen_s += cycle.duration_s
        return self._observation(cycle, HELD, reason, index)

    def _observation(self, cycle: Cycle, verdict: str, reason: str, index: int) -> Observation:
        shift, log_gain = self._filter.drift.tolist()
        shift_sd, log_gain_sd = np.sqrt(np.diag(self._filter.doubt())).tolist()
        return Observation(cycle.end_s, verdict, reason, shift, log_gain, shift_sd, log_gain_sd, index)

    def state(self) -> dict[str, object]:
        """Return all that a restart needs besides the calibrated use, as JSON values."""
        return {
            "filter": self._filter.state(),
            "trend": self._trend.tolist(),
            "latest": self._latest,
            "to_settle": self._to_settle,
            "carried": self._carried.tolist(),
            "trust": self._trust.state(),
            "last_s": self._last_s,
            "activities": [activity.state() for activity in self._activities],
            "strangers": [cycle.state() for cycle in self._strangers],
            "jumps": [cycle.state() for cycle in self._jumps],
            "trial": self._trial,
            "was_known": self._was_known,
            "unseen_s": self._unseen_s,
            "alarm": self.alarm,
            "unresolved": self.unresolved,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state()` taken earlier."""
        self._filter = DriftFilter.from_state(state["filter"])
        self._trend, self._latest = np.array(state["trend"]), int(state["latest"])
        self._to_settle, self._carried = int(state["to_settle"]), np.array(state["carried"])
        self._trust = Trust.from_state(state["trust"])
        self._last_s = state["last_s"]
        self._activities = [Activity.from_state(activity) for activity in state["activities"]]
        self._strangers = [Cycle.from_state(cycle) for cycle in state["strangers"]]
        self._jumps = [Cycle.from_state(cycle) for cycle in state["jumps"]]
        self._trial, self._was_known = float(state["trial"]), bool(state["was_known"])
        self._unseen_s = float(state["unseen_s"])
        self.alarm, self.unresolved = str(state["alarm"]), float(state["unresolved"])
