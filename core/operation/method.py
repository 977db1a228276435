"""The method of long use: every number that decides how a unit in use is followed, each with its origin.

A number that decides stands here, nowhere else in this folder. The whole is kept with every stream that is followed.
So an upgrade that changes a number shows in the record of the stream (`changes`).
"""

from dataclasses import dataclass, field

from softcal.core.settings import NumberedMethod, setting

HARM = "streams of benchmarks/long_use.py --seed 0, which docs do not report"
"""Origin of what was chosen on simulated streams; docs/long-term.md reports other seeds."""

RANDOM_PRESSES = "random presses of a simulated station: single ones differ too much, means over eight do not"


@dataclass(frozen=True)
class StreamConfig:
    """From rows of a stream to windows (`stream_windows.py`).

    Args:
        batch: rows worked through together; a new correction holds from the next batch on.
        rate_tolerance: a window whose mean sample period differs from the calibration's by more than this share is
            not used.
        settling: samples of known use after a start before any correction is applied; so many without a usable one
            raise the alarm.
    """

    batch: int = setting(32)
    rate_tolerance: float = setting(0.10)
    settling: int = setting(256)


@dataclass(frozen=True)
class CycleConfig:
    """Segmentation of a stream into cycles of use, and their features (`cycles.py`).

    Args:
        swing: quantiles of a stretch that stand for its turning points, robust to a few outlying samples.
        band: hysteresis thresholds as shares of the swing: a cycle ends where the output rises through the upper one
            after it was below the lower one. A swing below the lower one's share of the calibrated one is a pause.
        memory: weight of the newest cycle in the exponential mean of swing and duration.
        overdue: after so many usual durations without a turn the swing is estimated anew.
        quantiles: number of quantiles that describe the distribution of a cycle; the means of the lowest and the
            highest of as many parts of its sorted samples are its turning points.
        joined: usual cycles that are taken together as one, one number after the other while a use stays unsteady.
    """

    swing: tuple[float, float] = setting((0.02, 0.98))
    band: tuple[float, float] = setting((0.3, 0.7))
    memory: float = setting(0.2)
    overdue: float = setting(1.5)
    quantiles: int = setting(16)
    joined: tuple[int, ...] = setting((8, 16, 32), RANDOM_PRESSES)


@dataclass(frozen=True)
class ActivityConfig:
    """When cycles are one activity, and when a new cycle belongs to it (`activity.py`).

    Args:
        min_cycles: fewer cycles give no covariance; so many decide where one odd cycle must not.
        steady: level and log scale of an activity's cycles scatter about a straight line by less than this, in scales,
            and change along it by less than `tolerance_sigmas` times as much.
        tolerance: least tolerance for a cycle's quantiles (RMS, in scales), log speed and log duration.
        tolerance_sigmas: the tolerance in standard deviations of the activity's own cycles, where that is larger. An
            activity that needs so many times the least tolerance would accept any use and is none.
        min_scatter: cycles whose log durations scatter by less are timed by a machine. No rest, level or log scale
            is taken to scatter by less.
        machine_cycles: of a use learnt in use, so many cycles at least show a machine; of six cycles of a person whose
            times scatter by 4 %, one set in a hundred does by chance. One of so many may be an outlier. The latest are
            no longer timed by one where they scatter by twice `min_scatter`: one set in a thousand does by chance.
        load_factors: loads in shares of an activity's own, for which it is worked out what a change of use does to the
            output.
    """

    min_cycles: int = setting(4)
    steady: float = setting(0.25)
    tolerance: tuple[float, float, float] = setting((0.10, 0.15, 0.25))
    tolerance_sigmas: float = setting(3.0)
    min_scatter: float = setting(0.01)
    machine_cycles: int = setting(10, "chance, of a chi-square with 8 degrees of freedom: one in ten thousand")
    load_factors: tuple[float, ...] = setting(
        (0.4, 0.6, 0.8, 0.9, 1.1, 1.25, 1.5, 2.0), "the range of docs/long-term.md"
    )


@dataclass(frozen=True)
class DriftConfig:
    """The random-walk Kalman filter over cycles (`tracker.py`, `drift_filter.py`).

    Args:
        prior: standard deviation of shift and log gain that accrues over the length of the calibration recording.
        unobserved: standard deviation of shift that accrues beside it in use as long that was not compared. Interval
            and predicted error reckon with `JumpConfig.sigmas` of them.
        start_sd: standard deviation of what may have happened before the stream, or in an interruption of it.
        memory_cycles: effective averaging length of the filter at rest, and of the shape of an activity.
        trend_weight: forgetting factors of two mean innovations, a quick and a slow one: weight of the newest cycle.
        pace: squared Mahalanobis distance of the mean innovation from zero up to which it is chance.
        max_drift: no shift and no log gain beyond these is followed.
    """

    prior: tuple[float, float] = setting((0.02, 0.012))
    unobserved: float = setting(0.05, "streams of benchmarks/long_use.py --seed 9780, which docs do not report")
    start_sd: tuple[float, float] = setting((0.10, 0.05))
    memory_cycles: int = setting(20)
    trend_weight: tuple[float, float] = setting((0.1, 0.03), HARM)
    pace: float = setting(12.0)
    max_drift: tuple[float, float] = setting((1.5, 0.6))


