"""What the output of a unit alone tells: a dead channel, a clipped range, a frozen reading, too little data."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.crossing import CACHED
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import quantile
from softcal.core.recording import RATE_TOLERANCE, Array, Indices, OutputRecording
from softcal.core.unit.method import HealthConfig, Method
from softcal.core.unit.missing import missing_windows
from softcal.core.unit.verdict import Finding, Verdict


@dataclass(frozen=True)
class OutputLimits:
    """Where the raw output of one unit stops to be believable.

    Args:
        rail_low, rail_high: samples at or beyond them are clipped; infinite where the recording shows no rail.
        stuck_samples: this many equal samples in a row mean a frozen reading.
    """

    rail_low: float
    rail_high: float
    stuck_samples: int


def run_lengths(output: Array) -> Indices:
    """Return for each sample how many samples, itself included, have had exactly this value without a break."""
    index = np.arange(len(output))
    changes = np.concatenate([[True], np.diff(output) != 0])
    return index - np.maximum.accumulate(np.where(changes, index, 0)) + 1


@dataclass(frozen=True)
class Rail:
    """How the presses end at one end of the range.

    Args:
        level: inner edge of the band at this end, as wide as the noise, in the output unit.
        visits: share of the presses that end flat in the band.
        count: number of such presses.
    """

    level: float
    visits: float
    count: int

    def is_clipped(self, source: "Rail", config: HealthConfig) -> bool:
        """Tell whether the readout clips here: presses of different depth all end flat at one level.

        Holds at one same depth end flat too, but then they do so in the source.
        """
        return self.count >= config.few_presses and self.visits > source.visits + config.visits


@lru_cache(maxsize=CACHED)
def rail(recording: OutputRecording, is_upper: bool, method: Method) -> Rail:
    """Describe the upper or lower end of the range of a recording's output."""
    output, config = recording.output, method.health
    rising = output if is_upper else -output
    band = noise_band(recording, method)
    top, span = float(rising.max()), float(np.ptp(rising))
    in_band, next_band = rising > top - band, (rising <= top - band) & (rising > top - 2 * band)
    is_pressed = rising >= top - max(config.near_end * span, 2 * band)
    # Number 0 is what the recording begins with: nobody saw that press rise.
    press = np.cumsum(np.concatenate([[False], is_pressed[1:] & ~is_pressed[:-1]]))
    is_flat_run = in_band & (run_lengths(in_band.astype(np.float64)) == config.rail_run)
    ran = np.bincount(press[is_flat_run], minlength=press[-1] + 1)
    inside, next_inside = (np.bincount(press[rows], minlength=press[-1] + 1) for rows in (in_band, next_band))
    # Each press for itself: one long hold must not make flat ends of the tips of others as deep.
    is_flat = (ran > 0) & (inside >= config.pile * np.maximum(next_inside, 1))
    count = int(np.count_nonzero(is_flat[1:]))
    return Rail(
        level=(top - band) * (1 if is_upper else -1),
        visits=count / max(count_presses(recording, config), 1),
        count=count,
    )


def noise_band(recording: OutputRecording, method: Method) -> float:
    """Return the width of a flat stretch: six standard deviations of the noise, at least one and a half ADC steps.

    The noise comes from second differences, which a slow signal leaves small (median absolute value / 0.6745 / √6).
    """
    noise = float(np.median(np.abs(np.diff(recording.output, 2)))) / 0.6745 / np.sqrt(6)
    # A simulated recording may have neither noise nor steps.
    min_width = 1e-3 * float(np.ptp(recording.output))
    return float(max(method.map.ends.clear_of_noise * noise, method.health.adc_steps * recording.step, min_width))


def check_alive(target: OutputRecording, source: OutputRecording, config: HealthConfig) -> None:
    """Refuse a channel that carries no signal, or none that windows of the source can be compared with.

    Raises:
        UnitRefused: the output is constant, noise alone, moves by too small a share of the source's, or was sampled at
            another rate.
        InputError: it is in another physical unit.
    """
    output, unit = target.output, target.output_unit
    if unit != source.output_unit:
        raise InputError(f"target output is in {unit}, the source's in {source.output_unit}")
    rate_Hz, source_rate_Hz = target.sample_rate_Hz, source.sample_rate_Hz
    if abs(rate_Hz / source_rate_Hz - 1) > RATE_TOLERANCE:
        raise UnitRefused(reason("other_rate", seen=rate_Hz, wanted=source_rate_Hz))
    cure = Reason("part.check_cable")
    if np.ptp(output) == 0:
        raise UnitRefused(reason("dead.constant", level=float(output[0]), unit=unit, count=len(output), cure=cure))
    spread = float(np.std(output))
    # White noise has twice its variance in differences of neighbours, a slow signal almost none: half-way is dead.
    if np.var(np.diff(output)) > spread**2:
        raise UnitRefused(reason("dead.noise", spread=spread, unit=unit, cure=cure))
    # A spike must not make a dead channel look alive.
    span, source_span = (float(np.ptp(_span(recording, config))) for recording in (target, source))
    if span < config.dead_share * source_span:
        raise UnitRefused(reason("dead.small", span=span, source_span=source_span, unit=unit, cure=cure))


