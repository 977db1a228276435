"""How far a sensor has drifted since its calibration, from the cycles of its use; and when that cannot be told.

With m and s the mean and scale of the calibrated use, drift is a shift mu and a log gain lambda,

    (output - m) / s = mu + exp(lambda) (calibrated output - m) / s,

followed over cycles by a random-walk filter (Kalman 1960). Its measurement noise is what cycles of one activity differ
by; its measurements are the cycles whose standardised distribution, speed and duration are those of a known activity.
A change of use alters these; a drift of the sensor does not.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softcal.core.adapt_activity import MIN_CYCLES, Activity, CalibratedUse, learn_activity
from softcal.core.adapt_cycle import Cycle
from softcal.core.recording import Array

DRIFT_PRIOR = np.array([0.02, 0.012])
"""Standard deviation of the drift over a time as long as the calibration recording, before any is seen."""

START_DOUBT = np.array([0.10, 0.05])
"""Standard deviation of what may have happened between the calibration and the start of a stream."""

STEADY_MEMORY = 20
"""Cycles that a drift at rest is averaged over."""

BIAS_WEIGHT = 0.1
"""Weight of the newest cycle in the mean surprise, which tells a drift under way from chance."""

PACE = 12.0
"""A mean surprise is chance while its squared distance from zero is below this; 2 is its mean without a drift."""

FASTEST = 400.0
"""A drift under way is followed with up to this many times the variance of one at rest."""

JUMP_SIGMAS, JUMP_FLOOR = 4.0, np.array([0.15, 0.12])
"""A cycle further than both from the drift expected is a jump."""

JUMP_CYCLES, MOST_JUMPS = 3, 8
"""So many like cycles after a jump decide what it was; so many are kept while they cannot."""

LARGEST_JUMP, LARGEST_DRIFT = np.array([1.0, 0.35]), np.array([1.5, 0.6])
"""The trust region: no jump and no drift beyond these is ever followed."""

PURE_SHIFT = 0.05
"""A jump that changes the gain by less than this left it alone."""

REST_MOVED = 0.10
"""The rest has moved when its level changed by more than this."""

NEW_ACTIVITY_CYCLES, MOST_STRANGERS = 6, 64
NEW_ACTIVITY_SHARE = 0.25
"""A new activity is learnt from at least so many cycles over this share of the calibration recording's length."""

MAX_ACTIVITIES = 3
REFRESH = 0.05
"""Weight of the newest cycle in the moving shape of an activity (improved mode)."""

SHRINK = (3.0, 5.0)
"""A drift of fewer standard deviations than the first is not applied, of more than the second in full."""

FOLLOWED, HELD, JUMPED = "followed", "held", "jumped"


