"""The method of the proof: every number that decides whether a finished run is a recording, each with its origin."""

from dataclasses import dataclass, field

from softcal.core.inspection.config import DropoutConfig
from softcal.core.settings import NumberedMethod, setting

RIGS = "good rigs of benchmarks/station_proof.py, seeds 0 to 99, 156, 400 to 519 and 600 to 1099"
"""Origin of what was chosen on simulated rigs; docs/results.md reports other seeds."""

CHANGED_RIGS = "good rigs of benchmarks/station_proof.py, seeds 0 to 59, and their outputs changed by 3 % and by 10 %"

LOST_STEP_RIGS = "good rigs of benchmarks/station_faults.py, seeds 3000 to 3499, and lost steps on seeds 4000 to 4049"

LAGGING_RIGS = "good rigs of benchmarks/station_faults.py with a readout that lags, seeds 5000 to 5051"

FILTERED_RIGS = "good rigs of benchmarks/station_proof.py, seeds 8 to 39, as they are and behind a low pass of 0.1 s"


@dataclass(frozen=True)
class CellLagConfig:
    """Thresholds for the latency of a load cell relative to the stage.

    Args:
        latest_s: largest delay that is tried when force and stage are laid over each other.
        coarse_s: steps of these delays.
        apart_s, tells, tells_samples: a delay is known that fits n samples tells + tells_samples / n times better than
            any that is `apart_s` or more away: few samples fit anyhow.
        late_s, period_share: a cell may seem this much later or earlier than declared, and by this share of its
            sampling period.
        hidden: and earlier by this share of a low pass: a unit that relaxes as fast hides that.
    """

    latest_s: float = setting(0.7, RIGS)
    coarse_s: float = setting(0.02, RIGS)
    apart_s: float = setting(0.04, RIGS)
    tells: float = setting(1.1, RIGS)
    tells_samples: float = setting(40.0, RIGS)
    late_s: float = setting(0.01, RIGS)
    period_share: float = setting(0.25, RIGS)
    hidden: float = setting(0.35, FILTERED_RIGS)


@dataclass(frozen=True)
class LawConfig:
    """Terms of a force as a function of depth.

    A soft unit's force relaxes and so leads its depth: without relaxation terms this lead would be taken for an early
    cell.

    Args:
        grid_s: steps of the law; no soft unit and no load cell follows faster than that.
        powers: of the depth.
        relaxed_powers: of the depth, relaxing.
        relaxation_s: times of that.
        every_relaxation_s: where the delay is known, faster and slower terms (none slower than the run) leave less that
            does not belong to the cell.
    """

    grid_s: float = setting(0.01, RIGS)
    powers: tuple[int, ...] = setting((1, 2, 3, 4), RIGS)
    relaxed_powers: tuple[int, ...] = setting((1, 3), RIGS)
    relaxation_s: tuple[float, ...] = setting((0.1, 0.5, 3.0), RIGS)
    every_relaxation_s: tuple[float, ...] = setting((0.03, 0.1, 0.5, 3.0, 30.0), RIGS)


@dataclass(frozen=True)
class ChangeConfig:
    """A cell that changes once in a run.

    Args:
        moments: instants at which it may change.
        share: of what two laws leave, explained by one change at one of them: force by depth, and output by force.
            Softening shows in the first alone, a sensor's drift in the second. To this comes what the best of so many
            changes explains of n samples of noise: 2 ln(changes)/n. Good rigs show 0.10 beyond that at most.
        slight: what moves a law by less than this share of its range (RMS) is no change.
    """

    moments: int = setting(60, RIGS)
    share: float = setting(0.12, RIGS)
    slight: float = setting(0.003, RIGS)


@dataclass(frozen=True)
class HangConfig:
    """A cell that hangs for a moment.

    Args:
        mean_s: its mean force over so long is looked at.
        share: it hangs where that is off the law of the depth by this share of the largest force.
        min_frac, times: or by this share, and so many times the RMS of the rest of the run. Good rigs show 0.29 and 20:
            a unit that softens is stiffest at its first peak.
        apart_s: the rest is all but so much on either side.
        rounds: of the fit by least absolute deviations.
        largest: quantile that represents the largest force.
    """

    mean_s: float = setting(0.1, RIGS)
    share: float = setting(0.3, RIGS)
    min_frac: float = setting(0.03, RIGS)
    times: float = setting(22.0, LOST_STEP_RIGS)
    apart_s: float = setting(0.6, RIGS)
    rounds: int = setting(25, RIGS)
    largest: float = setting(0.99, RIGS)


@dataclass(frozen=True)
class PressConfig:
    """Thresholds for the comparison of two presses.

    Args:
        samples: a press has so many at least.
        shallow: and is deeper than this share of the deepest.
        depths: edges of the depths at which presses are compared.
        pressed: a press is compared where others show this share of the run's largest force.
        gain: largest ratio between the stiffest and the softest press of one run; a cell whose gain halves shows 2.
        output_gain: ratio of outputs. An output may creep and lag by itself; it is compared if no load cell
            says whether the stage moved.
    """

    samples: int = setting(10, RIGS)
    shallow: float = setting(0.1, RIGS)
    depths: int = setting(25, RIGS)
    pressed: float = setting(0.25, RIGS)
    gain: float = setting(1.4, RIGS)
    output_gain: float = setting(1.6, RIGS)