def output_limits(target: OutputRecording, source: OutputRecording, is_rising: bool, method: Method) -> OutputLimits:
    """Find the rail of the unit's readout and the longest stillness it shows in good order.

    Only the loaded end of the output is looked at: at rest every unit is flat.
    """
    end, source_end = (rail(recording, is_rising, method) for recording in (target, source))
    clipped = end.level if end.is_clipped(source_end, method.health) else None
    # A slow load on a coarse converter stands still for long by itself: twice the longest seen is no fault yet.
    longest = max(_longest_run(recording) for recording in (target, source))
    return OutputLimits(
        rail_low=-np.inf if clipped is None or is_rising else clipped,
        rail_high=np.inf if clipped is None or not is_rising else clipped,
        stuck_samples=max(2 * longest, round(method.inspection.stuck_s * target.sample_rate_Hz)),
    )


def clipped_share(output: Array, limits: OutputLimits) -> float:
    """Return the share of samples at a rail."""
    return float(np.mean((output <= limits.rail_low) | (output >= limits.rail_high)))


def health_findings(
    target: OutputRecording, source: OutputRecording, limits: OutputLimits, method: Method
) -> tuple[Finding, ...]:
    """Say in words what is wrong with the raw output, if anything."""
    findings, unit, config, stillness = [], target.output_unit, method.health, method.inspection
    if share := clipped_share(target.output, limits):
        rails = [level for level in (limits.rail_low, limits.rail_high) if np.isfinite(level)]
        level = (
            reason("part.level", level=rails[0], unit=unit)
            if len(rails) == 1
            else reason("part.levels", low=rails[0], high=rails[1], unit=unit)
        )
        best = Verdict.FAIL if share > config.failing_share else Verdict.CONDITIONAL
        findings.append(Finding(reason("saturated", level=level, share=share), best))
    longest, allowed = (_longest_inner_run(recording, config.near_end) for recording in (target, source))
    if longest > max(stillness.stuck_factor * allowed, stillness.stuck_s * target.sample_rate_Hz):
        findings.append(Finding(reason("stuck", seconds=longest / target.sample_rate_Hz), Verdict.RETEST))
    # Windows that a logger lost are not for want of presses.
    windows, presses = len(target.window_rows) + missing_windows(target)[1], count_presses(target, config)
    # A slow programme may have but two presses in the source too.
    enough = min(config.few_presses, count_presses(source, config))
    if windows < config.few_windows or presses < enough:
        counts = {"windows": windows, "presses": presses}
        too_little = reason("too_little_data", **counts, enough_windows=config.few_windows, enough_presses=enough)
        findings.append(Finding(too_little))
    return tuple(findings)


@lru_cache(maxsize=CACHED)
def _longest_run(recording: OutputRecording) -> int:
    return int(run_lengths(recording.output).max())


@lru_cache(maxsize=CACHED)
def _longest_inner_run(recording: OutputRecording, edge: float) -> int:
    output = recording.output
    span = float(np.ptp(output))
    # At rest and at the peak every output stands still; frozen is what does so in between.
    inner = (output > output.min() + edge * span) & (output < output.max() - edge * span)
    return int(np.max(run_lengths(output)[inner], initial=0))


@lru_cache(maxsize=CACHED)
def _span(recording: OutputRecording, config: HealthConfig) -> Array:
    return quantile(recording.output, config.span)


@lru_cache(maxsize=CACHED)
def count_presses(recording: OutputRecording, config: HealthConfig) -> int:
    """Count the excursions of the output through the middle half of its range, there and back."""
    output, (low, high) = recording.output, _span(recording, config)
    # Two thresholds apart (a Schmitt trigger): noise at one of them would count as presses.
    lower, upper = (low + share * (high - low) for share in config.press_band)
    state = np.where(output > upper, 1, np.where(output < lower, -1, 0))
    state = state[state != 0]
    return int(np.count_nonzero(np.diff(state))) // 2 + int(len(state) > 0 and np.count_nonzero(np.diff(state)) % 2)