@dataclass(frozen=True)
class Observation:
    """What one cycle said.

    Args:
        t_s: end of the cycle.
        verdict: `followed`, `held` or `jumped`.
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
        self._drift, self._covariance = np.zeros(2), np.diag(START_DOUBT**2)
        self._bias = np.zeros(2)
        known = use.lesson.activity
        self._has_calibrated = known is not None
        self._activities = [] if known is None else [known]
        self._walk = np.diag(DRIFT_PRIOR**2 + use.lesson.trend**2 * self._has_calibrated) / use.duration_s
        self._last_s: float | None = None
        self._strangers: list[Cycle] = []
        self._jumps: list[Cycle] = []
        self.alarm = ""
        self.unresolved = 0.0

    def observe(self, cycle: Cycle) -> Observation:
        """Take one cycle of the raw output."""
        self._covariance = self.covariance_at(cycle.end_s)
        self._last_s = cycle.end_s
        if not cycle.is_complete:
            self._strangers.clear()
            return self._held(cycle, "no cycle of use was completed in the longest time one may take")
        standard = cycle.standardised(self._use.mean, self._use.scale)
        index = self._recognise(standard)
        if index < 0:
            return self._meet_stranger(standard)
        self._strangers.clear()
        return self._compare(standard, index)

    def start(self) -> Observation:
        """Return what is known before the first cycle."""
        shift_sd, log_gain_sd = np.sqrt(np.diag(self._covariance)).tolist()
        return Observation(0.0, HELD, "", 0.0, 0.0, shift_sd, log_gain_sd, -1)

    def reconnect(self) -> None:
        """Allow for what may have happened in an interruption of unknown length."""
        self._covariance = self._covariance + np.diag(START_DOUBT**2)
        self._last_s = None
        self._jumps.clear()
        self._strangers.clear()

    def covariance_at(self, t_s: float) -> Array:
        """Return the (2, 2) covariance of shift and log gain at a later time without another cycle."""
        since_s = 0.0 if self._last_s is None else max(0.0, t_s - self._last_s)
        return np.asarray(self._covariance + self._walk * since_s)

    def correction(self) -> tuple[float, float]:
        """Return gain and offset that carry the output now to the output at calibration, as far as evidence goes."""
        shift, log_gain = self._applied()
        gain = float(np.exp(-log_gain))
        return gain, self._use.mean - gain * float(self._use.mean + self._use.scale * shift)

    def doubt_at(self, t_s: float) -> tuple[float, float]:
        """Return two standard deviations of the drift left in the corrected output, in scales of the calibrated use.

        Both hold the doubt about what was applied, what a jump left open, and what may have come since the last
        cycle. The first also holds all that was seen but not applied, and is for intervals; the second only what of
        it is beyond chance, and is for the predicted error.
        """
        applied = self._applied()
        chance = float(np.trace(self._covariance))
        left = float(np.sum((self._drift - applied) ** 2))
        share = float(np.linalg.norm(applied)) / max(float(np.linalg.norm(self._drift)), 1e-12)
        since = float(np.trace(self.covariance_at(t_s) - self._covariance))
        common = share**2 * chance + since + self.unresolved**2
        return float(np.sqrt(common + left)), float(np.sqrt(common + max(0.0, left - chance)))

    def _applied(self) -> Array:
        """Return the part of the drift that is sure enough.

        A log gain turns the output about the level where it is known best; the shift there and the log gain are
        independent, and each is judged by itself.
        """
        (shift_variance, mixed), (_, gain_variance) = self._covariance
        pivot = -mixed / gain_variance
        about_pivot = self._drift[0] + pivot * self._drift[1]
        shift = about_pivot * _sureness(about_pivot, shift_variance - mixed**2 / gain_variance)
        log_gain = self._drift[1] * _sureness(self._drift[1], gain_variance)
        return np.array([shift - pivot * log_gain, log_gain])

    def _recognise(self, cycle: Cycle) -> int:
        strangeness = [activity.strangeness(cycle) for activity in self._activities]
        best = int(np.argmin(strangeness)) if strangeness else -1
        return best if best >= 0 and strangeness[best] <= 1 else -1

    def _compare(self, cycle: Cycle, index: int) -> Observation:
        activity = self._activities[index]
        noise = activity.noise
        surprise = activity.drift_of(cycle, self._use.rest_is_low) - self._drift
        expected = self._covariance + noise + activity.anchor
        sigma = np.sqrt(np.diag(expected))
        if np.any(np.abs(surprise) > np.maximum(JUMP_SIGMAS * sigma, JUMP_FLOOR)):
            return self._meet_jump(cycle, index)
        self._jumps.clear()
        moving = self._covariance + self._pace(surprise, expected) * noise / STEADY_MEMORY**2
        gain = moving @ np.linalg.inv(moving + noise + activity.anchor)
        drift = self._drift + gain @ surprise
        if np.any(np.abs(drift) > LARGEST_DRIFT):
            self.alarm = "the drift has left the range that is followed"
            return self._held(cycle, self.alarm, index)
        if index == 0 and self._has_calibrated and np.any(np.abs(surprise) > 2 * sigma):
            # The calibrated use is back and disagrees: what was learnt meanwhile stands on a wrong drift.
            del self._activities[1:]
        self._drift = drift
        # An activity learnt in use knows the drift no better than it was known then.
        known = (np.eye(2) - gain) @ moving
        self._covariance = known if np.trace(known) >= np.trace(activity.anchor) else activity.anchor.copy()
        if self._is_improved:
            self._activities[index] = self._activities[index].refreshed(cycle, REFRESH)
        self.alarm, self.unresolved = "", 0.0
        return self._observation(cycle, FOLLOWED, "", index)

    def _pace(self, surprise: Array, expected: Array) -> float:
        """Return how many times faster than at rest the drift is, from surprises that keep one sign."""
        self._bias = self._bias + BIAS_WEIGHT * (surprise - self._bias)
        chance = BIAS_WEIGHT / (2 - BIAS_WEIGHT) * expected
        return float(np.clip(self._bias @ np.linalg.solve(chance, self._bias) / PACE, 1, FASTEST))

    def _meet_jump(self, cycle: Cycle, index: int) -> Observation:
        activity = self._activities[index]
        measured = activity.drift_of(cycle, self._use.rest_is_low)
        before = [activity.drift_of(c, self._use.rest_is_low) for c in self._jumps[-MOST_JUMPS + 1 :]]
        apart = JUMP_SIGMAS * np.sqrt(2 * np.diag(activity.noise))
        if before and np.any(np.abs(measured - np.mean(before, axis=0)) > apart):
            self._jumps.clear()
            before = []
        self._jumps = [*self._jumps[-MOST_JUMPS + 1 :], cycle]
        step = np.mean([*before, measured], axis=0) - self._drift
        self.unresolved = float(np.hypot(*step))
        if len(self._jumps) < JUMP_CYCLES:
            return self._held(cycle, f"a sudden change; {JUMP_CYCLES} like cycles decide what it is", index)
        if np.any(np.abs(step) > LARGEST_JUMP) or np.any(np.abs(self._drift + step) > LARGEST_DRIFT):
            self.alarm = "a sudden change larger than is ever followed; check the sensor and its mounting"
            return self._held(cycle, self.alarm, index)
        if not activity.has_rest:
            self.alarm = "a sudden change of sensor or use, which no known rest can tell apart"
            return self._held(cycle, self.alarm, index)
        if self._has_rest_moved(activity):
            return self._follow_jump(cycle, index, step)
        self.unresolved = 0.0
        if self._is_improved and len(self._jumps) >= MIN_CYCLES and self._learn(self._jumps):
            self._jumps.clear()
        return self._held(cycle, "the rest is where it was: the use changed, not the sensor", index)

    def _has_rest_moved(self, activity: Activity) -> bool:
        rests = [c.rest(self._use.rest_is_low) for c in self._jumps]
        expected = self._drift[0] + np.exp(self._drift[1]) * activity.rest
        return bool(abs(np.mean(rests) - expected) > max(REST_MOVED, 4 * activity.rest_scatter))

    def _follow_jump(self, cycle: Cycle, index: int, step: Array) -> Observation:
        activity = self._activities[index]
        self._drift = self._drift + step
        self._covariance = activity.anchor + activity.noise / len(self._jumps)
        self._bias = np.zeros(2)
        self._jumps.clear()
        self.alarm, self.unresolved = "", 0.0
        return self._observation(cycle, JUMPED, "the rest and all levels moved at once: re-seated", index)

    def _meet_stranger(self, cycle: Cycle) -> Observation:
        self._jumps.clear()
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
        shift, gain = float(self._drift[0]), float(np.exp(self._drift[1]))
        calibrated = [c.standardised(shift, gain) for c in cycles]
        activity = learn_activity(calibrated, self._use.rest_is_low, self._covariance.copy()).activity
        if activity is None:
            return False
        first_learnt = 1 if self._has_calibrated else 0
        if len(self._activities) == MAX_ACTIVITIES:
            del self._activities[first_learnt]
        self._activities.append(activity)
        return True

    def _held(self, cycle: Cycle, reason: str, index: int = -1) -> Observation:
        return self._observation(cycle, HELD, reason, index)

    def _observation(self, cycle: Cycle, verdict: str, reason: str, index: int) -> Observation:
        shift, log_gain = self._drift.tolist()
        shift_sd, log_gain_sd = np.sqrt(np.diag(self._covariance)).tolist()
        return Observation(cycle.end_s, verdict, reason, shift, log_gain, shift_sd, log_gain_sd, index)

    def state(self) -> dict[str, object]:
        """Return all that a restart needs besides the calibrated use, as JSON values."""
        return {
            "drift": self._drift.tolist(),
            "covariance": self._covariance.tolist(),
            "bias": self._bias.tolist(),
            "last_s": self._last_s,
            "activities": [activity.state() for activity in self._activities],
            "strangers": [cycle.state() for cycle in self._strangers],
            "jumps": [cycle.state() for cycle in self._jumps],
            "alarm": self.alarm,
            "unresolved": self.unresolved,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state()` taken earlier."""
        self._drift, self._covariance = np.array(state["drift"]), np.array(state["covariance"])
        self._bias = np.array(state["bias"])
        self._last_s = state["last_s"]
        self._activities = [Activity.from_state(activity) for activity in state["activities"]]
        self._strangers = [Cycle.from_state(cycle) for cycle in state["strangers"]]
        self._jumps = [Cycle.from_state(cycle) for cycle in state["jumps"]]
        self.alarm, self.unresolved = str(state["alarm"]), float(state["unresolved"])


def _sureness(value: float, variance: float) -> float:
    """Return how much of a value is applied, from 0 where it may be chance to 1."""
    sigmas = abs(value) / np.sqrt(max(variance, 1e-12))
    return float(np.clip((sigmas - SHRINK[0]) / (SHRINK[1] - SHRINK[0]), 0, 1))
