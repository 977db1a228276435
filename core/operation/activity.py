"""What use looks like while nothing drifts: steady activities, learnt from their cycles and recognised again.

An activity is described by the mean and covariance of features of its cycles. A cycle belongs to it when the features
that drift cannot change (standardised distribution, speed, duration) are within the activity's tolerance. The features
that drift does change (level and scale) then measure the drift.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from softcal.core.metrics import rms
from softcal.core.operation.cycles import Cycle, CycleSegmenter
from softcal.core.operation.method import ActivityConfig, DriftTracking
from softcal.core.operation.stored_state import array_field
from softcal.core.recording import Array, OutputRecording


@dataclass(frozen=True, eq=False)
class Activity:
    """One way of use: how its cycles look, and how much they differ. In scales of the calibrated use.

    Args:
        level, log_scale: mean, and log standard deviation.
        shape, first_shape: (q,) standardised quantiles now, and when the activity was first seen.
        course, course_tolerance: (q,) mean course of a cycle over its time, and the largest difference (RMS) from it.
        rest: level of the unloaded turning point.
        rest_scatter: its standard deviation.
        features: (3, 3) covariance of one cycle's rest, level and scale about their trend.
        bias, noise: (2,) mean and (2, 2) covariance of the drift that `estimate_drift` finds in its own cycles.
        tolerance: (3,) largest differences in shape, log speed and log duration.
        drift_covariance: (2, 2) covariance of the mean drift of its own cycles.
        regularity: how regularly its cycles come: 1 where a machine times them, 0 where a person does.
        pivots: (2, u) log gains that a change of its loads shows, rising, and the level each leaves where it was.
    """

    level: float
    log_scale: float
    shape: Array = field(metadata=array_field("q"))
    first_shape: Array = field(metadata=array_field("q"))
    course: Array = field(metadata=array_field("q"))
    course_tolerance: float
    log_speed: float
    log_duration: float
    rest: float
    rest_scatter: float
    has_rest: bool
    features: Array = field(metadata=array_field(3, 3))
    bias: Array = field(metadata=array_field(2))
    noise: Array = field(metadata=array_field(2, 2))
    tolerance: Array = field(metadata=array_field(3))
    drift_covariance: Array = field(metadata=array_field(2, 2))
    regularity: float
    pivots: Array = field(metadata=array_field(2, "u"))

    @property
    def is_imposed(self) -> bool:
        """Whether a machine times its cycles."""
        return self.regularity == 1

    def estimate_drift(self, cycle: Cycle, rest_is_low: bool) -> Array:
        """Return the (2,) shift and log gain under which a cycle is one of this activity.

        Weighted least squares of three equations in shift mu and gain g: rest, level and scale of the cycle are
        mu + g rest, mu + g level and g scale of the activity. A steady rest has a small variance and so determines
        the shift, however much the height of presses varies.
        """
        design = np.array([[1.0, self.rest], [1.0, self.level], [0.0, 1.0]])
        observed = np.array([cycle.rest(rest_is_low), cycle.level, cycle.scale / np.exp(self.log_scale)])
        weighted = np.linalg.solve(self.features, design)
        shift, gain = np.linalg.solve(design.T @ weighted, weighted.T @ observed)
        return np.array([shift, np.log(max(gain, 1e-6))]) - self.bias

    def distance(self, cycle: Cycle) -> float:
        """Return the largest difference of a cycle from this activity, 1 at its tolerance.

        Level and scale do not count: drift changes them.
        """
        difference = (
            rms(cycle.shape - self.shape),
            abs(np.log(cycle.speed) - self.log_speed),
            abs(np.log(cycle.duration_s) - self.log_duration),
        )
        return float(np.max(difference / self.tolerance))

    def similarity(self, cycle: Cycle) -> float:
        """Return how like the course of a cycle is to this activity's: 1 where an affine map joins them, to 0.

        The course holds the order of loads within a cycle, its rise against its fall, its loop and its onset.
        """
        return max(0.0, 1.0 - float(np.mean((cycle.course - self.course) ** 2)) / self.course_tolerance**2)

    def with_cycle(self, cycle: Cycle, weight: float) -> "Activity":
        """Return the activity with its shape moved towards a cycle, never further than its tolerance from the first."""
        shape = self.shape + weight * (cycle.shape - self.shape)
        # Without this bound a chain of small changes would accept any use in the end.
        if rms(shape - self.first_shape) > self.tolerance[0]:
            return self
        return replace(self, shape=shape)


@dataclass(frozen=True, eq=False)
class LearningResult:
    """What cycles taught: an activity, or why there is none.

    Args:
        trend, trend_sd: (2,) change of level and log scale over the cycles, and its standard deviation.
    """

    activity: Activity | None
    reason: str
    trend: Array
    trend_sd: Array = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True, eq=False)
class RestCurve:
    """The characteristic of a sensor at rest, as f∘γ₀ knows it: (n,) rising outputs, and what each is estimated as."""

    output: Array
    load: Array

    def scale_load(self, output: Array, share: float) -> Array:
        """Return what outputs would have been, had their loads been so many times as large."""
        # Rising by force: f may bend back beyond what it was trained on, where there is no inverse.
        sign = 1.0 if self.load[-1] >= self.load[0] else -1.0
        load = np.maximum.accumulate(sign * self.load)
        return np.asarray(np.interp(share * np.interp(output, self.output, load), load, self.output))


def learn_activity(
    cycles: Sequence[Cycle], rest_is_low: bool, method: DriftTracking, curve: RestCurve | None = None
) -> LearningResult:
    """Describe the activity of consecutive complete cycles, in scales of the calibrated use."""
    config = method.activity
    if len(cycles) < config.min_cycles:
        reason = f"{len(cycles)} cycles of use, {config.min_cycles} are needed to compare with"
        return LearningResult(None, reason, np.zeros(2))
    rests = np.array([c.rest(rest_is_low) for c in cycles])
    position = np.array([[c.level, np.log(c.scale)] for c in cycles])
    trend, scatter = _trend(position)
    if scatter.max() > config.steady or np.abs(trend).max() > config.tolerance_sigmas * config.steady:
        reason = f"use is not steady: cycles scatter by {scatter.max():.2g} and wander by {np.abs(trend).max():.2g}"
        return LearningResult(None, reason, trend)
    shapes = np.array([c.shape for c in cycles])
    shape = shapes.mean(axis=0)
    courses = np.array([c.course for c in cycles])
    course = courses.mean(axis=0)
    speed, duration = np.log([c.speed for c in cycles]), np.log([c.duration_s for c in cycles])
    spread = np.array([rms(shapes - shape), speed.std(), duration.std()])
    min_tolerance = np.array(config.tolerance)
    tolerance = np.maximum(min_tolerance, config.tolerance_sigmas * spread)
    if np.any(tolerance > config.tolerance_sigmas * min_tolerance):
        return LearningResult(None, "the cycles differ too much from one another to be told from another use", trend)
    rest_scatter = float(_trend(rests[:, None])[1][0])
    blank = Activity(
        level=float(position[:, 0].mean()),
        log_scale=float(position[:, 1].mean()),
        shape=shape,
        first_shape=shape,
        course=course,
        course_tolerance=max(min_tolerance[0], config.tolerance_sigmas * rms(courses - course)),
        log_speed=float(speed.mean()),
        log_duration=float(duration.mean()),
        rest=float(rests.mean()),
        rest_scatter=rest_scatter,
        has_rest=rest_scatter <= method.attribution.step,
        features=_covariance(np.column_stack([rests, position]), config.min_scatter),
        bias=np.zeros(2),
        noise=np.zeros((2, 2)),
        tolerance=tolerance,
        drift_covariance=np.zeros((2, 2)),
        regularity=timing_regularity(duration, config),
        pivots=np.zeros((2, 0)),
    )
    # The estimator is not linear in the gain: what it finds in the activity's own cycles is its bias, and how much
    # that scatters is the measurement noise of the filter.
    drifts = np.array([blank.estimate_drift(cycle, rest_is_low) for cycle in cycles])
    noise = _covariance(drifts, config.min_scatter)
    pivots = blank.pivots if curve is None else _find_pivots(blank, rest_is_low, curve, config.load_factors)
    mean_noise = noise / len(cycles)
    activity = replace(blank, bias=drifts.mean(axis=0), noise=noise, drift_covariance=mean_noise, pivots=pivots)
    return LearningResult(activity, "", trend, trend_sd(scatter, len(cycles)))


def _covariance(values: Array, min_scatter: float) -> Array:
    """Return the (k, k) covariance of (n, k) values about a straight line over their index: a drift is no noise."""
    slope, _ = _trend(values)
    time = np.linspace(-0.5, 0.5, len(values))
    residuals = values - values.mean(axis=0) - np.outer(time, slope)
    # Two degrees of freedom went to the line. Few cycles may differ by less than usual by chance: widened for that.
    free = len(values) - 2
    scatter = residuals.T @ residuals / free * (1 + 2 / free)
    return np.asarray(scatter + min_scatter**2 * np.eye(len(scatter)))


def _find_pivots(activity: Activity, rest_is_low: bool, curve: RestCurve, shares: tuple[float, ...]) -> Array:
    """Return the log gains that a change of the loads shows, rising, and the level each leaves where it was."""
    typical_output = activity.level + np.exp(activity.log_scale) * activity.shape

    def drift_at(output: Array) -> Array:
        cycle = Cycle(
            output.mean(), output.std(), output[0], output[-1], activity.shape, activity.course, 1, 1, 0, True
        )
        return activity.estimate_drift(cycle, rest_is_low)

    shifts, log_gains = np.array(
        [drift_at(curve.scale_load(typical_output, share)) - drift_at(typical_output) for share in shares]
    ).T
    # Beyond its range a sensor saturates, and more load does not show.
    is_observed = np.concatenate([[True], np.diff(log_gains) > 0]) & (np.sign(log_gains) == np.sign(np.log(shares)))
    shifts, log_gains = shifts[is_observed], log_gains[is_observed]
    return np.array([log_gains, -shifts / np.expm1(log_gains)])


def timing_regularity(log_durations: Array, config: ActivityConfig) -> float:
    """Return 1 for (n,) log durations that scatter as a machine's do, to 0 at twice that; a few outliers aside."""
    distance = np.abs(log_durations - np.median(log_durations))
    count = len(distance) - max(1, len(distance) // config.machine_cycles)
    nearest = np.argsort(distance, kind="stable")[: max(1, count)]
    return float(np.clip(2 - log_durations[nearest].std() / config.min_scatter, 0, 1))


def trend_sd(scatter: Array | float, count: int) -> Array:
    """Return the standard deviation of a least squares slope over an index from -1/2 to 1/2."""
    return np.asarray(scatter * np.sqrt(12 / count))


def _trend(values: Array) -> tuple[Array, Array]:
    """Return change and scatter of (n, k) values along a straight line over their index."""
    time = np.linspace(-0.5, 0.5, len(values))
    slope = time @ values / (time @ time)
    residuals = values - values.mean(axis=0) - np.outer(time, slope)
    return slope, residuals.std(axis=0)


@dataclass(frozen=True, eq=False)
class CalibratedOperation:
    """The use a unit was calibrated with: origin and unit of its drift, and what later use is compared with.

    Args:
        mean, scale: of the output over the cycles, in its unit; 0 and 1 of every other number here.
        low, high: where the output turned, in its unit.
        zero: output at zero load, in scales about the mean; None where it is not known.
        curve: characteristic of the sensor; None where it is not known.
    """

    mean: float
    scale: float
    low: float
    high: float
    duration_s: float
    cycle_samples: float
    typical_cycle_s: float
    max_samples: int
    rest_is_low: bool
    zero: float | None
    learning: LearningResult
    curve: RestCurve | None = None


def learn_operation(
    recording: OutputRecording,
    rest_is_low: bool,
    zero_output: float | None = None,
    method: DriftTracking = DriftTracking(),  # noqa: B008 - frozen
    curve: RestCurve | None = None,
) -> CalibratedOperation:
    """Learn from the recording a unit was calibrated with.

    Its output at zero load and its characteristic, in its own unit, are None where they are not known.
    """
    low, high = (float(v) for v in np.quantile(recording.output, method.cycle.swing))
    # A cycle that takes longer is not seen twice.
    max_samples = max(1, len(recording) // 2)
    segmenter = CycleSegmenter(low, high, max_samples, max_samples, method.cycle)
    cycles = []
    for segment in recording.segments:
        segmenter.restart()
        # In batches, as a stream is: a cycle is judged where it ends, with the swing known by then.
        for start in range(segment.start, segment.stop, method.stream.batch):
            piece = slice(start, min(start + method.stream.batch, segment.stop))
            cycles += [c for c in segmenter.advance(recording.t_s[piece], recording.output[piece]) if c.is_complete]
    is_covered = sum(c.duration_s for c in cycles) > 0.5 * float(np.ptp(recording.t_s))
    mean, scale = float(recording.output.mean()), max(float(recording.output.std()), 1e-300)
    if len(cycles) >= method.activity.min_cycles and is_covered:
        # Means over cycles, not over samples: long rests before and after the presses are no use.
        mean = float(np.mean([c.level for c in cycles]))
        scale = float(np.exp(np.mean([np.log(c.scale) for c in cycles])))
    if curve is not None:
        curve = RestCurve((curve.output - mean) / scale, curve.load)
    standard = [c.standardised(mean, scale) for c in cycles]
    learning = learn_activity(standard, rest_is_low, method, curve)
    if not is_covered:
        learning = LearningResult(None, "the calibration recording is no sequence of cycles", np.zeros(2))
    typical_s = float(np.median([c.duration_s for c in cycles])) if cycles else max_samples / recording.sample_rate_Hz
    typical_samples = recording.sample_rate_Hz * typical_s
    # A sensor that creeps takes a while to settle under a use that begins: that is no drift.
    if len(settled := standard[math.ceil(method.stream.settling / typical_samples) :]) > 2:
        slope, scatter = _trend(np.array([[c.level, np.log(c.scale)] for c in settled]))
        sd = trend_sd(np.maximum(scatter, method.activity.min_scatter), len(settled))
        learning = replace(learning, trend=slope * len(cycles) / len(settled), trend_sd=sd * len(cycles) / len(settled))
    duration_s = float(np.ptp(recording.t_s))
    zero = None if zero_output is None else (zero_output - mean) / scale
    return CalibratedOperation(
        mean, scale, low, high, duration_s, typical_samples, typical_s, max_samples, rest_is_low, zero, learning, curve
    )
