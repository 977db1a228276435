"""What use looks like while nothing drifts: steady activities, learnt from their cycles and recognised again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softcal.core.recording import Array, OutputRecording
from softcal.core.use.cycles import Cycle, CycleCutter

MIN_CYCLES = 4
"""Fewer cycles of an activity cannot say how much its cycles differ."""

STEADY_SCATTER, STEADY_TREND = 0.25, 0.8
"""A steady activity's cycles scatter by less than this around their trend and wander by less than that, in scales."""

TOLERANCE = np.array([0.10, 0.15, 0.25])
"""Least tolerance of an activity for a cycle's quantiles (RMS, in scales), its log speed and its log duration."""

LOOSEST = 3.0
"""Cycles that would need a tolerance this many times as large are no activity: any use would pass for it."""

NOISE_FLOOR = np.array([0.01, 0.01, 0.01])
"""Smallest standard deviation of one cycle's rest, level and log scale; of its shift and log gain, the first two."""

FEW = 2.0
"""Few cycles may differ by less than usual: their covariance is widened by this over their number less two."""

SMALLEST_GAIN = 1e-3

MACHINE_TIMING = 0.01
"""A use whose cycles' durations scatter by less than this share is timed by a machine; people scatter more."""

REST_SCATTER = 0.10
"""An activity whose unloaded turning points differ by less than this, in scales, returns to a known rest."""

LONGEST_CYCLE = 0.5
"""A cycle may take this share of the calibration recording."""


@dataclass(frozen=True, eq=False)
class Activity:
    """One way of use: how its cycles look, and how much they differ. In scales of the calibrated use.

    Args:
        level, log_scale: mean, and log standard deviation.
        shape, first_shape: (16,) standardised quantiles now, and when the activity was first seen.
        log_speed, log_duration: of its cycles.
        rest: level of the unloaded turning point.
        rest_scatter: how much it differs.
        features: (3, 3) covariance of one cycle's rest, level and scale about their trend.
        bias, noise: (2,) mean and (2, 2) covariance of the drift that `drift_of` sees in its own cycles.
        tolerance: (3,) largest differences in shape, log speed and log duration.
        doubt: (2, 2) covariance of the drift its cycles show on average, were there none.
        is_imposed: whether its cycles take as equal times as a machine's do.
    """

    level: float
    log_scale: float
    shape: Array
    first_shape: Array
    log_speed: float
    log_duration: float
    rest: float
    rest_scatter: float
    features: Array
    bias: Array
    noise: Array
    tolerance: Array
    doubt: Array
    is_imposed: bool

    def drift_of(self, cycle: Cycle, rest_is_low: bool) -> Array:
        """Return the (2,) shift and log gain under which a cycle is one of this activity.

        Weighted least squares of three equations in mu and g = exp(lambda): rest, level and scale of the cycle are
        mu + g rest, mu + g level and g scale of the activity. A sure rest pins the shift however presses differ.
        """
        design = np.array([[1.0, self.rest], [1.0, self.level], [0.0, 1.0]])
        seen = np.array([cycle.rest(rest_is_low), cycle.level, cycle.scale / np.exp(self.log_scale)])
        weighted = np.linalg.solve(self.features, design)
        shift, gain = np.linalg.solve(design.T @ weighted, weighted.T @ seen)
        return np.array([shift, np.log(max(gain, SMALLEST_GAIN))]) - self.bias

    @property
    def has_rest(self) -> bool:
        """Whether its cycles return to one unloaded level."""
        return self.rest_scatter <= REST_SCATTER

    def strangeness(self, cycle: Cycle) -> float:
        """Return the largest difference of a cycle from this activity, 1 at its tolerance. Level and scale are free."""
        difference = (
            np.sqrt(np.mean((cycle.shape - self.shape) ** 2)),
            abs(np.log(cycle.speed) - self.log_speed),
            abs(np.log(cycle.duration_s) - self.log_duration),
        )
        return float(np.max(difference / self.tolerance))

    def refreshed(self, cycle: Cycle, weight: float) -> "Activity":
        """Return the activity with its shape moved towards a cycle, never further than its tolerance from the first."""
        shape = self.shape + weight * (cycle.shape - self.shape)
        if np.sqrt(np.mean((shape - self.first_shape) ** 2)) > self.tolerance[0]:
            return self
        return replace(self, shape=shape)

    def state(self) -> dict[str, object]:
        """Return the activity as JSON values."""
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> "Activity":
        """Rebuild from `state()`."""
        values: dict[str, Any] = {n: np.array(v) if isinstance(v, list) else v for n, v in state.items()}
        return cls(**values)


@dataclass(frozen=True, eq=False)
class Lesson:
    """What cycles taught: an activity, or why there is none.

    Args:
        activity: None where the cycles are no steady activity.
        reason: why not, in words.
        trend: (2,) drift of level and log scale over the cycles.
    """

    activity: Activity | None
    reason: str
    trend: Array


