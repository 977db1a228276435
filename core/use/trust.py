"""Which part of an estimated drift is applied: what is no chance, and what no change of use explains as well.

A person who presses harder and a sensor whose gain rises give the same output. Its amplitude grows about a level that
stands still, that of no load. Of a bent characteristic that level is worked out (`Activity.pivots`). A sensor that ages
also shifts its rest; use does not. The choice is argued in docs/decisions/0060-use-or-gain.md.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.activity import Activity
from softcal.core.use.method import TrustConfig
from softcal.core.use.state_json import array, not_kept


@dataclass(frozen=True, eq=False)
class Trust:
    """What is known about the sensor and its use that decides which part of a drift is applied.

    Args:
        zero: output at zero load in scales of the calibrated use; None where f gives no zero.
        rest: unloaded level of the latest known activity that returns to one, or that a machine times; None until then.
        pivots: (2, u) of the latest known activity that returns to a rest.
        level: how far the rest is from its place at calibration, in scales, exponentially smoothed.
        counted: `level` when it last counted as moved (hysteresis).
        moved: the way the rest has surely gone by then: how much this sensor is known to drift.
        proven: share of the gain that was sure when the sensor was last re-seated. A re-seating makes the value of the
            gain doubtful, not its existence.
        seen_before, applied_before: log gain estimated and applied before the latest re-seating.
        step, fresh: how far that moved the rest, and cycles left in which the gain that came with it is found.
    """

    zero: float | None
    rest: float | None = None
    pivots: Array = field(default_factory=lambda: np.zeros((2, 0)), metadata=array(2, "u"))
    level: float = 0.0
    counted: float = 0.0
    moved: float = 0.0
    proven: float = 0.0
    seated: float = 0.0
    seen_before: float = 0.0
    applied_before: float = 0.0
    step: float = 0.0
    fresh: int = 0
    config: TrustConfig = not_kept(TrustConfig())

    def reseated(self, drift: Array, covariance: Array, step: float, cycles: int) -> "Trust":
        """Return what is known when the sensor is re-seated after a drift, (2,) with (2, 2) covariance.

        The step of its rest, in scales, vouches for the gain that came with it alone, found over so many cycles.
        """
        share = self._sure_share(float(drift[1]), float(covariance[1, 1]))
        applied = float(self.applied(drift, covariance)[1])
        return replace(
            self._seated(applied),
            level=self.level + step,
            counted=self.counted + step,
            proven=max(self.proven, share),
            seen_before=float(drift[1]),
            applied_before=applied,
            step=abs(step),
            fresh=cycles,
        )

    def _seated(self, log_gain: float) -> "Trust":
        """Return what is known once the gain that came with a re-seating is found."""
        if not self.fresh:
            return self
        return replace(self, seated=self.seated + log_gain - self.applied_before, step=0.0, fresh=0)

    def after(self, activity: Activity, drift: Array, covariance: Array, weight: float) -> "Trust":
        """Return what is known after a cycle of an activity showed a drift, (2,) with (2, 2) covariance.

        The rest is smoothed with the weight of a cycle: one that moves for a few only, as after a pause, is no drift.
        """
        known = self
        # Where a machine times the use, its cycles turn at one load, though they do not rest there.
        if activity.has_rest or activity.is_imposed:
            known = replace(known, rest=activity.rest, pivots=activity.pivots)
        # The gain of a re-seating is what the filter has found when the last of its cycles is in.
        if self.fresh == 1:
            known = known._seated(float(known.applied(drift, covariance)[1]))
        elif self.fresh:
            known = replace(known, fresh=self.fresh - 1)
        standing = known.standing_level(drift)
        if standing is None:
            return known
        level = self.level + weight * (self._sure_movement(drift, covariance, standing) - self.level)
        step = abs(level - self.counted)
        # Hysteresis: a rest that wobbles about one place must not add up to a long way.
        if step <= self.config.step:
            return replace(known, level=level)
        return replace(known, level=level, counted=level, moved=self.moved + step)

    def levels(self, log_gain: float) -> Array:
        """Return the levels, one of which a change of use leaves where it was: rest, zero load, and the pivot."""
        levels = [level for level in (self.rest, self.zero) if level is not None]
        if self.pivots.size:
            levels.append(float(np.interp(log_gain, *self.pivots)))
        return np.array(levels)

    def jumped(self, activity: Activity, drift: Array, step: Array) -> float:
        """Return how far a step of a drift, both (2,), moved the output at rest and at zero load alike: no use does."""
        levels = replace(self, rest=activity.rest, pivots=activity.pivots).levels(float(step[1]))
        moved = [movement(drift + step, level) - movement(drift, level) for level in levels.tolist()]
        # Use leaves one of the levels where it was, so the smallest movement is surely the sensor's.
        return min(moved, key=abs) if min(moved) * max(moved) > 0 else 0.0

    def is_lighter(self, activity: Activity, drift: Array, step: Array) -> bool:
        """Return whether a preloaded rest that moved by a step of a drift, both (2,), went towards zero load.

        A step that takes back what was followed is none of those: to follow it cannot make an estimate worse than none.
        """
        if self.zero is None:
            return False
        place, zero = (level + movement(drift, level) for level in (activity.rest, self.zero))
        now = activity.rest + movement(drift + step, activity.rest)
        if abs(now - activity.rest) < abs(place - activity.rest):
            return False
        preloaded = abs(zero - place) > self.config.preload
        return preloaded and 0 < (now - place) / (zero - place) <= 1 + self.config.preload / abs(zero - place)

    def standing_level(self, drift: Array) -> float | None:
        """Return the level between rest, zero load and pivot that moved least; None where no rest is known."""
        if self.rest is None:
            return None
        levels = self.levels(float(drift[1]))
        moved = np.array([movement(drift, level) for level in levels])
        first, last = int(np.argmin(moved)), int(np.argmax(moved))
        # Opposite movements: the level that stood still lies between the two.
        if moved[first] <= 0 <= moved[last]:
            share = -moved[first] / max(moved[last] - moved[first], 1e-12)
            return float(levels[first] + share * (levels[last] - levels[first]))
        return float(levels[np.argmin(np.abs(moved))])

    def applied(self, drift: Array, covariance: Array) -> Array:
        """Return the (2,) shift and log gain that are sure enough to be applied.

        A log gain turns the output about a level, the one that use cannot move. It is bounded: were it use after all,
        it would move the mean no further than correcting the shift of the rest has repaid.
        """
        log_gain = sure = self._sure(float(drift[1]), covariance)
        level = self.standing_level(drift)
        if level is None:
            return np.zeros(2)
        most = self.gain_per_shift(level) * self.moved
        vouched = float(np.clip(log_gain, self.seated - most, self.seated + most))
        if self.fresh:
            # The log gain applied before the re-seating and what came with it, which its step vouches for.
            came, most = (
                self._sure(float(drift[1]) - self.seen_before, covariance),
                self.gain_per_shift(level) * self.step,
            )
            vouched = self.applied_before + float(np.clip(came, -most, most))
        # Never more than is estimated: gain and use that cancel are less likely than neither.
        log_gain = float(np.clip(vouched, min(0.0, log_gain), max(0.0, log_gain)))
        shift = self._sure_movement(drift, covariance, level)
        creep = self.creep(level, sure - log_gain)
        shift -= float(np.clip(shift, min(0.0, creep), max(0.0, creep)))
        return np.array([shift - np.expm1(log_gain) * level, log_gain])

    def creep(self, level: float, log_gain: float) -> float:
        """Return how far a rest at a level may follow use that grows by a log gain: the sensor's memory, no drift."""
        # By half of what the mean load moves, and no further than what counts as a movement.
        moved = -level * float(np.expm1(log_gain)) * 0.5
        return float(np.clip(moved, -self.config.step, self.config.step))

    def _sure(self, log_gain: float, covariance: Array) -> float:
        return log_gain * max(self.proven, self._sure_share(log_gain, float(covariance[1, 1])))

    @property
    def may_be_preload(self) -> bool:
        """Whether a rest that moves may be a preload that changed: the use does not come to zero load."""
        if self.rest is None:
            return False
        return self.zero is None or abs(self.rest - self.zero) > self.config.preload

    def use_doubt(self, drift: Array, applied: Array) -> float:
        """Return the expected square, in scales, of the error of a correction that may have been use.

        Its log gain may have been one, and its shift a preload that changed: each is as likely as not.
        """
        level = self.standing_level(drift)
        if level is None:
            return 0.0
        moved = movement(applied, level) if self.may_be_preload else 0.0
        return 0.5 * (float(applied[1]) ** 2 * (1 + level**2) + moved**2)

    def is_use_as_likely(self, drift: Array, covariance: Array, applied: Array) -> bool:
        """Return whether most of a sure log gain is not among what is applied, for use explains it as well."""
        return bool(abs(applied[1]) < 0.5 * abs(self._sure(float(drift[1]), covariance)))

    def gain_per_shift(self, level: float) -> float:
        """Return the log gain about a level that moves the mean of the calibrated use, 0, as far as a shift of 1.

        A level close to the mean is no rest; it counts as half a scale away.
        """
        return 1 / max(abs(level), 0.5)

    def _sure_movement(self, drift: Array, covariance: Array, level: float) -> float:
        """Return the movement of a level, shrunk by the chance that there is none."""
        slope = np.array([1.0, np.exp(drift[1]) * level])
        moved = movement(drift, level)
        return moved * self._sure_share(moved, float(slope @ covariance @ slope))

    def sure_size(self, values: Array, sd: Array) -> float:
        """Return the size of (n,) values with standard deviations (n,), each shrunk by the chance that it is none."""
        sure = [v * self._sure_share(v, d**2) for v, d in zip(values.tolist(), sd.tolist(), strict=True)]
        return float(np.linalg.norm(sure))

    def _sure_share(self, value: float, variance: float) -> float:
        """Return the soft threshold of a value: 0 where it may be chance, 1 where it surely is not."""
        none, full = self.config.shrink
        sigmas = abs(value) / np.sqrt(max(variance, 1e-12))
        # Linear in between: a hard threshold would switch a correction on and off from cycle to cycle.
        return float(np.clip((sigmas - none) / (full - none), 0, 1))


def movement(drift: Array, level: float) -> float:
    """Return how far the output at a level has moved, in scales of the calibrated use."""
    return float(drift[0] + np.expm1(drift[1]) * level)
