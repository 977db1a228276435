"""The method of the diagnosis: every number that can change a verdict, a cause, a place or a forecast.

Numbers of a solver, of a cache or of what is shown stand where they are used.
"""

from dataclasses import dataclass, field

from softcal.core.gap.colour import ColourConfig
from softcal.core.settings import SET, NumberedMethod, setting, table


@dataclass(frozen=True)
class MistakeConfig:
    """When a recording is held to be mistaken (`plausibility.py`, `simulator_plausibility.py`).

    Args:
        fewest_runs: with two runs nobody can tell which one is wrong.
        same_factor: a ratio this near to a unit's factor, beyond what the others differ by, is it.
        apart: ratio of one run to the others that no effect but only a wrong unit or gain explains.
        stiffness_N_mm: peak force over depth of a soft pad; beyond, a unit may be wrong, if one brings
        usual, near_usual: all back to within this factor of the usual. A lot may state its stiffness.
        depth_mm, force_N: the same where the other channel is missing.
        near_stated: a stiffness this near beyond what the lot states, in another unit, is that unit.
        few: share of samples out of range up to which the transmission is broken, not the unit wrong.
        far: spans beyond what nearly all samples show that are a broken transmission.
        off_step: distance from a step of the ADC, in steps, up to which a sample stands on it.
        on_grid, off_grid: share of samples on steps above which a column is an output, or below not.
        smooth: a commanded position is this much smoother, against its span, than what is measured.
        opposed: correlation below which two channels move against each other.
        paired, unpaired: correlation above which two columns belong to one run, or below do not.
        good, bad: share of a channel that a simulator's base takes up where it agrees, or does not.
        repaired: share of what the base leaves that may be left once a mistake is repaired; else it is a question.
        step_apart: factor from which the steps of time of one run are none of jitter.
        stuck: share of samples on the largest or smallest value that may be a channel cut off.
        resting: share of repeated samples up to which a channel does not rest on steps.
    """

    fewest_runs: int = setting(3)
    same_factor: float = setting(1.1)
    apart: float = setting(2.0)
    stiffness_N_mm: tuple[float, float] = setting((0.4, 25.0))
    usual: tuple[tuple[str, float], ...] = table({"stiffness_N_mm": 2.0, "depth_mm": 3.0, "force_N": 6.0})
    near_usual: float = setting(5.0)
    depth_mm: tuple[float, float] = setting((0.3, 30.0))
    force_N: tuple[float, float] = setting((0.05, 300.0))
    near_stated: float = setting(1.45)
    few: float = setting(0.02)
    far: float = setting(3.0)
    off_step: float = setting(0.1)
    on_grid: float = setting(0.9)
    off_grid: float = setting(0.5)
    smooth: float = setting(0.1)
    opposed: float = setting(-0.5)
    paired: float = setting(0.75)
    unpaired: float = setting(0.6)
    good: float = setting(0.9)
    bad: float = setting(0.8)
    repaired: float = setting(0.1)
    step_apart: float = setting(5.0)
    stuck: float = setting(0.01)
    resting: float = setting(0.05)


@dataclass(frozen=True)
class CallConfig:
    """When a simulator cannot be fitted (`simulator_check.py`).

    Args:
        repeatable: largest difference of equal calls, as a share of a channel's span: a tenth of what derivatives bear.
        long_step: steps of the fit in the longer of two difference quotients that are compared.
        moved: share of the largest change from which a sample is compared.
        rounded: share of the samples that disagree, and by which share of their change, where channels are rounded.
    """

    repeatable: float = setting(1e-7)
    long_step: float = setting(100.0)
    moved: float = setting(1e-3)
    rounded: float = setting(0.5)


@dataclass(frozen=True)
class OutlierConfig:
    """When what is left is the mistake of one run (`outlier_run.py`).

    Args:
        share: of what the twin leaves that one run's mistake must explain.
        least: smallest gain, and zero against the span, that is no tare or seating of a run.
        share_beside: the share beside a cause, of which other equations leave much less to one run.
        parents: single causes that are tried beside a mistake.
        ahead: by how much χ² with its penalty must then be ahead of the catalogue's best.
        promised, least_promised: share to be promised for a fit: alone, and beside a cause of its size.
        each, dearer: cost of a number in ln n, and as a share of the gap where structure is left.
    """

    share: float = setting(0.93)
    least: float = setting(0.02)
    share_beside: float = setting(0.85)
    parents: int = setting(3)
    ahead: float = setting(40.0)
    promised: float = setting(0.5)
    least_promised: float = setting(0.15)
    each: float = setting(3.0)
    dearer: float = setting(2e-4)


