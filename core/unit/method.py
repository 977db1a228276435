"""The method: every number that can change a map, an interval, a forecast or a verdict, each with its origin.

A number that decides stands here or in `maps/config.py` and `unit/correspondence.py`. Halves, and constants of
arithmetic and solvers, stand in the formula they belong to. The whole is stored with every calibration and is part of
its identity: results of other numbers show as stale. A release goes by the method of the lot's calibrations. The number
of a trim is part of the device format (`unit/trim.py`).
"""

from dataclasses import dataclass, field

from softcal.core.inspection.config import InspectionConfig
from softcal.core.maps.config import MapConfig
from softcal.core.settings import SET, NumberedMethod, setting
from softcal.core.unit.correspondence import CorrespondenceTable
from softcal.core.windows import TAPS

CONFIDENCE = 0.90
"""Of every interval, as the contract of `softcal estimate` says."""

LEVELS = 64
"""Load levels of an interval's table: part of the device files."""

FORMAT = "part of the file formats: changing it needs new formats"


@dataclass(frozen=True)
class SourceConfig:
    """What is taken from the source: where its windows lie, and how well f reads them.

    Args:
        cells: of the grid over level and slope.
        slack_cells: neighbouring presses leave gaps between their traces: so many cells are still inside.
        tail_factor: bend and roughness beyond so many times their 99.9 % quantile in the source are unfamiliar.
        bands: load bands over which the residuals of f are tabulated.
        cell_prior: a cell of band and direction with this many windows counts half, the whole recording the other half.
        slope_quantile, slope_share: holding still is less than this share of this quantile of the source's slopes.
    """

    cells: tuple[int, int] = setting((96, 64))
    slack_cells: float = setting(2.0)
    tail_factor: float = setting(1.5)
    bands: int = setting(8)
    cell_prior: float = setting(50.0)
    slope_quantile: float = setting(0.9)
    slope_share: float = setting(0.15)


@dataclass(frozen=True)
class HealthConfig:
    """What the output of a unit alone tells (`health.py`).

    Args:
        rail_run: samples in a row at the very end of the range that count as flat.
        pile: samples of a press at the rail over its samples beside it; a triangle leaves about as many in both.
        visits: share of presses that end at a rail, beyond what the source shows at the same end, that is clipping.
        failing_share: more clipped samples than this and the unit fails.
        adc_steps: a flat stretch is at least so many steps of the converter wide.
        dead_share: a channel that moves by less than this share of the source's span is dead.
        few_windows, few_presses: less than this is no firm verdict, and fewer presses at a rail are no clipping.
        span: quantiles between which an output is said to move.
        near_end: what is within this share of the range of its ends is at rest or pressed; a stuck reading is between.
        press_band: hysteresis thresholds of a press, as shares of the span.
        max_missing_share: where more of the samples are masked or in no row, nothing firm can be said.
        min_window_share: the same where fewer of the windows are left that the rows would fill.
    """

    rail_run: int = setting(5)
    pile: float = setting(3.0)
    visits: float = setting(0.2)
    failing_share: float = setting(0.05)
    adc_steps: float = setting(1.5)
    dead_share: float = setting(0.02)
    few_windows: int = setting(500)
    few_presses: int = setting(3)
    span: tuple[float, float] = setting((0.01, 0.99))
    near_end: float = setting(0.1)
    press_band: tuple[float, float] = setting((0.4, 0.6))
    max_missing_share: float = setting(0.15, f"{SET}: 8 % missing in one gap change no verdict of eGaIn, 20 % may")
    min_window_share: float = setting(0.5, f"{SET}: half of what was recorded")


@dataclass(frozen=True)
class ForecastConfig:
    """The error budget of one unit (`evidence.py`, `forecast.py`).

    Args:
        quantiles: number of quantiles at which two distributions are compared.
        max_growth: no more than this is made of what a lightly pressed unit would misread under the source's loads.
        parts: shares of the recording left out in turn while the chosen family is fitted again.
        stretches: per left-out share.
        clipped_part: a clipped load is anywhere in this part of the range: the upper third.
        overlap_edges: of the grid of levels and slopes on which loads and speeds are compared.
        fast, sharp: quantiles of slope and of bend that stand for fast movements and sharp turns.
    """

    quantiles: int = setting(100)
    max_growth: float = setting(3.0)
    parts: int = setting(3)
    stretches: int = setting(4)
    clipped_part: int = setting(3)
    overlap_edges: tuple[int, int] = setting((11, 8))
    fast: float = setting(0.95)
    sharp: float = setting(0.99)


