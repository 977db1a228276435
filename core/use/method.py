"""The method of long use: every number that decides how a unit in use is followed or trimmed, each with its origin.

A number that decides stands here, nowhere else in this folder. The whole is kept with every stream that is followed.
So an upgrade that changes a number shows in the record of the stream (`changes`).
"""

from dataclasses import dataclass, field

from softcal.core.settings import NumberedMethod, setting
from softcal.core.windows import TAPS

HARM = "streams of benchmarks/long_use.py --seed 0, which docs do not report"
"""Origin of what was chosen on simulated streams; docs/long-term.md reports other seeds."""

JOINED = "random presses of a simulated station: single ones differ too much, means over eight do not"

WINDOW = "the length of a window"


@dataclass(frozen=True)
class IntakeConfig:
    """From rows of a stream to windows (`intake.py`).

    Args:
        batch: rows worked through together; a new correction holds from the next batch on.
        rate_tolerance: a window whose mean sample period differs from the calibration's by more than this share is
            not used.
        clock_rows: so many rows in a row with increasing times before the last one taken are a restarted clock.
        short_gap: a gap of up to so many sample periods does not break the cycle it falls into.
        silent_batches: so many batches without a usable sample raise the alarm.
    """

    batch: int = setting(32)
    rate_tolerance: float = setting(0.10)
    clock_rows: int = setting(TAPS, WINDOW)
    short_gap: int = setting(TAPS, WINDOW)
    silent_batches: int = setting(8)


@dataclass(frozen=True)
class CycleConfig:
    """Segmentation of a stream into cycles of use, and their features (`cycles.py`).

    Args:
        swing: quantiles of a stretch that stand for its turning points, robust to a few outlying samples.
        band: hysteresis thresholds as shares of the swing: a cycle ends where the output rises through the upper one
            after it was below the lower one.
        memory: weight of the newest cycle in the exponential mean of swing and duration.
        overdue: after so many usual durations without a turn the swing is estimated anew.
        least_swing: a new swing below this share of the calibrated one is a pause and changes nothing.
        min_samples: shorter cycles are joined until they have this many samples.
        kept: samples of a cycle kept for its quantiles; a longer cycle is decimated evenly.
        quantiles: number of quantiles that describe the distribution of a cycle.
        turning_parts: the lowest and the highest of so many equal parts of the sorted samples give the turning points.
        longest: a cycle takes this share of the calibration recording at most.
        joined: usual cycles that are taken together as one, one number after the other while a use stays unsteady.
    """

    swing: tuple[float, float] = setting((0.02, 0.98))
    band: tuple[float, float] = setting((0.3, 0.7))
    memory: float = setting(0.2)
    overdue: float = setting(1.5)
    least_swing: float = setting(0.3)
    min_samples: int = setting(32)
    kept: int = setting(512)
    quantiles: int = setting(16)
    turning_parts: int = setting(16)
    longest: float = setting(0.5)
    joined: tuple[int, ...] = setting((8, 16, 32), JOINED)


@dataclass(frozen=True)
class ActivityConfig:
    """When cycles are one activity, and when a new cycle belongs to it (`activity.py`).

    Args:
        min_cycles: fewer cycles give no covariance.
        steady_scatter, steady_trend: level and log scale of an activity's cycles scatter about a straight line by less
            than the first and change along it by less than the second, in scales.
        tolerance: least tolerance for a cycle's quantiles (RMS, in scales), log speed and log duration.
        tolerance_sigmas: the tolerance in standard deviations of the activity's own cycles, where that is larger.
        loosest: an activity that needs so many times the least tolerance would accept any use and is none.
        noise_floor: smallest standard deviations of one cycle's rest, level and log scale.
        few: with n cycles the covariance is widened by this over n - 2.
        least_gain: smallest gain a cycle is read as.
        machine_timing: cycles whose log durations scatter by less than this are timed by a machine.
        machine_cycles: of a use learnt in use, so many cycles at least show that; of six cycles of a person whose times
            scatter by 4 %, one set in a hundred does by chance.
        still_timed: the latest `machine_cycles` are no longer timed by one where they scatter by so many times as much.
        outliers: one of so many durations, the furthest from the median, is left out of that scatter.
        rest_scatter: an activity returns to a known rest where its unloaded turning points scatter by less than this,
            in scales.
        covered: cycles must cover this share of a recording to stand for it.
        uses: loads in shares of an activity's own, for which it is worked out what a change of use does to the output.
    """

    min_cycles: int = setting(4)
    steady_scatter: float = setting(0.25)
    steady_trend: float = setting(0.8)
    tolerance: tuple[float, float, float] = setting((0.10, 0.15, 0.25))
    tolerance_sigmas: float = setting(3.0)
    loosest: float = setting(3.0)
    noise_floor: tuple[float, float, float] = setting((0.01, 0.01, 0.01))
    few: float = setting(2.0)
    least_gain: float = setting(1e-3)
    machine_timing: float = setting(0.01)
    machine_cycles: int = setting(10, "chance, of a chi-square with 8 degrees of freedom: one in ten thousand")
    still_timed: float = setting(2.0, "chance, of a chi-square with 8 degrees of freedom: one in a thousand")
    outliers: int = setting(10)
    rest_scatter: float = setting(0.10)
    covered: float = setting(0.5)
    uses: tuple[float, ...] = setting((0.4, 0.6, 0.8, 0.9, 1.1, 1.25, 1.5, 2.0), "the range of docs/long-term.md")