@dataclass(frozen=True)
class OffsetConfig:
    """What every run may have of its own (`offsets.py`).

    Args:
        tare: largest force at rest of a cell that was not tared, as a share of the force's range.
        resistance: largest change of R0 between runs that is seating or room temperature.
        seat: largest change of the surface's height between runs that is seating, over the stroke.
    """

    tare: float = setting(0.03)
    resistance: float = setting(0.02)
    seat: float = setting(0.03)


@dataclass(frozen=True)
class StructureConfig:
    """What of a residual is structure, and to which stages dirty maps point (`residual.py`).

    Args:
        block_samples: lengths over which a residual is summed: 0.16 s and 0.8 s at 50 Hz.
        dirty_z: standard errors above white noise from which its block sums are structure.
        quiet: a map this much cleaner than the dirtiest counts as closed: no noise is quite white.
    """

    block_samples: tuple[int, int] = setting((8, 40))
    dirty_z: float = setting(6.0)
    quiet: float = setting(0.02)


@dataclass(frozen=True)
class PlaceConfig:
    """Which stage the gap sits in (`place.py`).

    Args:
        chance: how seldom white noise may show a tone in one run.
        faintest: root mean square of a tone, in units of the noise, below which it hides nothing.
        fewest: ordinates of a spectrum below which nothing stands out of the others.
        slowest_Hz: below, block sums see it; and what is slow is a shape more often than a tone.
        uneven_z, uneven_ratio: fast samples must be noisier than slow ones by so many standard errors
            and this factor of the variance: every rig's clock is uneven by less.
        loaded: share of the range of the output above which a sample counts as under load.
        spike_sigma, fewest_spikes: what makes a spike, and how many of them are no chance.
        clipped_sigma: the output is clipped this near to a level it was fitted to be clipped at.
        bins: of a static residual over what it may depend on.
        swings: changes of sign from which a static residual is taken as a ripple, not as a bend.
        faint_z: structure of the maps below which uneven noise, which stirs them, tells more.
        breathes_Hz, most_of_line: a tone so near to a named line, and so much smaller, belongs to it.
        most: share of the structured residual that a regularity must account for to count.
    """

    chance: float = setting(1e-6)
    faintest: float = setting(0.3)
    fewest: int = setting(20)
    slowest_Hz: float = setting(2.0)
    uneven_z: float = setting(8.0)
    uneven_ratio: float = setting(4.0)
    loaded: float = setting(0.15)
    spike_sigma: float = setting(6.0)
    fewest_spikes: int = setting(8)
    clipped_sigma: float = setting(4.0)
    bins: int = setting(40)
    swings: int = setting(4)
    faint_z: float = setting(30.0)
    breathes_Hz: float = setting(0.5)
    most_of_line: float = setting(0.5)
    most: float = setting(0.5)


@dataclass(frozen=True)
class FloorConfig:
    """When what is left counts as noise (`floor.py`).

    Args:
        uneven: log likelihood that noise of its own at rest and under load may gain over the same in
            both: two numbers more gain 1 on average and 9 in one of 10,000.
        chance: from which what is left is noise: one channel of noise alone in a thousand is not.
        lags: samples of its own past that a residual may follow.
        fewest: samples at rest and under load, each, that tell; fewer do not test.
        wanders: share of the longest fading time from which a time stands on its bound.
        memory_s: fading times of memories it may follow, up to a run's length, a factor of four apart.
        hats: depths at which a static curve may bend.
    """

    uneven: float = setting(14.0)
    chance: float = setting(1e-3)
    lags: int = setting(20)
    fewest: int = setting(100)
    wanders: float = setting(0.9)
    memory_s: tuple[float, ...] = setting((0.5, 2.0, 8.0, 30.0))
    hats: int = setting(6)