@dataclass(frozen=True)
class LineConfig:
    """What is said of a line that nobody stated (`line_spread.py`); a forecast holds what was stated or measured only.

    Args:
        load_spread: standard deviation of the load from unit to unit, as a share of it.
        day_spread: the same from day to day.
    """

    load_spread: float = setting(0.05, f"{SET}: stiffness, contact and mounting on a press that nobody has studied")
    day_spread: float = setting(0.03, f"{SET}: readout and press on another day that no golden run has shown")


@dataclass(frozen=True)
class DayCorrectionConfig:
    """What a golden run is believed (`day_correction.py`).

    Args:
        max_relative_error: share of the SD of its loads that f may misread it by once gain and zero are taken out.
        max_gain_change: a day that changes the gain by more than this factor is another unit.
    """

    max_relative_error: float = setting(0.3)
    max_gain_change: float = setting(1.5)


@dataclass(frozen=True)
class FindingConfig:
    """When something seen is worth a word (`findings.py`).

    Args:
        unfamiliar_share, failing_share: of the mapped windows outside the source's support: a finding, a failure.
        enough_overlap, speed_factor: of the unit's loads and speeds with the source's. Beyond their squares no forecast
            rests on them; nearer it is only wider.
        stretch: units of one kind do not differ by this factor in what they answer; loads can. An audit whose gain
            differs so from the others' is doubtful.
        blind_stretch: where nothing but the output's distribution speaks for the loads, a factor of this is as likely
            a press that ends at half the range; nothing firm can be said. From a tenth below it on the doubt is said,
            and widens the forecast.
        overlap_gain: where before < after in simulated lots without positions, the map had raised the overlap by less.
        drift_factor: estimates at rest that move or scatter by so many times the source's own error are worth a word.
        along_stage: correlation of output and stage position from which the direction is sure.
        upside_down: an output is the wrong way round where its levels lie nearer to the source's when mirrored, by this
            share of the span over the square root of the presses.
        clipped_likeness: one that seems to clip is the wrong way round only where mirroring leaves this part of it.
        unit_step: an output that differs by a power of this in level and span is in another unit of one quantity.
        late_s: units of one kind, started alike, follow each other within this; a third of a window is beyond it.
    """

    unfamiliar_share: float = setting(0.05)
    failing_share: float = setting(0.3)
    enough_overlap: float = setting(0.6)
    speed_factor: float = setting(1.7)
    stretch: float = setting(3.0, "taxels of the insole differ by 2.7 at most; units pressed below half: 4 and more")
    blind_stretch: float = setting(2.0, f"{SET}: half of the source's range")
    overlap_gain: float = setting(0.14, "benchmarks/verdict.py on seeds 1000-1040 (simulated lots)")
    drift_factor: float = setting(2.0)
    along_stage: float = setting(0.3)
    upside_down: float = setting(
        0.15, "between eGaIn, where a mirrored unit shows 0.20 or more, and the insole, whose good ones reach 0.10"
    )
    clipped_likeness: float = setting(0.5)
    late_s: float = setting(0.05)
    unit_step: float = setting(1e3, "between V, mV and uV, as readouts state them")

    @property
    def reported_stretch(self) -> float:
        return 0.9 * self.blind_stretch


@dataclass(frozen=True)
class DecisionConfig:
    """From an error to a verdict (`verdict.py`, `audit.py`).

    Args:
        default_factor: a lot that states no limit gets this factor times the source's own held-out RMSE.
        min_own_windows: with fewer training windows a network of one's own says little and is left out.
    """

    default_factor: float = setting(3.0)
    min_own_windows: int = setting(400)


