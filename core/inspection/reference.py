"""Findings in a reference: a lag, a lower rate, a tare, the wrong sign."""

import numpy as np
import scipy

from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.inspection import InspectionFinding
from softcal.core.inspection.levels import equal_runs, find_shift
from softcal.core.inspection.outliers import column_scale
from softcal.core.recording import Array, Indices, Mask

BINS = 24
"""Levels of the output at which the reference is averaged."""

MIN_SAMPLES = 10 * BINS
"""With fewer samples a level its mean follows each of them, and some shift leaves nothing open by chance."""

SMOOTHED = 5
"""Samples over which an output is averaged before its direction is read."""


def reference_findings(
    t_s: Array, output: Array, reference: Array, sample_rate_Hz: float, config: InspectionConfig
) -> list[InspectionFinding]:
    """Return the findings of a reference without outliers, compared with its output."""
    if np.ptp(reference) == 0:
        return [InspectionFinding("constant", "reference", 0, len(t_s), float(t_s[0]), float(reference[0]), 0.0)]
    if stuck := _stuck(t_s, output, reference, sample_rate_Hz, config):
        return stuck
    # Beside a lag, levels do not belong together: a tare would be found that is none.
    return [
        *_sign(t_s, reference),
        *(
            _lag(t_s, output, reference, sample_rate_Hz, config)
            or [*_slower_reference(t_s, reference, config), *_tares(t_s, output, reference, config)]
        ),
    ]


def _stuck(
    t_s: Array, output: Array, reference: Array, sample_rate_Hz: float, config: InspectionConfig
) -> list[InspectionFinding]:
    """Return where a reference is constant while the output is pressed: a dead or saturated channel."""
    span = column_scale(output).span
    for start, length in zip(*equal_runs(reference), strict=True):
        if length < config.stuck_s * sample_rate_Hz:
            continue
        if np.ptp(np.quantile(output[start : start + length], (0.05, 0.95))) > config.stuck_share * span:
            rows, value = (int(start), int(start + length)), float(reference[start])
            return [InspectionFinding("stuck", "reference", *rows, float(t_s[start]), value, length / sample_rate_Hz)]
    return []


def _sign(t_s: Array, reference: Array) -> list[InspectionFinding]:
    low, high = (float(value) for value in np.quantile(reference, (0.01, 0.99)))
    # A load cell that counts compression negative; a reference around zero has both signs.
    if not (low < 0 and high < 0.1 * abs(low)):
        return []
    return [InspectionFinding("sign", "reference", 0, len(t_s), float(t_s[0]), low, 0.0)]


def _levels(output: Array) -> Indices:
    """Return the level of each sample, (n,): BINS of equal size, fewer on a coarse converter."""
    edges = np.unique(np.quantile(output, np.linspace(0, 1, BINS + 1)[1:-1]))
    return np.searchsorted(edges, output, side="right").astype(np.int64)


def unexplained_share(levels: Indices, reference: Array) -> float:
    """Return the share of a reference's variance that its mean at equal output leaves, whatever the curve."""
    means = np.bincount(levels, reference, BINS) / np.maximum(np.bincount(levels, minlength=BINS), 1)
    spread = float(np.var(reference))
    return float(np.mean((reference - means[levels]) ** 2)) / spread if spread > 0 else 1.0