@dataclass(frozen=True)
class EpisodeConfig:
    """Effects that must be placed first (`episodes.py`).

    Args:
        longest_lead: samples by which a fitted delay may lie wrong before the losses are placed.
        longest_loss: most samples one run may lose in all; more is another recording.
        judged: samples that must follow a loss to judge it by.
        mains_tolerance_Hz: how far from its frequency mains may stand.
        line_gain: χ² that the strongest line must take away, in units of the noise or of what surrounds
            it: white noise reaches 20 in a thousand lines, a gap has power everywhere.
        flat_samples: that must lie clearly beyond a level for the output to be clipped there.
        event_share, event_sigma: share of fitted jumps that a bad contact must show, and standard
            errors. Intervals that only mop up a smooth gap show none.
    """

    longest_lead: int = setting(20)
    longest_loss: int = setting(60)
    judged: int = setting(20)
    mains_tolerance_Hz: float = setting(0.5)
    line_gain: float = setting(30.0)
    flat_samples: int = setting(8)
    event_share: float = setting(0.7)
    event_sigma: float = setting(3.0)


@dataclass(frozen=True)
class SearchConfig:
    """How wide the search goes (`search.py`, `simulator_search.py`).

    Args:
        leads: effects fitted fully on top of the base, then of hypotheses with one, with two effects.
        beam: hypotheses of one, two effects that are grown further.
        gain: a lead must promise this drop of χ² to be fitted (a third of it for the first effect).
        relative_gain: and this share of the χ² that the best lead promises.
        with_forms: single causes whose other realisations are tried where structure is left.
        enough: share of the gap that one, two, three causes must explain to be named although structure
            is left. Another realisation leaves less than a tenth, an effect outside the catalogue more
            than a quarter; several causes are more flexible.
        likely, rival: share of what the best single cause explains from which other realisations of
            another are tried, where structure is left and where none is.
        patch: share of the gap that steps placed freely in time must take away.
        again: hypotheses fitted from the first base again where the best one leaves structure.
        beside: an effect beside the best hypothesis must promise this drop of χ² to be fitted, or
        hiding: be imitated to this share, so that a first-order promise says little.
        worth: share of the gap that a simulator's causes must gain after a few steps to go on.
        most_pairs: pairs of these that are tried from several starts: all of four or fewer.
        base_sigma: standard deviations that a base may leave of the largest offset of all runs.
    """

    leads: tuple[int, ...] = setting((9, 6, 4))
    beam: tuple[int, ...] = setting((3, 3))
    gain: float = setting(14.0)
    relative_gain: float = setting(0.02)
    with_forms: int = setting(3)
    enough: tuple[float, ...] = setting((0.87, 0.99, 0.997))
    likely: float = setting(0.4)
    rival: float = setting(0.85)
    patch: float = setting(0.005)
    again: int = setting(6)
    beside: float = setting(6.0)
    hiding: float = setting(0.99)
    worth: float = setting(0.01)
    most_pairs: int = setting(8)
    base_sigma: float = setting(5.0)


@dataclass(frozen=True)
class EvidenceConfig:
    """How probable a hypothesis is (`fit.py`, `posterior.py`, `shared_cause.py`).

    Args:
        prior_odds: of each effect being present.
        stray_odds: prior odds that a unit does not share the lot's causes: it takes a thousandfold.
        driven_cost: what a cause pays besides where a measured force drives the chain: its noise and
            corners feign gains of up to 90 on recordings without any gap.
        episode_cost: parameters that an episode counts as: two times, a size, and where it was not.
        further_episode_cost: the same of an episode after the first when causes are compared.
        modes: degrees of freedom of the smooth difference between an equation and what a rig does.
        bound_cost: what a cause pays whose size ends on its bound: it stands for something else.
        exactness: share of the gap's energy below which no equation is believed: 0.7 % in amplitude.
        usual_range: sizes that a rig may show, in usual ones: the width of the prior of a size.
    """

    prior_odds: float = setting(0.02, f"{SET}: one effect in half of the cases, any of the 25")
    stray_odds: float = setting(1e-3)
    driven_cost: float = setting(120.0)
    episode_cost: int = setting(5)
    further_episode_cost: float = setting(0.2)
    modes: float = setting(20.0)
    bound_cost: float = setting(60.0)
    exactness: float = setting(5e-5)
    usual_range: float = setting(3.0)


@dataclass(frozen=True)
class RivalConfig:
    """Which hypotheses the evidence cannot rule out (`posterior.py`, `shared_cause.py`), in log odds.

    Args:
        odds: a hypothesis so near to the best (ΔBIC < 10) is a rival: weak evidence.
        most: rivals, the best one among them.
        most_causes: that an honest set may hold, or one more than the best hypothesis has.
        added: a cause more is a rival down to these odds behind the best hypothesis ...
        exact: ... and where it would be ahead by these if every equation held exactly: these runs
            cannot tell that cause from what the equation of another one leaves.
        negligible: so far behind a cause more is ruled out, even if every equation held.
        structure_left: share of the structure beside which a cause more mops up another's equation.
    """

    odds: float = setting(5.0)
    most: int = setting(3)
    most_causes: int = setting(3)
    added: float = setting(1.0)
    exact: float = setting(2.0)
    negligible: float = setting(15.0)
    structure_left: float = setting(0.25)