@dataclass(frozen=True)
class ReleaseConfig:
    """When units that nobody measured pass on the audits of others (`core/quality/release.py`, `audit_check.py`).

    Args:
        risk: largest share of released units beyond the limit that is promised.
        confidence: probability that lots released by the rule keep to it.
        min_spread: SD of log(measured / forecast) from unit to unit that a few audits cannot prove to be smaller.
        confidence_margin: a bound is taken at this part of the error that the promise allows: 10 makes 99 % of 90 %.
            Else one poor lot in ten is let through, and of kinds of lot that are mostly poor those are all that is
            released.
        min_audits: the spread of fewer audits is a guess, whatever risk is asked for.
        min_part: a lot is released by sample where at least this part of it passes; the few best of a poor lot are
            picked by luck.
        min_lots: audits of fewer lots say nothing firm about a lot without audits: how lots differ is not known.
        lasts_days: how long an audit of an earlier lot counts.
        max_audits: audited units that the scale of the intervals is made of.
        min_coverage: an interval covers at least this share of the samples of all units but the risk
            (`interval_inflation.py`).
        min_others: an audit is out of line with at least so many others. Fewer audited units or golden runs show no
            spread of a line or its days.
        exchanged, min_rest: two audits look exchanged where each rests nearer to the other unit than to its own by so
            many standard deviations of what the other audits of the lot moved, or of this share of the span.
        foreign_unit_rest, foreign_unit_factor: an audit is of another unit where its rest moved by more than the first
            share of the span, and by the second times as much as that of any other audit.
        min_correction_audits: below so many audited units the spread between units says nothing of their mean, and
            nothing is taken off the maps of the lot.
    """

    risk: float = setting(0.10)
    confidence: float = setting(0.90)
    min_spread: float = setting(0.10)
    confidence_margin: float = setting(10.0, "benchmarks/trust.py on seeds 0-24; tested on seeds 24-48")
    min_audits: int = setting(5)
    min_part: float = setting(0.5)
    min_lots: int = setting(3)
    lasts_days: float = setting(365.0)
    max_audits: int = setting(40)
    min_coverage: float = setting(0.80)
    min_others: int = setting(3)
    exchanged: float = setting(4.0, f"{SET}: by chance one pair of audits in millions")
    min_rest: float = setting(0.005)
    foreign_unit_rest: float = setting(0.2)
    foreign_unit_factor: float = setting(4.0)
    min_correction_audits: int = setting(3)


@dataclass(frozen=True)
class Method(NumberedMethod):
    """How a unit is calibrated and judged; one configuration for every sensor and data set.

    Args:
        version: raised when the code computes otherwise from the same numbers.
        taps, levels, confidence: of windows and intervals.
        range_margin: an estimate further than this share of the source's range beyond it is out of range.
        map, source, inspection, health, forecast, correspondence, line, day_correction, findings, decision, release: a
            section a module.
    """

    version: int = setting(4, "raised by hand")
    taps: int = setting(TAPS, FORMAT)
    levels: int = setting(LEVELS, FORMAT)
    confidence: float = setting(CONFIDENCE, FORMAT)
    range_margin: float = setting(0.05)
    map: MapConfig = field(default_factory=MapConfig)
    source: SourceConfig = field(default_factory=SourceConfig)
    inspection: InspectionConfig = field(default_factory=InspectionConfig)
    health: HealthConfig = field(default_factory=HealthConfig)
    forecast: ForecastConfig = field(default_factory=ForecastConfig)
    correspondence: CorrespondenceTable = field(default_factory=CorrespondenceTable)
    line: LineConfig = field(default_factory=LineConfig)
    day_correction: DayCorrectionConfig = field(default_factory=DayCorrectionConfig)
    findings: FindingConfig = field(default_factory=FindingConfig)
    decision: DecisionConfig = field(default_factory=DecisionConfig)
    release: ReleaseConfig = field(default_factory=ReleaseConfig)

    @classmethod
    def with_family(cls, family: str) -> "Method":
        """Return this version's method with one map family for every unit; `auto` lets each unit's evidence choose."""
        return cls(map=MapConfig(family))

    @property
    def is_current(self) -> bool:
        """Whether its numbers are this version's; the family is a choice of whoever calibrates, and no number."""
        return self == Method.with_family(self.map.family)

    def __post_init__(self) -> None:
        if (self.taps, self.levels, self.confidence) != (TAPS, LEVELS, CONFIDENCE):
            raise ValueError(f"taps, levels and confidence are {FORMAT}")
