"""What of a measured drift is applied: what is no chance, and what no change of use explains as well.

Presses that grow harder give a larger output about an output that stands: that of no load. A gain that rises can do the
same. They differ in two ways. A sensor that ages moves its rest, use does not. And a use timed as by a machine is
imposed by one: its size does not change by itself.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.activity import Activity

SHRINK = (3.0, 5.0)
"""A drift of fewer standard deviations than the first is not applied, of more than the second in full."""

USE_SHARE = 0.5
"""Probability that a change of size which no machine timed is use and not gain: nothing tells the two apart."""

STEP = 0.08
"""Movements of the rest count in steps larger than this, in scales; a sensor creeps so far after harder use."""


CREEP = 0.5
"""The unloaded turning point moves by up to this share of what harder use moves the mean by, up to `STEP`."""


@dataclass(frozen=True)
class Trust:
    """What is known about the sensor and its use that decides what of a drift is applied.

    Args:
        zero: output at zero load in scales of the calibrated use; None where f gives no zero.
        rest: unloaded level of the latest known activity that returns to one; None while none did.
        is_imposed: whether the latest known activity is timed as by a machine.
        level: where the rest is from its place at calibration, in scales, smoothed.
        counted: where it was when it last counted as moved.
        moved: the way it has surely gone by then: how much of a drifter the sensor is known to be.
        seated: log gain that came with re-seatings.
        seen_before, applied_before: log gain seen and applied before the latest one.
        step, fresh: how far that moved the rest, and cycles left in which the gain that came with it is found.
        proven: share of the gain that was sure when the sensor was last re-seated. A re-seating makes it doubtful what
            the gain is, not that there is one.
    """

    zero: float | None
    rest: float | None = None
    is_imposed: bool = False
    level: float = 0.0
    counted: float = 0.0
    moved: float = 0.0
    proven: float = 0.0
    seated: float = 0.0
    seen_before: float = 0.0
    applied_before: float = 0.0
    step: float = 0.0
    fresh: int = 0

    def reseated(self, drift: Array, covariance: Array, step: float, cycles: int) -> "Trust":
        """Return what is known when the sensor is re-seated after a drift, (2,) with (2, 2) covariance.

        Args:
            step: how far the rest moved at once, in scales; it vouches for the gain that came with it alone.
            cycles: over so many the gain that came with it is found.
        """
        share = _sure_share(float(drift[1]), float(covariance[1, 1]))
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

        Args:
            weight: of this cycle; a rest that moves for a few cycles only, as after a pause, makes no drifter.
        """
        rest = activity.rest if activity.has_rest else self.rest
        known = replace(self, rest=rest, is_imposed=activity.is_imposed)
        if self.fresh == 1:
            known = known._seated(float(known.applied(drift, covariance)[1]))
        elif self.fresh:
            known = replace(known, fresh=self.fresh - 1)
        if activity.is_imposed:
            gone = float(known.applied(drift, covariance)[1]) - known.seated
            return replace(known, moved=max(self.moved, abs(gone) / gain_per_shift(activity.rest)))
        standing = known.standing_level(drift)
        if standing is None:
            return known
        level = self.level + weight * (_sure_movement(drift, covariance, standing) - self.level)
        step = abs(level - self.counted)
        if step <= STEP:
            return replace(known, level=level)
        return replace(known, level=level, counted=level, moved=self.moved + step)

    def standing_level(self, drift: Array) -> float | None:
        """Return the level between rest and zero load that moved least; None where neither is known.

        Harder use leaves one level there where it was, that of no load.
        """
        if self.rest is None:
            return None
        if self.zero is None:
            return self.rest
        first, second = movement(drift, self.rest), movement(drift, self.zero)
        if first * second <= 0:
            return self.rest + (self.zero - self.rest) * abs(first) / max(abs(first) + abs(second), 1e-12)
        return self.rest if abs(first) <= abs(second) else self.zero

    def applied(self, drift: Array, covariance: Array) -> Array:
        """Return the (2,) shift and log gain that are sure enough.

        A log gain turns the output about a level. Where the use is imposed, that is the level where the drift is known
        best: shift there and log gain are independent, and each is judged by itself. Otherwise it is the level that
        use cannot move, and the log gain goes no further than the shift there makes up for, were it use after all.
        """
        log_gain = sure = self._sure(float(drift[1]), covariance)
        if self.is_imposed:
            level = -float(covariance[0, 1] / covariance[1, 1])
        elif (standing := self.standing_level(drift)) is not None:
            level = standing
            most = gain_per_shift(level) * self.moved
            vouched = float(np.clip(log_gain, self.seated - most, self.seated + most))
            if self.fresh:
                vouched = self._reseated_gain(drift, covariance, gain_per_shift(level) * self.step)
            # Never more than is seen: gain and use that cancel are less likely than neither.
            log_gain = float(np.clip(vouched, min(0.0, log_gain), max(0.0, log_gain)))
        else:
            return np.zeros(2)
        shift = _sure_movement(drift, covariance, level)
        # Up to here a rest that follows the size of the use is its creep.
        creep = -level * float(np.expm1(sure - log_gain)) * CREEP
        creep = float(np.clip(creep, -STEP, STEP))
        shift -= float(np.clip(shift, min(0.0, creep), max(0.0, creep)))
        return np.array([shift - np.expm1(log_gain) * level, log_gain])

    def _sure(self, log_gain: float, covariance: Array) -> float:
        return log_gain * max(self.proven, _sure_share(log_gain, float(covariance[1, 1])))

    def _reseated_gain(self, drift: Array, covariance: Array, most: float) -> float:
        """Return the log gain applied before a re-seating and what came with it, which its step vouches for."""
        came = self._sure(float(drift[1]) - self.seen_before, covariance)
        return self.applied_before + float(np.clip(came, -most, most))

    @property
    def use_share(self) -> float:
        """Probability that a change of size is use."""
        return 0.0 if self.is_imposed else USE_SHARE

    def use_doubt(self, drift: Array, applied: Array) -> float:
        """Return the mean square, in scales, by which a correction errs if its log gain may have been use."""
        level = self.standing_level(drift)
        return 0.0 if level is None else self.use_share * float(applied[1]) ** 2 * (1 + level**2)

    def is_use_as_likely(self, drift: Array, covariance: Array) -> bool:
        """Return whether part of a sure log gain is not applied because use explains it as well."""
        log_gain = self._sure(float(drift[1]), covariance)
        return bool(abs(self.applied(drift, covariance)[1]) < 0.9 * abs(log_gain))

    def state(self) -> dict[str, object]:
        """Return all fields as JSON values."""
        return asdict(self)

    @classmethod
    def from_state(cls, state: Mapping[str, object]) -> "Trust":
        """Rebuild from `state()`."""
        return cls(**state)  # type: ignore[arg-type]


def movement(drift: Array, level: float) -> float:
    """Return how far the output at a level has moved, in scales of the calibrated use."""
    return float(drift[0] + np.expm1(drift[1]) * level)


def _sure_movement(drift: Array, covariance: Array, level: float) -> float:
    slope = np.array([1.0, np.exp(drift[1]) * level])
    return _sure_part(movement(drift, level), float(slope @ covariance @ slope))


def gain_per_shift(level: float) -> float:
    """Return the log gain that moves the mean of the calibrated use, which is 0, as far about a level as a shift of 1.

    A level within half a scale of the mean is no rest; it counts as that far.
    """
    return 1 / max(abs(level), 0.5)


def _sure_part(value: float, variance: float) -> float:
    """Return what of a value is applied: nothing where it may be chance, all where it is surely none."""
    return value * _sure_share(value, variance)


def _sure_share(value: float, variance: float) -> float:
    sigmas = abs(value) / np.sqrt(max(variance, 1e-12))
    return float(np.clip((sigmas - SHRINK[0]) / (SHRINK[1] - SHRINK[0]), 0, 1))
