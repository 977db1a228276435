"""Every number that decides about a map γ, each with its origin. Part of `softcal.core.unit.method.Method`."""

from dataclasses import dataclass, field

from softcal.core.settings import SET, setting

DEFAULT = "auto"
"""Let the evidence of each unit choose (`choose.py`)."""

PAIRS_CHOSEN = "benchmarks/maps_pairs.py: insole's calibration file, stretches 0, 1 and 3 of every four"
"""Origin of what was chosen on measured pairs; docs/results.md tests stretch 2 of every four, behind other sources."""

MATCH_CHOSEN = "benchmarks/maps_other.py: eGaIn pair, skin, every fourth taxel behind five sources, both ways"
"""Origin of what weighs a line and a curve; simulated lots test it (benchmarks/verdict.py)."""

LINE_CHOSEN = (
    "insole, every third taxel behind five sources, both ways; simulated lots 100-105; tested on those of maps_lot.py"
)
"""Origin of the prior of a bend in `SharedLoad`."""

DWELL_CHOSEN = (
    "insole, every third taxel behind taxel_013, 025, 048, 066, 136 and 219; tested behind others by maps_lot.py"
)
"""Origin of the prior of a dwell in `SharedLoad`."""

PACE_CHOSEN = (
    "insole, every third taxel behind taxel_013, 025, 048, 066, 136 and 219, both ways; eGaIn pair, skin; tested "
    "behind others by maps_insole.py, and on simulated lots"
)
"""Origin of the bands in which a dwell shows."""

GROWTH_CHOSEN = (
    "drawn lots 0-3, simulated lots 100-101: up to 0.0114 without a spread, from 0.021 on with 5 % from press to press"
)
"""Origin of the growth of differences that shows a press that differs; drawn lot 4 and simulated lot 102 tested it."""


@dataclass(frozen=True)
class CrossingConfig:
    """Turning points and level crossings (`crossing.py`).

    Args:
        threshold: smallest swing that counts, as a share of the robust range: noise and ripple make no turning points.
        averages: lengths of the moving mean that are tried, shortest first, in samples.
        press_share: the median swing of presses spans at least this share of the robust range.
        robust_range: quantiles that stand for the level at rest and the level of the hardest presses.
    """

    threshold: float = setting(0.1)
    averages: tuple[int, ...] = setting((1, 3, 5, 9, 15, 27, 51))
    press_share: float = setting(0.3)
    robust_range: tuple[float, float] = setting((0.02, 0.99))


@dataclass(frozen=True)
class EndConfig:
    """Rest and peak (`ends.py`).

    Args:
        rest_share: quantile of the samples that stands for the level at rest: robust to a few outlying samples. As
            far from the top lies the other end of what a recording is said to reach, and the peak of one in pieces.
        peak_shares: shares of the path whose mean level stands for the hardest presses, however short those were.
        stretches: of the source that are held beside a unit, or beside the rest of the source.
        enough_swings: a recording as long as the source takes for this many swings has seen its hardest press.
        clear_of_noise: a swing below this many standard deviations of the noise is none; a flat stretch is as wide.
    """

    rest_share: float = setting(0.005)
    peak_shares: tuple[float, ...] = setting((0.99, 0.995, 1.0))
    stretches: int = setting(8)
    enough_swings: float = setting(10.0)
    clear_of_noise: float = setting(6.0)

    @property
    def quantile_range(self) -> tuple[float, float]:
        """Quantiles between which a recording is said to reach."""
        return self.rest_share, 1 - self.rest_share


@dataclass(frozen=True)
class CurveConfig:
    """Monotone curves and how they go on beyond what was seen (`curve.py`, `monotone.py`).

    Args:
        gain_prior: units of one kind differ in gain by about this much (standard deviation of its logarithm).
            The slope of a curve changes as freely over a range that was not seen.
        knots: of a curve between two distributions.
        bands: equal parts of the output's range over which the pace of a passage is taken (`dwell.py`).
        shares: quantiles between which two outputs, their uses, or a source and a straight line are compared.
        match_error: standard uncertainty of curves of equal quantiles, whose time may be spent otherwise, and of a
            line through rest and peak, whose unit may be bent otherwise: as a share of the source's range.
        match_correlation: of both errors. They share the recordings.
    """

    gain_prior: float = setting(0.5)
    knots: int = setting(33)
    bands: int = setting(8, PACE_CHOSEN)
    shares: tuple[float, float] = setting((0.02, 0.98))
    match_error: float = setting(0.04, MATCH_CHOSEN)
    match_correlation: float = setting(0.5, MATCH_CHOSEN)