@dataclass(frozen=True)
class OutputConfig:
    """Thresholds for an output.

    Args:
        follows: least share of its variance that goes with the depth; good rigs show 0.84 and more.
        levels: different readings that are needed to know a converter's step.
        span: how many times a bit's weight they must run through.
        rounding: how far from whole steps they may be.
        step, step_share: a change at one moment is said that explains this share of what the law of the output by the
            force leaves, and is this share of the output. Good rigs show 0.2 of the one, 0.07 of the other, not both.
        alone: the output changed and not the cell where it explains so many times more there than of the force.
        drift, drift_range: so is a drift that explains this share, and is over the run this share of the range.
    """

    follows: float = setting(0.7, RIGS)
    levels: int = setting(16, RIGS)
    span: int = setting(2, RIGS)
    rounding: float = setting(0.01, RIGS)
    alone: float = setting(1.5)
    step: float = setting(0.25, CHANGED_RIGS)
    step_share: float = setting(0.02, CHANGED_RIGS)
    drift: float = setting(0.15, CHANGED_RIGS)
    drift_range: float = setting(0.05, CHANGED_RIGS)


@dataclass(frozen=True)
class StrokeConfig:
    """Thresholds for a channel that stays at its level.

    Args:
        way: a stroke of the stage goes over this share of the largest depth.
        lag_s: so long after it the channel may still follow.
        mean_s: its mean over so long is looked at.
        share: it changes in every stroke by this share of its largest change. Good rigs show 0.32 and more.
    """

    way: float = setting(0.6, LAGGING_RIGS)
    lag_s: float = setting(0.3, LAGGING_RIGS)
    mean_s: float = setting(0.1, LAGGING_RIGS)
    share: float = setting(0.15, LAGGING_RIGS)


@dataclass(frozen=True)
class SlipConfig:
    """A stage that lost steps once in a run.

    Args:
        max_residual: largest share that it leaves of the residual of the depth law. Good rigs show 0.47.
        clear: and this share of what any change of the cell leaves.
        max_softening: and of what a unit leaves that softens where it was pressed: it seems a little higher, too.
        min_loss_mm: less is not said.
        candidates_mm: losses that are tried at each moment at which something may change, on so many samples.
        finer: tries around the best of them.
    """

    max_residual: float = setting(0.46, LOST_STEP_RIGS)
    clear: float = setting(0.9, CHANGED_RIGS)
    max_softening: float = setting(0.7, LOST_STEP_RIGS)
    min_loss_mm: float = setting(0.05, CHANGED_RIGS)
    candidates_mm: tuple[float, ...] = setting((-0.4, -0.1, 0.1, 0.2, 0.4, 0.8), CHANGED_RIGS)
    samples: int = setting(400, CHANGED_RIGS)
    finer: int = setting(60, CHANGED_RIGS)


@dataclass(frozen=True)
class ResponseConfig:
    """Thresholds for the response of a load cell's electronics.

    Args:
        earliest_s: smallest delay that is tried: a track of the stage may be so much behind its polls.
        fine_s: steps around the best delay.
        constants_s, finer: time constants of a low pass that are tried, and shares of the best one.
        relaxation_s: times with which a unit's force may relax.
        high_pass_s: slower changes than that are left out.
        tells: a low pass is there that leaves so many times less than none. Good rigs show 1.16 at most.
        max_unexplained: share of the force's range that delay and low pass may leave of its changes (RMS).
        share: a labelled run is refused whose labels it makes wrong (RMS) by this share of the force's range: a quarter
            of 2 %, which a good source leaves.
        limit_share: or by this share of the lot's limit.
    """

    earliest_s: float = setting(-0.02, FILTERED_RIGS)
    fine_s: tuple[float, ...] = setting((-0.01, -0.005, 0.005, 0.01), FILTERED_RIGS)
    constants_s: tuple[float, ...] = setting((0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3, 0.4), FILTERED_RIGS)
    finer: tuple[float, ...] = setting((0.85, 0.93, 1.07, 1.15), FILTERED_RIGS)
    relaxation_s: tuple[float, ...] = setting((0.05, 0.2, 0.8, 3.0), FILTERED_RIGS)
    high_pass_s: float = setting(0.3, FILTERED_RIGS)
    tells: float = setting(1.3, FILTERED_RIGS)
    max_unexplained: float = setting(0.02, "station faults drawn with seeds 8000 to 8029: good rigs 0.0125 at most")
    share: float = setting(0.005)
    limit_share: float = setting(0.25)


@dataclass(frozen=True)
class ProofMethod(NumberedMethod):
    """All thresholds of the checks of a run, by subject."""

    lag: CellLagConfig = field(default_factory=CellLagConfig)
    law: LawConfig = field(default_factory=LawConfig)
    change: ChangeConfig = field(default_factory=ChangeConfig)
    hang: HangConfig = field(default_factory=HangConfig)
    press: PressConfig = field(default_factory=PressConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    stroke: StrokeConfig = field(default_factory=StrokeConfig)
    response: ResponseConfig = field(default_factory=ResponseConfig)
    slip: SlipConfig = field(default_factory=SlipConfig)
    dropout: DropoutConfig = field(default_factory=DropoutConfig)


METHOD = ProofMethod()