@dataclass(frozen=True)
class DriftConfig:
    """The random-walk Kalman filter over cycles (`tracker.py`, `filter.py`).

    Args:
        prior: standard deviation of shift and log gain that accrues over the length of the calibration recording.
        unseen: standard deviation of shift that accrues beside it in use as long that was not compared.
        start_doubt: standard deviation of what may have happened before the stream, or in an interruption of it.
        memory_cycles, memory_samples: effective averaging length of the filter at rest, the longer one of the two.
        settling_samples: samples of known use after a start before any correction is applied.
        trend_weight: forgetting factors of two mean innovations, a quick and a slow one: weight of the newest cycle.
        pace: squared Mahalanobis distance of the mean innovation from zero up to which it is chance.
        fastest: the process noise grows up to this factor while innovations keep one sign.
        largest: no shift and no log gain beyond these is followed.
    """

    prior: tuple[float, float] = setting((0.02, 0.012))
    unseen: float = setting(0.05, "streams of benchmarks/long_use.py --seed 9780, which docs do not report")
    start_doubt: tuple[float, float] = setting((0.10, 0.05))
    memory_cycles: float = setting(20)
    memory_samples: float = setting(2560)
    settling_samples: int = setting(256)
    trend_weight: tuple[float, float] = setting((0.1, 0.03), HARM)
    pace: float = setting(12.0)
    fastest: float = setting(400.0)
    largest: tuple[float, float] = setting((1.5, 0.6))


@dataclass(frozen=True)
class JumpConfig:
    """Change detection: a cycle too far from the prediction to be drift (`jumps.py`).

    Args:
        sigmas, floor: rest or log gain of a jump differ from the prediction by more than so many standard deviations
            and by more than the floor.
        cycles: like cycles that decide between a re-seated sensor and another use.
        most: like cycles kept while they cannot decide.
        recent: so many cycles before show at what size a machine pressed.
        largest: no jump of shift and log gain beyond these is followed.
        largest_sigmas: the largest jump in standard deviations of the prior of a re-seating.
        rest_sigmas: a rest has moved where it is off by so many times its usual scatter.
        end_quantiles: quantiles at the unloaded end that show how steady a rest is.
    """

    sigmas: float = setting(4.0)
    floor: tuple[float, float] = setting((0.08, 0.12))
    cycles: int = setting(2)
    most: int = setting(8)
    recent: int = setting(3)
    largest: tuple[float, float] = setting((1.0, 0.35))
    largest_sigmas: float = setting(3.0)
    rest_sigmas: float = setting(4.0)
    end_quantiles: int = setting(3)


@dataclass(frozen=True)
class LearningConfig:
    """Learning a new activity in use (`learning.py`, improved mode).

    Args:
        cycles, joined_cycles: so many cycles at least; of cycles that are several taken together, so many. Where these
            are unsteady, more are taken together.
        length: that cover this share of the calibration recording's length.
        most_cycles: cycles kept while they do not.
        activities: known at most; the oldest learnt one is forgotten first.
        refresh: forgetting factor of an activity's shape: weight of the newest cycle.
        first_use_s: for so long a unit whose calibration shows no activity may go without any before use that could not
            be compared counts towards the alarm.
    """

    cycles: int = setting(6)
    joined_cycles: int = setting(12)
    length: float = setting(0.25)
    most_cycles: int = setting(64)
    activities: int = setting(3)
    refresh: float = setting(0.05)
    first_use_s: float = setting(86_400.0)