@dataclass(frozen=True)
class SynchronyConfig:
    """Whether two units were pressed by one load at once (`synchrony.py`).

    Args:
        min_rank_correlation: of the outputs at equal time, from which pairing in time is supported.
        parted: loads part after an opening that leaves this many times less of the ranks unexplained than what follows.
        min_detail, min_sigma: a lag is believed where the fine structure correlates at least so well, and so many
            standard deviations better than at all other lags.
        same_curve: outputs under one load lie on one curve within this share of the source's range ...
        settled_s: ... averaged over so long: what is left is creep, drift or another load, neither noise nor timing.
            Loads that part slowly are alike for a while: twice as much of the opening's end is not used.
        off_curve: or within so many times what the opening itself shows: lags and loops differ from unit to unit.
        min_swings: up and down three times alike is no chance; two slow rises are.
        covered_share: of the source's range that an opening, or a whole recording, must reach over.
        scales: fine structure is what a mean over this many samples keeps and one over `apart` times as many does not.
        apart: lags beyond so many scales are unrelated. A recording is long enough for a scale from twice as many on,
            and leaves unrelated lags alone from four times as many on.
        opening_quantile: quantile of the opening's own distances from one curve that stands for them.
        chance: the largest agreement at unrelated lags counts beyond so many standard deviations.
    """

    min_rank_correlation: float = setting(0.95)
    parted: float = setting(10.0)
    min_detail: float = setting(0.1)
    min_sigma: float = setting(2.5)
    same_curve: float = setting(0.06)
    settled_s: float = setting(1.0)
    off_curve: float = setting(3.0)
    min_swings: int = setting(6)
    covered_share: float = setting(0.75)
    scales: tuple[int, ...] = setting((5, 25, 50))
    apart: int = setting(10)
    opening_quantile: float = setting(0.9)
    chance: float = setting(4.0)


@dataclass(frozen=True)
class LagConfig:
    """Whether a readout follows slower than the source's beside one load and one clock (`readout_lag.py`).

    Args:
        min_lag_s: a lag below it is lost in a window.
        explained: a lag is told where a low-pass leaves so many times less unexplained than any delay or none. Creep
            that a unit has beyond its source reaches 1.4 there, a source that is read with spikes 1.8.
    """

    min_lag_s: float = setting(0.1)
    explained: float = setting(2.5, "simulated lots 2-7, insole; tested on lots 40-56")


@dataclass(frozen=True)
class StageMatchConfig:
    """Pairs at equal stage position (`paired.py`).

    Args:
        look_back: samples back at which the stage must have stood alike (position, direction, speed, what creep keeps),
            and the weight of each in the distance between two histories.
        near_share: two stage histories are alike within this share of the travel.
    """

    look_back: tuple[tuple[int, float], ...] = setting(((0, 1.0), (4, 1.0), (14, 0.5), (45, 0.15), (150, 0.05)))
    near_share: float = setting(0.04)


@dataclass(frozen=True)
class PairConfig:
    """The regression on pairs (`paired.py`).

    Args:
        knots: of the curve, at most.
        pairs: used at most, spread over the recording: the cost of a fit does not grow with its length. A forecast
            reads twice as many windows, and half as many show what noise or f itself misreads.
        stiffness: weight of the squared bend of f's answer along the curve, integrated over the unit's range (taken as
            1): a unit answers smoothly to load, while its curve into the source's output must follow every jump of the
            source's.
        curve_stiffness: the same for the curve itself: it holds where f does not answer at all.
        tether: weight of the squared change of the window's shapes.
        blocks, every: stretches of which every fourth is held out to judge the window shapes by; with less than a
            window in each of them they hold out too little. Of an opening, too, every fourth part is held out.
        knot_range: quantiles of the unit's output between which the knots lie.
        shapes: orthonormal window shapes a map may be made of (level; slope, curvature and two more; all), and the
            share of the held-out error so far that it must stay below to be taken. Windows as they are come first;
            their level alone is taken where it is as good: what a slow load leaves to see in a window is noise.
    """

    knots: int = setting(24, PAIRS_CHOSEN)
    pairs: int = setting(4000)
    stiffness: float = setting(2e-5, PAIRS_CHOSEN)
    curve_stiffness: float = setting(7e-8, PAIRS_CHOSEN)
    tether: float = setting(1e-3)
    blocks: int = setting(32)
    every: int = setting(4)
    knot_range: tuple[float, float] = setting((0.001, 0.999))
    shapes: tuple[tuple[int, float], ...] = setting(((1, 1.02), (5, 0.99), (15, 0.97)), PAIRS_CHOSEN)