def learn_activity(cycles: Sequence[Cycle], rest_is_low: bool) -> Lesson:
    """Describe the activity of consecutive complete cycles.

    Args:
        cycles: in time order, in scales of the calibrated use.
        rest_is_low: whether the unloaded turning point is the lower one.
    """
    if len(cycles) < MIN_CYCLES:
        return Lesson(None, f"{len(cycles)} cycles of use, {MIN_CYCLES} are needed to compare with", np.zeros(2))
    rests = np.array([c.rest(rest_is_low) for c in cycles])
    position = np.array([[c.level, np.log(c.scale)] for c in cycles])
    trend, scatter = _trend(position)
    if scatter.max() > STEADY_SCATTER or np.abs(trend).max() > STEADY_TREND:
        reason = f"use is not steady: cycles scatter by {scatter.max():.2g} and wander by {np.abs(trend).max():.2g}"
        return Lesson(None, reason, trend)
    shapes = np.array([c.shape for c in cycles])
    shape = shapes.mean(axis=0)
    speed, duration = np.log([c.speed for c in cycles]), np.log([c.duration_s for c in cycles])
    spread = np.array([np.sqrt(np.mean((shapes - shape) ** 2)), speed.std(), duration.std()])
    tolerance = np.maximum(TOLERANCE, 3 * spread)
    if np.any(tolerance > LOOSEST * TOLERANCE):
        return Lesson(None, "the cycles differ too much from one another to be told from another use", trend)
    blank = Activity(
        level=float(position[:, 0].mean()),
        log_scale=float(position[:, 1].mean()),
        shape=shape,
        first_shape=shape,
        log_speed=float(speed.mean()),
        log_duration=float(duration.mean()),
        rest=float(rests.mean()),
        rest_scatter=float(_trend(rests[:, None])[1][0]),
        features=_covariance(np.column_stack([rests, position])) + np.diag(NOISE_FLOOR**2),
        bias=np.zeros(2),
        noise=np.zeros((2, 2)),
        tolerance=tolerance,
        doubt=np.zeros((2, 2)),
        is_imposed=_core_scatter(duration) < MACHINE_TIMING,
    )
    drifts = np.array([blank.drift_of(cycle, rest_is_low) for cycle in cycles])
    noise = _covariance(drifts) + np.diag(NOISE_FLOOR[:2] ** 2)
    activity = replace(blank, bias=drifts.mean(axis=0), noise=noise, doubt=noise / len(cycles))
    return Lesson(activity, "", trend)


def _covariance(values: Array) -> Array:
    """Return the (k, k) covariance of (n, k) values about a straight line over their index: a drift is no noise."""
    slope, _ = _trend(values)
    time = np.linspace(-0.5, 0.5, len(values))
    left = values - values.mean(axis=0) - np.outer(time, slope)
    return np.asarray(left.T @ left / (len(values) - 2) * (1 + FEW / (len(values) - 2)))


def _core_scatter(values: Array) -> float:
    """Return the standard deviation without the tenth, one at least, that is furthest from the median."""
    distance = np.abs(values - np.median(values))
    kept = np.argsort(distance, kind="stable")[: len(values) - max(1, len(values) // 10)]
    return float(values[kept].std())


def _trend(values: Array) -> tuple[Array, Array]:
    """Return change and scatter of (n, k) values along a straight line over their index."""
    time = np.linspace(-0.5, 0.5, len(values))
    slope = time @ values / (time @ time)
    left = values - values.mean(axis=0) - np.outer(time, slope)
    return slope, left.std(axis=0)


@dataclass(frozen=True, eq=False)
class CalibratedUse:
    """The use a unit was calibrated with: the frame in which its drift is told, and what is compared with it.

    Args:
        mean, scale: of the output over the cycles, in its unit; 0 and 1 of every other number here.
        low, high: where the output turned, in its unit.
        duration_s: length of the recording.
        usual, usual_s: samples and seconds of a cycle.
        longest: most samples of a cycle.
        rest_is_low: whether the unloaded output is the lower one.
        zero: output at zero load, in scales about the mean; None where it is not known.
        lesson: the activity of the recording.
    """

    mean: float
    scale: float
    low: float
    high: float
    duration_s: float
    usual: float
    usual_s: float
    longest: int
    rest_is_low: bool
    zero: float | None
    lesson: Lesson


def learn_use(recording: OutputRecording, rest_is_low: bool, zero_output: float | None = None) -> CalibratedUse:
    """Learn from the recording a unit was calibrated with.

    Args:
        recording: the unit's output at calibration.
        rest_is_low: whether the unloaded output is the lower one.
        zero_output: output at zero load, in its unit; None where it is not known.
    """
    low, high = (float(v) for v in np.quantile(recording.output, (0.02, 0.98)))
    longest = max(1, int(LONGEST_CYCLE * len(recording)))
    cutter = CycleCutter(low, high, longest, longest)
    cycles = []
    for segment in recording.segments:
        cutter.restart()
        # In pieces: a cycle is judged where it ends, with the swing known by then.
        for start in range(segment.start, segment.stop, 32):
            piece = slice(start, min(start + 32, segment.stop))
            cycles += [c for c in cutter.advance(recording.t_s[piece], recording.output[piece]) if c.is_complete]
    is_covered = sum(c.duration_s for c in cycles) > 0.5 * float(np.ptp(recording.t_s))
    mean, scale = float(recording.output.mean()), max(float(recording.output.std()), 1e-300)
    if len(cycles) >= MIN_CYCLES and is_covered:
        mean = float(np.mean([c.level for c in cycles]))
        scale = float(np.exp(np.mean([np.log(c.scale) for c in cycles])))
    lesson = learn_activity([c.standardised(mean, scale) for c in cycles], rest_is_low)
    if not is_covered:
        lesson = Lesson(None, "the calibration recording is no sequence of cycles", np.zeros(2))
    usual_s = float(np.median([c.duration_s for c in cycles])) if cycles else longest / recording.sample_rate_Hz
    usual = recording.sample_rate_Hz * usual_s
    duration_s = float(np.ptp(recording.t_s))
    zero = None if zero_output is None else (zero_output - mean) / scale
    return CalibratedUse(mean, scale, low, high, duration_s, usual, usual_s, longest, rest_is_low, zero, lesson)