@dataclass(frozen=True)
class JumpConfig:
    """Change detection: a cycle too far from the prediction to be drift (`change_detection.py`).

    Args:
        sigmas: rest or log gain of a jump differ from the prediction by more than so many standard deviations, the rest
            by more than so many of its usual scatters.
        log_gain: and the log gain by more than this; the rest by more than `AttributionConfig.step`.
        cycles: like cycles that decide between a re-seated sensor and another use.
        max_jump: no jump of shift and log gain beyond these is followed.
    """

    sigmas: float = setting(4.0)
    log_gain: float = setting(0.12)
    cycles: int = setting(2)
    max_jump: tuple[float, float] = setting((1.0, 0.35))


@dataclass(frozen=True)
class LearningConfig:
    """Learning a new activity in use (`change_detection.py`, improved mode).

    Args:
        cycles: so many cycles at least, twice as many of cycles that are several taken together. Where these are
            unsteady, more are taken together. So many like cycles after a sudden change, which they cannot explain,
            are a new use.
        length: that cover this share of the calibration recording's length.
        max_cycles: cycles kept while they do not.
        activities: known at most; the oldest learnt one is forgotten first.
        first_operation_s: for so long a unit whose calibration shows no activity may go without any before use that
            could not be compared counts towards the alarm.
    """

    cycles: int = setting(6)
    length: float = setting(0.25)
    max_cycles: int = setting(64)
    activities: int = setting(3)
    first_operation_s: float = setting(86_400.0)


@dataclass(frozen=True)
class AttributionConfig:
    """Which part of an estimated drift is applied (`attribution.py`).

    Args:
        soft_threshold: a drift below the first number of standard deviations is not applied, above the second in full,
            in between linearly.
        step: movements of the rest count once they exceed this, in scales (hysteresis). A use whose unloaded turning
            points scatter by more returns to no rest.
        preload: a use that rests further from zero load than this, in scales, is preloaded.
    """

    soft_threshold: tuple[float, float] = setting((3.0, 5.0))
    step: float = setting(0.08)
    preload: float = setting(0.15, HARM)


@dataclass(frozen=True)
class UncertaintyConfig:
    """The predicted error of a unit in use, and the alarm (`adapter.py`, `tracker.py`).

    Args:
        correction: share of an applied correction that stays in doubt, for drift is neither affine nor all of it seen,
            and of the whole way the rest has gone, for a moving sensor is followed late.
        certain: a drift that is seen and not applied, and a mean innovation, count where their squares exceed so many
            times what chance makes of them.
        alarm_ratio: rows are unsettled where the predicted error is more than so many times that of the calibration.
            Where what may be use brings it there, the map is held until it falls below half way.
        swap: a new correction replaces the old one when it moves an extreme of the output by this share of its scale.
    """

    correction: float = setting(0.16, "streams of benchmarks/long_use.py --seed 7001, which docs do not report")
    certain: float = setting(2.0, HARM)
    alarm_ratio: float = setting(2.0)
    swap: float = setting(0.005)


@dataclass(frozen=True)
class OnlineConfig:
    """The paper's online method (`queued_transport.py`); the numbers of its plan are those of `maps/plan.py`.

    Args:
        queue: windows in a queue; a new map is fitted on every full one.
        blind: above this share of the scatter of the estimates, queues get too much wrong by chance to show a drift.
    """

    queue: int = setting(512)
    blind: float = setting(0.25)


@dataclass(frozen=True)
class DriftTracking(NumberedMethod):
    """How a unit in use is followed; one configuration for every sensor.

    Args:
        version: raised when the code computes otherwise from the same numbers.
        stream, cycle, activity, drift, jump, learning, attribution, uncertainty, online: a section a module or concern.
    """

    version: int = setting(9, "raised by hand")
    stream: StreamConfig = field(default_factory=StreamConfig)
    cycle: CycleConfig = field(default_factory=CycleConfig)
    activity: ActivityConfig = field(default_factory=ActivityConfig)
    drift: DriftConfig = field(default_factory=DriftConfig)
    jump: JumpConfig = field(default_factory=JumpConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)
    attribution: AttributionConfig = field(default_factory=AttributionConfig)
    uncertainty: UncertaintyConfig = field(default_factory=UncertaintyConfig)
    online: OnlineConfig = field(default_factory=OnlineConfig)

    def changes(self, earlier: "DriftTracking") -> list[str]:
        """Return `name: earlier value, now value` for every number that differs."""
        before = {name: value for name, value, _ in earlier.numbers()}
        return [f"{name}: {before[name]}, now {value}" for name, value, _ in self.numbers() if value != before[name]]