@dataclass(frozen=True)
class StrangerConfig:
    """Departures that no equation says, and other equations of causes (`generic_effects.py`).

    Args:
        clean_odds: log evidence by which a stranger must beat a catalogue that leaves no structure;
            one that leaves some must be no rival any more ...
        least_gain: ... and by how much it must lower χ² besides, unless it stands for two causes more
            than itself: three that together imitate one departure.
        warmed_K: change of temperature from which a dummy resistor tells of the electronics.
        ratios: sizes and shapes mixed in a free form, as multiples of the fitted ones.
        imitated: share of what a cause takes away that a free form of the others must take as well.
    """

    clean_odds: float = setting(2.0)
    least_gain: float = setting(12.0)
    warmed_K: float = setting(1.0)
    ratios: tuple[float, ...] = setting((0.2, 0.5, 2.0, 5.0))
    imitated: float = setting(0.8)


@dataclass(frozen=True)
class ShrinkConfig:
    """Samples held back (`shrink.py`, `empirical.py`).

    Args:
        parts: contiguous parts, or interleaved stretches, of every run that are held back.
        most_chosen_from: hypotheses that are fitted anew where a part is held back.
        near: log odds against a hypothesis, by what it is foretold to gain, from which it is not.
        beyond: standard errors by which χ² must fall on samples held back.
        block_s: length of the stretches that are held back where whole runs cannot be.
        least_margin: one recording does not know its own forecast better than that.
        contradicts: distance of what was measured from the interval of a forecast, or the interval's own width where
            that is more, from which the forecast is left out.
    """

    parts: int = setting(4)
    most_chosen_from: int = setting(3)
    near: float = setting(10.0)
    beyond: float = setting(1.64, "95 % of a normal distribution: by chance it does once in twenty")
    block_s: float = setting(0.6)
    least_margin: float = setting(0.02)
    contradicts: float = setting(0.1)


@dataclass(frozen=True)
class LearnConfig:
    """When an empirical term is taken (`empirical.py`).

    Args:
        least: share of what is left above the noise that a further term must take when held back.
        chance: drop of χ² besides, for each time a sample is held back.
        simpler: share of the gap by which terms beside the causes must beat those on the bare base.
        errors: standard errors below which a coefficient is left out.
        distinct: share of a variable's energy that base and causes must leave to it.
        coverage: of the interval.
    """

    most: int = setting(3)
    least: float = setting(0.05)
    chance: float = setting(10.0)
    simpler: float = setting(0.05)
    errors: float = setting(3.0)
    distinct: float = setting(1e-3)
    coverage: float = setting(0.90)


@dataclass(frozen=True)
class TellingConfig:
    """When runs tell a parameter or a cause (`identifiability.py`, `next_experiment.py`).

    Args:
        sigma: standard deviations by which a change of the usual size must show.
        nothing: standard deviations below which nothing of it shows.
        own: share, of what the base leaves of a cause, from which offsets take its shape.
        alike: cosine of what is visible of two causes from which they are one to these runs.
        lost: share of a parameter's energy that the others must leave for it to matter here.
        traded: share of what a parameter is imitated by from which another is named beside it.
        smaller: share of the usual size at which a cause is looked at too.
        on_bound: share of its largest from which an offset stands on its bound.
        enough_sigma: rivals so many standard deviations apart are told on a real, coloured floor.
    """

    sigma: float = setting(5.0)
    nothing: float = setting(0.5)
    own: float = setting(
        0.975, "the five simulators of tests/core/test_gap_simulators.py and four drawn ones; tested on others"
    )
    alike: float = setting(0.99)
    lost: float = setting(1e-7)
    traded: float = setting(0.1)
    smaller: float = setting(0.2)
    on_bound: float = setting(0.99)
    enough_sigma: float = setting(10.0)