@dataclass(frozen=True)
class TrustConfig:
    """Which part of an estimated drift is applied (`trust.py`).

    Args:
        shrink: soft threshold: a drift below the first number of standard deviations is not applied, above the second
            in full, in between linearly.
        use_share: prior probability that a change of amplitude is use and not gain.
        step: hysteresis: movements of the rest count once they exceed this, in scales.
        creep: the unloaded turning point follows the mean load by up to this share, up to `step`.
        least_rest: a rest nearer to the mean than this, in scales, counts as that far.
        preload: a use that rests further from zero load than this, in scales, is preloaded.
        open_share: less than this share of a sure log gain applied means that use explains the rest of it.
    """

    shrink: tuple[float, float] = setting((3.0, 5.0))
    use_share: float = setting(0.5)
    step: float = setting(0.08)
    creep: float = setting(0.5)
    least_rest: float = setting(0.5)
    preload: float = setting(0.15, HARM)
    open_share: float = setting(0.9)


@dataclass(frozen=True)
class DoubtConfig:
    """The predicted error of a unit in use, and the alarm (`adapter.py`, `tracker.py`).

    Args:
        correction: share of an applied correction that stays in doubt: drift is neither affine nor all of it seen.
        way: the same for the whole way the rest has gone: a moving sensor is followed late.
        unseen: drift in scales that may have come in use as long as the calibration recording that was not compared.
        certain: a drift that is seen and not applied, and a mean innovation, count where their squares exceed so many
            times what chance makes of them.
        alarm_ratio, clear_ratio: rows are unsettled where the predicted error is more than the first number of times
            that of the calibration. Where what may be use brings it there, the map is held until it falls below the
            second.
        alarm_cycles: for so many usual cycles on end, so that one odd cycle decides nothing.
        swap: a new correction replaces the old one when it moves an extreme of the output by this share of its scale.
        slope_rows, slope_step: windows, and step in scales, over which the mean slope of the estimate is taken.
        zero_levels: constant outputs at which the level of zero load is searched.
    """

    correction: float = setting(0.2, HARM)
    way: float = setting(0.12, HARM)
    unseen: float = setting(0.2, HARM)
    certain: float = setting(2.0, HARM)
    alarm_ratio: float = setting(2.0)
    clear_ratio: float = setting(1.5, HARM)
    alarm_cycles: float = setting(4.0, HARM)
    swap: float = setting(0.005)
    slope_rows: int = setting(4000)
    slope_step: float = setting(0.05)
    zero_levels: int = setting(300)


@dataclass(frozen=True)
class TrimConfig:
    """Re-anchoring by known loads at the place of use (`trim.py`).

    Args:
        most_change: a gain that changes by more than this share is another unit, or other units of load. The device
            holds no larger one.
        most_misfit: loads that are still misread by more than so many standard uncertainties contradict one another.
    """

    most_change: float = setting(0.5, "docs/format.md")
    most_misfit: float = setting(3.0)


@dataclass(frozen=True)
class OnlineConfig:
    """The paper's online method (`queued.py`); the numbers of its plan are those of `Method.map.plan`.

    Args:
        queue: windows in a queue; a new map is fitted on every full one.
        pieces: queues of the calibration recording that show what maps of such queues get wrong by chance.
        blind: above this share of the scatter of the estimates they get too much wrong to show a drift.
    """

    queue: int = setting(512)
    pieces: int = setting(3)
    blind: float = setting(0.25)


@dataclass(frozen=True)
class UseMethod(NumberedMethod):
    """How a unit in use is followed and trimmed; one configuration for every sensor.

    Args:
        version: raised when the code computes otherwise from the same numbers.
        intake, cycle, activity, drift, jump, learning, trust, doubt, trim, online: a section a module or concern.
    """

    version: int = setting(7, "raised by hand")
    intake: IntakeConfig = field(default_factory=IntakeConfig)
    cycle: CycleConfig = field(default_factory=CycleConfig)
    activity: ActivityConfig = field(default_factory=ActivityConfig)
    drift: DriftConfig = field(default_factory=DriftConfig)
    jump: JumpConfig = field(default_factory=JumpConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)
    trust: TrustConfig = field(default_factory=TrustConfig)
    doubt: DoubtConfig = field(default_factory=DoubtConfig)
    trim: TrimConfig = field(default_factory=TrimConfig)
    online: OnlineConfig = field(default_factory=OnlineConfig)

    def changes(self, earlier: "UseMethod") -> list[str]:
        """Return `name: earlier value, now value` for every number that differs."""
        before = {name: value for name, value, _ in earlier.numbers()}
        return [f"{name}: {before[name]}, now {value}" for name, value, _ in self.numbers() if value != before[name]]