def _lag(
    t_s: Array, output: Array, reference: Array, sample_rate_Hz: float, config: InspectionConfig
) -> list[InspectionFinding]:
    if len(output) < MIN_SAMPLES:
        return []
    longest = min(round(config.max_lag_s * sample_rate_Hz), len(output) // 4)
    # Some 60 shifts are enough to see a lag, whatever the rate; the best one is then refined.
    stride = max(1, longest // 30)

    levels = _levels(output)

    def scatter(shift: int) -> float:
        late, early = max(shift, 0), max(-shift, 0)
        return unexplained_share(levels[early : len(output) - late], reference[late : len(reference) - early])

    shifts = list(range(-longest, longest + 1, stride))
    scatters = np.array([scatter(shift) for shift in shifts])
    # Half a period later a programme that repeats itself explains the output as well, the other way round.
    bound = scatters.min() + config.lag_tie * max(scatter(0) - scatters.min(), 0.0)
    padded = np.concatenate([[np.inf], scatters, [np.inf]])
    is_low = (scatters <= padded[:-2]) & (scatters <= padded[2:]) & (scatters <= bound)
    best = min((shifts[k] for k in np.flatnonzero(is_low)), key=abs)
    best = min(range(best - stride + 1, best + stride), key=scatter)
    min_scatter, unshifted = scatter(best), scatter(0)
    gain = config.lag_gain if best > 0 else config.relaxed_gain
    if abs(best) < config.min_lag_s * sample_rate_Hz or unshifted <= 0 or min_scatter > gain * unshifted:
        return []
    lag_s = best / sample_rate_Hz
    return [InspectionFinding("lag", "reference", 0, len(t_s), float(t_s[0]), lag_s, 1 - min_scatter / unshifted)]


def _slower_reference(t_s: Array, reference: Array, config: InspectionConfig) -> list[InspectionFinding]:
    starts, lengths = equal_runs(reference)
    if len(starts) < 2 * BINS:
        return []
    usual = int(np.median(lengths[1:-1]))
    # A reference at rest holds for several periods: whole numbers of them.
    is_periodic = np.mean(lengths[1:-1] % usual == 0) > 0.9
    hold_s = usual * float(np.median(np.diff(t_s)))
    # Time stamps are rounded.
    if usual < config.hold_rows or round(hold_s, 3) < config.min_lag_s or not is_periodic:
        return []
    rate_Hz = 1 / hold_s
    return [InspectionFinding("held", "reference", 0, len(t_s), float(t_s[0]), rate_Hz, float(usual))]


def _tares(t_s: Array, output: Array, reference: Array, config: InspectionConfig) -> list[InspectionFinding]:
    """Return where reference and output separate permanently at one sample: the reference was tared, or set again."""
    span, margin = column_scale(reference).span, config.step_rows
    if len(reference) <= 2 * margin + 1:
        return []
    shift, steps = find_shift(reference, _curve_cells(output)), np.diff(reference)
    # The load moves on at its pace while the reference jumps.
    jumps = np.zeros(len(steps))
    jumps[1:-1] = steps[1:-1] - (steps[:-2] + steps[2:]) / 2
    near = np.arange(max(shift.row - margin, margin), min(shift.row + margin, len(steps) - margin))
    # Drift and creep hide a part of the step from the levels.
    fitting = near[_agree(jumps[near], shift.amount)]
    largest = margin + int(np.argmax(np.abs(jumps[margin : len(jumps) - margin])))
    others = np.abs(np.delete(jumps, np.s_[largest - 1 : largest + 2])).max()
    # No press is as fast as this jump, the reference stays where it jumped to, and the output has not followed.
    settled = largest + 1 + round(config.max_lag_s / float(np.median(np.diff(t_s))))
    lasting = np.median(reference[largest + 1 : largest + 6]) - np.median(reference[largest - 4 : largest + 1])
    offset = np.median(shift.residual[settled : settled + margin]) if settled + margin <= len(reference) else 0.0
    offset -= np.median(shift.residual[largest + 1 - margin : largest + 1])
    is_step = _agree(float(lasting), jumps[largest]) and _agree(offset, jumps[largest])
    if len(fitting) and shift.gains[shift.row] > max(config.step_gain, shift.trend_explained):
        row = int(fitting[np.argmax(np.abs(jumps[fitting]))])
    elif abs(jumps[largest]) > config.single_jump * others and is_step:
        row = largest
    else:
        return []
    share = abs(float(jumps[row])) / span
    if share < config.step_share:
        return []
    return [InspectionFinding("tare", "reference", row + 1, row + 2, float(t_s[row + 1]), float(jumps[row]), share)]


def _agree(a: Array | float, b: Array | float) -> Mask:
    """Return which steps have one sign and sizes within a factor of two."""
    return np.asarray((a * b > 0) & (np.abs(a) < 2 * np.abs(b)) & (np.abs(b) < 2 * np.abs(a)))


def _curve_cells(output: Array) -> Indices:
    """Return the cell of each sample, (n,), by level and direction of the output."""
    # A recording without a reference, as an estimate has it, does not wait for SciPy.
    is_rising = np.gradient(scipy.ndimage.uniform_filter1d(output, SMOOTHED)) > 0
    return np.asarray(_levels(output) + BINS * is_rising)
