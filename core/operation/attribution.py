"""Which part of an estimated drift is applied: what is no chance, and what no change of use explains as well.

A person who presses harder and a sensor whose gain rises give the same output. Its amplitude grows about a level that
stands still, that of no load. Of a bent characteristic that level is worked out (`Activity.pivots`). A sensor that ages
also shifts its rest; use does not. The choice is argued in docs/decisions/0060-use-or-gain.md.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from softcal.core.operation.activity import Activity
from softcal.core.operation.method import AttributionConfig
from softcal.core.operation.stored_state import array_field, not_stored
from softcal.core.recording import Array


@dataclass(frozen=True, eq=False)
class DriftAttribution:
    """What is known about the sensor and its use that decides which part of a drift is applied.

    Args:
        zero: output at zero load in scales of the calibrated use; None where f gives no zero.
        rest: unloaded level of the latest known activity that returns to one, or that a machine times; None until then.
        pivots: (2, u) of the latest known activity that returns to a rest.
        level: how far the rest is from its place at calibration, in scales, exponentially smoothed.
        counted_level: `level` when it last counted as moved (hysteresis).
        rest_path: the way the rest has surely gone by then: how much this sensor is known to drift.
        proven_share: share of the gain that was sure when the sensor was last re-seated. A re-seating makes the value
            of the gain doubtful, not its existence.
        log_gain_before, applied_before: log gain estimated and applied before the latest re-seating.
        step, remaining_cycles: how far that moved the rest, and cycles left in which the gain that came with it is
            estimated.
    """

    zero: float | None
    rest: float | None = None
    pivots: Array = field(default_factory=lambda: np.zeros((2, 0)), metadata=array_field(2, "u"))
    level: float = 0.0
    counted_level: float = 0.0
    rest_path: float = 0.0
    proven_share: float = 0.0
    seated_gain: float = 0.0
    log_gain_before: float = 0.0
    applied_before: float = 0.0
    step: float = 0.0
    remaining_cycles: int = 0
    config: AttributionConfig = not_stored(AttributionConfig())

    def after_reseating(self, drift: Array, covariance: Array, step: float, cycles: int) -> "DriftAttribution":
        """Return what is known when the sensor is re-seated after a drift, (2,) with (2, 2) covariance.

        The step of its rest, in scales, vouches for the gain that came with it alone, found over so many cycles.
        """
        share = self._significance(float(drift[1]), float(covariance[1, 1]))
        applied = float(self.applied_drift(drift, covariance)[1])
        return replace(
            self._with_seated_gain(applied),
            level=self.level + step,
            counted_level=self.counted_level + step,
            proven_share=max(self.proven_share, share),
            log_gain_before=float(drift[1]),
            applied_before=applied,
            step=abs(step),
            remaining_cycles=cycles,
        )

    def _with_seated_gain(self, log_gain: float) -> "DriftAttribution":
        """Return what is known once the gain that came with a re-seating is found."""
        if not self.remaining_cycles:
            return self
        return replace(
            self, seated_gain=self.seated_gain + log_gain - self.applied_before, step=0.0, remaining_cycles=0
        )

    def after_cycle(self, activity: Activity, drift: Array, covariance: Array, weight: float) -> "DriftAttribution":
        """Return what is known after a cycle of an activity showed a drift, (2,) with (2, 2) covariance.

        The rest is smoothed with the weight of a cycle: one that moves for a few only, as after a pause, is no drift.
        """
        state = self
        # Where a machine times the use, its cycles turn at one load, though they do not rest there.
        if activity.has_rest or activity.is_imposed:
            state = replace(state, rest=activity.rest, pivots=activity.pivots)
        # The gain of a re-seating is what the filter has found when the last of its cycles is in.
        if self.remaining_cycles == 1:
            state = state._with_seated_gain(float(state.applied_drift(drift, covariance)[1]))
        elif self.remaining_cycles:
            state = replace(state, remaining_cycles=self.remaining_cycles - 1)
        fixed_level = state.fixed_level(drift)
        if fixed_level is None:
            return state
        level = self.level + weight * (self._significant_movement(drift, covariance, fixed_level) - self.level)
        step = abs(level - self.counted_level)
        # Hysteresis: a rest that wobbles about one place must not add up to a long way.
        if step <= self.config.step:
            return replace(state, level=level)
        return replace(state, level=level, counted_level=level, rest_path=self.rest_path + step)

    def levels(self, log_gain: float) -> Array:
        """Return the levels, one of which a change of use leaves where it was: rest, zero load, and the pivot."""
        levels = [level for level in (self.rest, self.zero) if level is not None]
        if self.pivots.size:
            levels.append(float(np.interp(log_gain, *self.pivots)))
        return np.array(levels)

    def sensor_step(self, activity: Activity, drift: Array, step: Array) -> float:
        """Return how far a step of a drift, both (2,), moved the output at rest and at zero load alike: no use does."""
        levels = replace(self, rest=activity.rest, pivots=activity.pivots).levels(float(step[1]))
        displacement = [movement(drift + step, level) - movement(drift, level) for level in levels.tolist()]
        # Use leaves one of the levels where it was, so the smallest movement is surely the sensor's.
        return min(displacement, key=abs) if min(displacement) * max(displacement) > 0 else 0.0

    def is_towards_zero_load(self, activity: Activity, drift: Array, step: Array) -> bool:
        """Return whether a preloaded rest that moved by a step of a drift, both (2,), went towards zero load.

        A step that takes back what was followed is none of those: to follow it cannot make an estimate worse than none.
        """
        if self.zero is None:
            return False
        position, zero = (level + movement(drift, level) for level in (activity.rest, self.zero))
        now = activity.rest + movement(drift + step, activity.rest)
        if abs(now - activity.rest) < abs(position - activity.rest):
            return False
        preloaded = abs(zero - position) > self.config.preload
        return preloaded and 0 < (now - position) / (zero - position) <= 1 + self.config.preload / abs(zero - position)

    def fixed_level(self, drift: Array) -> float | None:
        """Return the level between rest, zero load and pivot that moved least; None where no rest is known."""
        if self.rest is None:
            return None
        levels = self.levels(float(drift[1]))
        displacement = np.array([movement(drift, level) for level in levels])
        first, last = int(np.argmin(displacement)), int(np.argmax(displacement))
        # Opposite movements: the level that stood still lies between the two.
        if displacement[first] <= 0 <= displacement[last]:
            share = -displacement[first] / max(displacement[last] - displacement[first], 1e-12)
            return float(levels[first] + share * (levels[last] - levels[first]))
        return float(levels[np.argmin(np.abs(displacement))])

    def applied_drift(self, drift: Array, covariance: Array) -> Array:
        """Return the (2,) shift and log gain that are sure enough to be applied.

        A log gain turns the output about a level, the one that use cannot move. It is bounded: were it use after all,
        it would move the mean no further than correcting the shift of the rest has repaid.
        """
        log_gain = significant_gain = self._soft_threshold(float(drift[1]), covariance)
        level = self.fixed_level(drift)
        if level is None:
            return np.zeros(2)
        max_log_gain = self.gain_per_shift(level) * self.rest_path
        bounded_gain = float(np.clip(log_gain, self.seated_gain - max_log_gain, self.seated_gain + max_log_gain))
        if self.remaining_cycles:
            # The log gain applied before the re-seating and what came with it, which its step vouches for.
            reseating_gain = self._soft_threshold(float(drift[1]) - self.log_gain_before, covariance)
            max_log_gain = self.gain_per_shift(level) * self.step
            bounded_gain = self.applied_before + float(np.clip(reseating_gain, -max_log_gain, max_log_gain))
        # Never more than is estimated: gain and use that cancel are less likely than neither.
        log_gain = float(np.clip(bounded_gain, min(0.0, log_gain), max(0.0, log_gain)))
        shift = self._significant_movement(drift, covariance, level)
        creep = self.creep(level, significant_gain - log_gain)
        shift -= float(np.clip(shift, min(0.0, creep), max(0.0, creep)))
        return np.array([shift - np.expm1(log_gain) * level, log_gain])

    def creep(self, level: float, log_gain: float) -> float:
        """Return how far a rest at a level may follow use that grows by a log gain: the sensor's memory, no drift."""
        # By half of what the mean load moves, and no further than what counts as a movement.
        displacement = -level * float(np.expm1(log_gain)) * 0.5
        return float(np.clip(displacement, -self.config.step, self.config.step))

    def _soft_threshold(self, log_gain: float, covariance: Array) -> float:
        return log_gain * max(self.proven_share, self._significance(log_gain, float(covariance[1, 1])))

    @property
    def may_be_preload(self) -> bool:
        """Whether a rest that moves may be a preload that changed: the use does not come to zero load."""
        if self.rest is None:
            return False
        return self.zero is None or abs(self.rest - self.zero) > self.config.preload

    def operation_variance(self, drift: Array, applied: Array) -> float:
        """Return the expected square, in scales, of the error of a correction that may have been use.

        Its log gain may have been one, and its shift a preload that changed: each is as likely as not.
        """
        level = self.fixed_level(drift)
        if level is None:
            return 0.0
        displacement = movement(applied, level) if self.may_be_preload else 0.0
        return 0.5 * (float(applied[1]) ** 2 * (1 + level**2) + displacement**2)

    def is_operation_as_likely(self, drift: Array, covariance: Array, applied: Array) -> bool:
        """Return whether most of a sure log gain is not among what is applied, for use explains it as well."""
        return bool(abs(applied[1]) < 0.5 * abs(self._soft_threshold(float(drift[1]), covariance)))

    def gain_per_shift(self, level: float) -> float:
        """Return the log gain about a level that moves the mean of the calibrated use, 0, as far as a shift of 1.

        A level close to the mean is no rest; it counts as half a scale away.
        """
        return 1 / max(abs(level), 0.5)

    def _significant_movement(self, drift: Array, covariance: Array, level: float) -> float:
        """Return the movement of a level, shrunk by the chance that there is none."""
        slope = np.array([1.0, np.exp(drift[1]) * level])
        displacement = movement(drift, level)
        return displacement * self._significance(displacement, float(slope @ covariance @ slope))

    def significant_size(self, values: Array, sd: Array) -> float:
        """Return the size of (n,) values with standard deviations (n,), each shrunk by the chance that it is none."""
        significant = [v * self._significance(v, d**2) for v, d in zip(values.tolist(), sd.tolist(), strict=True)]
        return float(np.linalg.norm(significant))

    def _significance(self, value: float, variance: float) -> float:
        """Return the soft threshold of a value: 0 where it may be chance, 1 where it surely is not."""
        none, full = self.config.soft_threshold
        sigmas = abs(value) / np.sqrt(max(variance, 1e-12))
        # Linear in between: a hard threshold would switch a correction on and off from cycle to cycle.
        return float(np.clip((sigmas - none) / (full - none), 0, 1))


def movement(drift: Array, level: float) -> float:
    """Return how far the output at a level has moved, in scales of the calibrated use."""
    return float(drift[0] + np.expm1(drift[1]) * level)