@dataclass(frozen=True)
class SharedLoadConfig:
    """The maps of a lot fitted together (`shared_load.py`).

    Args:
        min_members: fewer units make no common load: of two that differ nobody can say which errs.
        max_groups: each unit is compared with the first of so many groups at most: the cost stays linear.
        instants: at which the weights are found, and maps compared with the common load.
        min_share: instants that units of less than this share of all weights cover are no part of the common load.
        outlying: a unit that so many times the usual difference is left of, once it is paired, was pressed otherwise.
        max_growth: where the differences grow by more than this share of the load, the press differs from unit to unit.
        mean_curvature: how far the sensors of a kind are bent on average: standard deviation, as a share of the range.
        dwell: error of a curve of equal quantiles where source and units spend their time otherwise: the same.
        source_apart: a source is named whose common load differs by so many times what those of the others differ by.
    """

    min_members: int = setting(3)
    max_groups: int = setting(8)
    instants: int = setting(2000)
    min_share: float = setting(0.3)
    outlying: float = setting(4.0)
    max_growth: float = setting(0.015, GROWTH_CHOSEN)
    mean_curvature: float = setting(0.04, LINE_CHOSEN)
    dwell: float = setting(0.08, DWELL_CHOSEN)
    source_apart: float = setting(1.64, f"{SET}: 95 % of a normal distribution, one-sided")


@dataclass(frozen=True)
class AnchorConfig:
    """A few known loads (`anchors.py`).

    Args:
        spread: how far a map may be off before any anchor is seen, by how its loads are known: one standard deviation
            of its gain, and of its level at rest as a share of the source's output range.
        load_error: of a known load, as a share of the source's range.
        near: samples of the source within this share of its range around a load show its output under it.
        beyond: a known load may lie beyond the source's range by this share of it.
        max_linear_curvature: beside two known loads a source that is bent by less than this share of its rise leaves
            its units a line: they are of its kind, and a curve would take another dwell for a bend.
        levels: of the source that a straight line behind a map goes by, over its range; with two more at each end they
            reach a tenth of the range beyond it, as `beyond` allows. The bend is taken at every other.
    """

    spread: tuple[tuple[str, float, float], ...] = setting(
        (("paired", 0.02, 0.03), ("stage", 0.05, 0.03), ("", 0.3, 0.1))
    )
    load_error: float = setting(0.003)
    near: float = setting(0.05)
    beyond: float = setting(0.1)
    max_linear_curvature: float = setting(
        0.1, "set between simulated sources (0.05 to 0.1, units are lines) and the skin (0.12 to 0.21)"
    )
    levels: int = setting(21, "docs/format.md")


@dataclass(frozen=True)
class ChoiceConfig:
    """Which family a unit gets (`choose.py`).

    Args:
        same_programme: units that spend their time alike up to this total variation distance ran one programme: samples
            can be matched. Random presses drawn from one distribution differ by 0.05 to 0.1 over a minute; matching
            their samples would copy that.
        unlike_rate: a unit that swings this many times more often than the source shows noise or another use.
    """

    same_programme: float = setting(0.03)
    unlike_rate: float = setting(6.0)


@dataclass(frozen=True)
class MapConfig:
    """How a unit's map is chosen, or the family that is forced, and fitted; one configuration for every sensor."""

    family: str = setting(DEFAULT, "the default lets each unit's evidence choose")
    choice: ChoiceConfig = field(default_factory=ChoiceConfig)
    crossing: CrossingConfig = field(default_factory=CrossingConfig)
    ends: EndConfig = field(default_factory=EndConfig)
    curve: CurveConfig = field(default_factory=CurveConfig)
    synchrony: SynchronyConfig = field(default_factory=SynchronyConfig)
    lag: LagConfig = field(default_factory=LagConfig)
    stage_matched: StageMatchConfig = field(default_factory=StageMatchConfig)
    pairs: PairConfig = field(default_factory=PairConfig)
    anchors: AnchorConfig = field(default_factory=AnchorConfig)
    shared_load: SharedLoadConfig = field(default_factory=SharedLoadConfig)
