"""The method of the proof: every number that decides whether a finished run is a recording, each with its origin."""

from dataclasses import dataclass, field

from softcal.core.inspection.dropouts import DropoutConfig
from softcal.core.settings import NumberedMethod, setting

RIGS = "good rigs of benchmarks/station_proof.py, seeds 0 to 99, 156, 400 to 519 and 600 to 1099"
"""Origin of what was chosen on simulated rigs; docs/results.md reports other seeds."""


@dataclass(frozen=True)
class CellLagConfig:
    """How late a load cell is behind the stage.

    Args:
        earliest_s, latest_s: delays that are tried when force and stage are laid over each other.
        coarse_s, fine_s: steps of these delays, first and around the best one.
        beside_s, tells, tells_samples: a delay is known that fits n samples tells + tells_samples / n times better than
            any that is `beside_s` or more away: few samples fit anyhow.
        late_s, early_s: a cell may seem this much later than declared, or this much earlier (a unit that relaxes within
            0.1 s still makes it seem so).
        period_share: and by this share of its sampling period.
    """

    earliest_s: float = setting(-0.16, RIGS)
    latest_s: float = setting(0.7, RIGS)
    coarse_s: float = setting(0.02, RIGS)
    fine_s: float = setting(0.0025, RIGS)
    beside_s: float = setting(0.04, RIGS)
    tells: float = setting(1.1, RIGS)
    tells_samples: float = setting(40.0, RIGS)
    late_s: float = setting(0.01, RIGS)
    early_s: float = setting(0.12, RIGS)
    period_share: float = setting(0.25, RIGS)


@dataclass(frozen=True)
class LawConfig:
    """What a force may be made of by the depth. A soft unit's force relaxes and so leads its depth: without the relaxed
    terms that would be taken for an early cell.

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
        least, times: or by this share, and so many times the RMS of the rest of the run. Good rigs show 0.22 and 10.
        beside_s: the rest is all but so much on either side.
        rounds: of the fit by least absolute deviations.
        largest: quantile that stands for the largest force.
    """

    mean_s: float = setting(0.1, RIGS)
    share: float = setting(0.3, RIGS)
    least: float = setting(0.03, RIGS)
    times: float = setting(15.0, RIGS)
    beside_s: float = setting(0.6, RIGS)
    rounds: int = setting(25, RIGS)
    largest: float = setting(0.99, RIGS)


@dataclass(frozen=True)
class PressConfig:
    """One press beside another.

    Args:
        samples: a press has so many at least.
        shallow: and is deeper than this share of the deepest.
        depths: edges of the depths at which presses are compared.
        pressed: a press is compared where others show this share of the run's largest force.
        gain: largest ratio between the stiffest and the softest press of one run; a cell whose gain halves shows 2.
        output_gain: the same of an output. It may creep and follow late by itself; it is looked at where no load cell
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
    """What an output must show.

    Args:
        follows: least share of its variance that goes with the depth; good rigs show 0.84 and more.
        levels: different readings that are needed to know a converter's step.
        span: how many times a bit's weight they must run through.
        rounding: how far from whole steps they may be.
    """

    follows: float = setting(0.7, RIGS)
    levels: int = setting(16, RIGS)
    span: int = setting(2, RIGS)
    rounding: float = setting(0.01, RIGS)


@dataclass(frozen=True)
class ProofMethod(NumberedMethod):
    """Every number of the proof, by what it looks at."""

    lag: CellLagConfig = field(default_factory=CellLagConfig)
    law: LawConfig = field(default_factory=LawConfig)
    change: ChangeConfig = field(default_factory=ChangeConfig)
    hang: HangConfig = field(default_factory=HangConfig)
    press: PressConfig = field(default_factory=PressConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    dropout: DropoutConfig = field(default_factory=DropoutConfig)


METHOD = ProofMethod()
