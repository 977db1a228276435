"""What the output of a unit alone tells: a dead channel, a clipped range, a frozen reading, too little data."""

from dataclasses import dataclass

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.recording import Array, Indices, OutputRecording
from softcal.core.verdict import Finding

RAIL_RUN = 5
"""Equal samples in a row at the very end of the range that count as clipped."""

RAIL_SHARE = 0.01
"""Clipped share, beyond what the source shows at the same end, that is worth a word."""

STUCK_S = 2.0
"""A reading that does not move for less than this is never called stuck."""

NOISE_RATIO = 0.5
"""Variance of the steps over twice the variance of the samples: 1 for white noise, near 0 for a pressed sensor."""

FEW_WINDOWS, FEW_PRESSES = 500, 3


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


def rail_share(output: Array, rail: float) -> float:
    """Return the share of samples in runs of at least `RAIL_RUN` equal samples at a rail."""
    at_rail = (output == rail).astype(np.int64)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_rail, [0]])))
    lengths = edges[1::2] - edges[::2]
    return float(lengths[lengths >= RAIL_RUN].sum() / len(output))


def check_alive(target: OutputRecording, source: OutputRecording) -> None:
    """Refuse a channel that carries no signal.

    Raises:
        UnitRefused: the output is constant, noise alone, or moves by less than a fiftieth of the source's.
    """
    output, unit = target.output, target.output_unit
    cure = "check cable and contact, press the unit and record it again"
    if np.ptp(output) == 0:
        raise UnitRefused(
            f"dead channel: output is constant at {output[0]:.6g} {unit} in all {len(output)} samples; {cure}"
        )
    spread = float(np.std(output))
    if np.var(np.diff(output)) > NOISE_RATIO * 2 * spread**2:
        raise UnitRefused(f"dead channel: output is noise alone (SD {spread:.3g} {unit}); {cure}")
    span, source_span = (float(np.ptp(np.quantile(x, (0.01, 0.99)))) for x in (output, source.output))
    if span < 0.02 * source_span:
        raise UnitRefused(
            f"dead channel: output moves by {span:.3g} {unit}, the source's by {source_span:.3g} {unit}; {cure}"
        )


def output_limits(target: OutputRecording, source: OutputRecording) -> OutputLimits:
    """Find the rails of the unit's readout and the longest stillness it shows in good order."""
    output = target.output
    shares = [rail_share(output, end) - _source_share(source, k) for k, end in enumerate((output.min(), output.max()))]
    longest = int(max(run_lengths(output).max(), run_lengths(source.output).max()))
    return OutputLimits(
        rail_low=float(output.min()) if shares[0] > RAIL_SHARE else -np.inf,
        rail_high=float(output.max()) if shares[1] > RAIL_SHARE else np.inf,
        stuck_samples=max(2 * longest, round(STUCK_S * target.sample_rate_Hz)),
    )


def _source_share(source: OutputRecording, end: int) -> float:
    return rail_share(source.output, float(source.output.max() if end else source.output.min()))


def health_findings(target: OutputRecording, source: OutputRecording, limits: OutputLimits) -> tuple[Finding, ...]:
    """Say in words what is wrong with the raw output, if anything."""
    found = [*_clipped(target, limits), *_frozen(target, source), *_short(target)]
    return tuple(found)


def _clipped(target: OutputRecording, limits: OutputLimits) -> list[Finding]:
    found = []
    for name, rail in (("highest", limits.rail_high), ("lowest", limits.rail_low)):
        if np.isfinite(rail):
            share = rail_share(target.output, rail)
            text = (
                f"clipped range: output stays at its {name} value {rail:.6g} {target.output_unit} in {share:.1%} of "
                "the samples; check gain and supply of the readout"
            )
            found.append(Finding("saturated", text, "fail" if share > 0.05 else "conditional"))
    return found


def _frozen(target: OutputRecording, source: OutputRecording) -> list[Finding]:
    longest, allowed = (_longest_inner_run(recording.output) for recording in (target, source))
    if longest <= max(10 * allowed, STUCK_S * target.sample_rate_Hz):
        return []
    still_s = longest / target.sample_rate_Hz
    text = f"frozen reading: output does not move for {still_s:.1f} s in mid-range; check the cable"
    return [Finding("stuck", text, "retest")]


def _longest_inner_run(output: Array) -> int:
    span = float(np.ptp(output))
    inner = (output > output.min() + 0.1 * span) & (output < output.max() - 0.1 * span)
    return int(np.max(run_lengths(output)[inner], initial=0))


def _short(target: OutputRecording) -> list[Finding]:
    windows, presses = len(target.window_rows), count_presses(target.output)
    if windows >= FEW_WINDOWS and presses >= FEW_PRESSES:
        return []
    text = (
        f"too little data: {windows} windows and {presses} presses; "
        f"at least {FEW_WINDOWS} windows and {FEW_PRESSES} presses are needed for a firm verdict"
    )
    return [Finding("too little data", text)]


def count_presses(output: Array) -> int:
    """Count the excursions of the output through the middle half of its range, there and back."""
    low, high = np.quantile(output, (0.01, 0.99))
    state = np.where(output > low + 0.6 * (high - low), 1, np.where(output < low + 0.4 * (high - low), -1, 0))
    state = state[state != 0]
    return int(np.count_nonzero(np.diff(state))) // 2 + int(len(state) > 0 and np.count_nonzero(np.diff(state)) % 2)
