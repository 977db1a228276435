"""Thresholds for invalid samples and for findings."""

from dataclasses import dataclass, field

from softcal.core.settings import SET, setting

MEASURED = "benchmarks/inspection.py on measured recordings: 0.01 % of good samples at most are masked"
RIGS = "good rigs of benchmarks/station_proof.py, seeds 2000 to 2149"


@dataclass(frozen=True)
class DropoutConfig:
    """Thresholds of a dropout.

    Args:
        max_share: it lasts this share of the recording at most.
        neighbours: an edge is compared with so many steps outside of it, one guard step left out: a converter that
            averages may show the edge in two samples.
        edge_steps: an edge is so many times the largest of these.
        edge_share: and this share of the dropout, and of the other edge.
        range_share, noises, counts: and this share of the recording's range, so many standard deviations of its noise,
            so many steps of its converter. Where nobody knows the stage, all of the range and so many times the usual
            fastest step as of its neighbours: a press may be as fast.
        stage_share: the stage's own excursion meanwhile, as a share of its range, is at most so many times the
            output's: a short press is none.
    """

    max_share: float = setting(0.1, RIGS)
    neighbours: int = setting(5, RIGS)
    edge_steps: float = setting(3.0, RIGS)
    edge_share: float = setting(0.45, RIGS)
    range_share: float = setting(0.05, RIGS)
    noises: float = setting(10.0, RIGS)
    counts: float = setting(4.0, RIGS)
    stage_share: float = setting(0.25, RIGS)


@dataclass(frozen=True)
class InspectionConfig:
    """Thresholds for invalid samples and for findings.

    Args:
        spike_s: a loose cable lasts no longer; a press does.
        max_spike_samples: longer spikes of fast loggers are looked for as dropouts.
        usual_excursion, rare_excursion: quantiles of the short excursions of a recording to one side, up or down, that
            stand for its usual and its rarest ones.
        spike_factor, rare_factor: a spike is so many times as high as a usual excursion to its side, or as a rare one.
        other_side_factor, spike_counts: and as a usual one to the other side, and as a step of the readout.
        readout_step: quantile of the movements of a recording that stands for a step of its readout.
        spike_share, reference_spike_share: and at least this share of the range: forces have sharp peaks.
        outlier_share: largest share of values that may lie apart from the range of all others.
        overflow_factor: a value so many ranges away from all others is none that the sensor gave.
        code_factor: the same for values that loggers write instead of a sample.
        jump_factor: a jump is so many times the usual fastest movement (99 % quantile of differences).
        dropout: what makes a longer dropout.
        step_share: a baseline that moves by less than this share of the range makes no step.
        step_rows: so many rows at least lie before and after a step, and its jump so near to where the level changes.
        step_gain: a tare takes away at least this share of what the output leaves unexplained of the reference.
        single_jump: so many times as large as any other is a jump of the reference that makes a tare of a lasting step.
        max_lag_s: longest lag that is looked for.
        min_lag_s: a shorter lag of the reference is not separable from a sensor's own.
        lag_gain: a lag is one where it leaves at most this part of the scatter at no lag.
        lag_tie: of lags that leave nearly the same scatter the shortest is taken: within this part of what a lag takes
            away.
        relaxed_gain: the same where the output follows the reference, as every sensor does a little.
        hold_rows: a reference that changes only every so many rows was sampled slower than the output.
        stuck_s, stuck_factor: a reading between its ends that stands still for less, or for less than so many times
            the next longest stillness, or than the source's longest, is not stuck.
        stuck_share: a reference is, where it stands still while the output goes through more than this share of its
            range; beside measured ones it goes through 0.4 % of it.
        flat_runs, flat_band, flat_factor: an end of the output's range is flat where it stands still there so often,
            and is there so many times as often as within this share of the range beside it.
        pause_s, pause_rows, rest_band: a gap is a pause where it is as long, and so many samples before and after it
            lie within this share of the range from its end at rest.
        wrap_share: a counter wraps where it jumps by at least this share of a power of two and goes on.
    """

    spike_s: float = setting(0.06, f"{SET}: a loose cable at a station lasts for 20 to 60 ms")
    max_spike_samples: int = setting(64)
    usual_excursion: float = setting(0.99, MEASURED)
    rare_excursion: float = setting(0.999, MEASURED)
    spike_factor: float = setting(3.0, MEASURED)
    rare_factor: float = setting(1.6, MEASURED)
    other_side_factor: float = setting(2.0, MEASURED)
    spike_counts: float = setting(5.0, MEASURED)
    readout_step: float = setting(0.05)
    spike_share: float = setting(0.1, MEASURED)
    reference_spike_share: float = setting(0.25, MEASURED)
    outlier_share: float = setting(0.02)
    overflow_factor: float = setting(1000.0)
    code_factor: float = setting(3.0)
    jump_factor: float = setting(3.0, MEASURED)
    dropout: DropoutConfig = field(default_factory=DropoutConfig)
    step_share: float = setting(0.1)
    step_rows: int = setting(50)
    step_gain: float = setting(0.2, MEASURED)
    single_jump: float = setting(1.5, MEASURED)
    max_lag_s: float = setting(1.5)
    min_lag_s: float = setting(0.1, "eGaIn and nylon sensors: their references come 0.02 s late at most")
    lag_gain: float = setting(0.7, MEASURED)
    lag_tie: float = setting(0.1)
    relaxed_gain: float = setting(0.4, MEASURED)
    hold_rows: int = setting(3)
    flat_runs: int = setting(3)
    flat_band: float = setting(0.02, MEASURED)
    flat_factor: float = setting(2.0, MEASURED)
    pause_s: float = setting(20.0, f"{SET}: somebody who stops a logger does something else meanwhile")
    pause_rows: int = setting(10)
    rest_band: float = setting(0.1)
    wrap_share: float = setting(0.9)
    stuck_s: float = setting(2.0)
    stuck_factor: float = setting(10.0)
    stuck_share: float = setting(0.5)