@dataclass(frozen=True)
class VerdictConfig:
    """From a search to a verdict and to probabilities (`gap_diagnosis.py`).

    Args:
        unknown_trust: how far probabilities of a lot are trusted beside an unknown gap.
        doubted_chance: how likely noise leaves as much, below which what causes leave is none. At any
            stricter level a cause might take much of a small gap and its rest pass for noise; one
            right cause in twenty of a small gap is given up for it.
        down_to_noise: share of the gap, held out too, from which the rest is the difference between two
            equations of one cause.
        near_share: of the gap that one cause more must take to be told as what comes nearest.
        most_tried: sets that leave least, tried on samples held back beside the best of every size.
        near_error: share of its error on runs held back that one cause more must take to be in the set.
        imitated_trust: in a cause that another equation of those beside it would explain as well.
    """

    unknown_trust: float = setting(0.3)
    doubted_chance: float = setting(0.05)
    down_to_noise: float = setting(
        0.92,
        "benchmarks/gap.py: seven cases of the line `form` (seeds 7100-7106) reach it, on `outside` (7000-7011) the "
        "most is 0.70; they were looked at for it and test nothing",
    )
    near_share: float = setting(0.01)
    most_tried: int = setting(4)
    near_error: float = setting(0.02)
    imitated_trust: float = setting(0.4)


@dataclass(frozen=True)
class PresenceConfig:
    """Whether a cause is there, and whether the list is complete (`presence.py`).

    Args:
        parts: of every run, in which a cause may ask for a size of its own.
        acts: share of a cause's energy from which a part tells of its size.
        share_odds, of_share: log odds of cause over rest at which it is as likely an imitation, and their weight.
        disagreement, of_disagreement: relative disagreement of the parts at which it is so, and its weight.
        certain: probability from which a cause is named beside a rest.
        complete_odds: prior odds that nothing is left where noise explains all.
        half_share: share of the gap whose rest is as likely another law of the same cause as something unmodelled.
        open_law: how sure that is at best.
        negligible: weight of a hypothesis below which it says nothing of its causes.
        unlisted: completeness where a departure outside the list explains more.
    """

    parts: int = setting(4)
    acts: float = setting(1e-3)
    share_odds: float = setting(2.2)
    of_share: float = setting(3.0)
    disagreement: float = setting(0.13)
    of_disagreement: float = setting(2.0)
    certain: float = setting(0.9)
    complete_odds: float = setting(9.0)
    half_share: float = setting(0.02)
    open_law: float = setting(0.95)
    negligible: float = setting(1e-3)
    unlisted: float = setting(0.05)


@dataclass(frozen=True)
class WorthConfig:
    """What a cause explains of the calibration error (`transfer.py`).

    Args:
        train_share: of an audit that a unit's own calibration trains on; all errors are on the rest.
        fitted_on: recordings of the rig that the twins are fitted to; other units tell the causes.
        alike: an f counts as not worse up to this ratio of errors.
    """

    train_share: float = setting(0.6)
    fitted_on: int = setting(1)
    alike: float = setting(1.02, "stated beforehand, chosen on no data")


@dataclass(frozen=True)
class GapMethod(NumberedMethod):
    """How a gap is diagnosed, for every rig and every simulator: a section a step."""

    mistake: MistakeConfig = field(default_factory=MistakeConfig)
    calls: CallConfig = field(default_factory=CallConfig)
    outlier: OutlierConfig = field(default_factory=OutlierConfig)
    offset: OffsetConfig = field(default_factory=OffsetConfig)
    structure: StructureConfig = field(default_factory=StructureConfig)
    place: PlaceConfig = field(default_factory=PlaceConfig)
    colour: ColourConfig = field(default_factory=ColourConfig)
    floor: FloorConfig = field(default_factory=FloorConfig)
    episode: EpisodeConfig = field(default_factory=EpisodeConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    simulator_search: SearchConfig = field(default_factory=lambda: SearchConfig(leads=(8, 5), beam=(3,)))
    evidence: EvidenceConfig = field(default_factory=EvidenceConfig)
    rival: RivalConfig = field(default_factory=RivalConfig)
    stranger: StrangerConfig = field(default_factory=StrangerConfig)
    shrink: ShrinkConfig = field(default_factory=ShrinkConfig)
    learn: LearnConfig = field(default_factory=LearnConfig)
    telling: TellingConfig = field(default_factory=TellingConfig)
    verdict: VerdictConfig = field(default_factory=VerdictConfig)
    presence: PresenceConfig = field(default_factory=PresenceConfig)
    worth: WorthConfig = field(default_factory=WorthConfig)


METHOD = GapMethod()
"""The one method in use."""
