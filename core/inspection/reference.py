"""What a reference shows beside its output: a lag, a slower rate, a tare in the middle, the wrong sign."""

from dataclasses import dataclass

import numpy as np

from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.inspection import InspectionFinding
from softcal.core.inspection.levels import equal_runs
from softcal.core.inspection.outliers import column_scale
from softcal.core.recording import Array, Indices

BINS = 24
"""Levels of the output at which the reference is averaged."""

MIN_SAMPLES = 10 * BINS
"""With fewer samples a level its mean follows each of them, and some shift leaves nothing open by chance."""

SMOOTHED = 5
"""Samples over which an output is averaged before its direction is read."""


def reference_findings(
    t_s: Array, output: Array, reference: Array, sample_rate_Hz: float, config: InspectionConfig
) -> list[InspectionFinding]:
    """Return what a reference without outliers shows beside its output."""
    if np.ptp(reference) == 0:
        return [InspectionFinding("constant", "reference", 0, len(t_s), float(t_s[0]), float(reference[0]), 0.0)]
    # Beside a lag, levels do not belong together: a tare would be found that is none.
    return [
        *_sign(t_s, reference),
        *(
            _lag(t_s, output, reference, sample_rate_Hz, config)
            or [*_slower_reference(t_s, reference, config), *_tares(t_s, output, reference, config)]
        ),
    ]


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
    least, unshifted = scatter(best), scatter(0)
    gain = config.lag_gain if best > 0 else config.relaxed_gain
    if abs(best) < config.least_lag_s * sample_rate_Hz or unshifted <= 0 or least > gain * unshifted:
        return []
    lag_s = best / sample_rate_Hz
    return [InspectionFinding("lag", "reference", 0, len(t_s), float(t_s[0]), lag_s, 1 - least / unshifted)]


def _slower_reference(t_s: Array, reference: Array, config: InspectionConfig) -> list[InspectionFinding]:
    starts, lengths = equal_runs(reference)
    if len(starts) < 2 * BINS:
        return []
    usual = int(np.median(lengths[1:-1]))
    # A reference at rest holds for several periods: whole numbers of them.
    is_whole = np.mean(lengths[1:-1] % usual == 0) > 0.9
    held_s = usual * float(np.median(np.diff(t_s)))
    # Time stamps are rounded.
    if usual < config.held_rows or round(held_s, 3) < config.least_lag_s or not is_whole:
        return []
    rate_Hz = 1 / held_s
    return [InspectionFinding("held", "reference", 0, len(t_s), float(t_s[0]), rate_Hz, float(usual))]


def _tares(t_s: Array, output: Array, reference: Array, config: InspectionConfig) -> list[InspectionFinding]:
    """Return where reference and output part at once and for good: the reference was tared, or set anew."""
    span, least = column_scale(reference).span, config.step_rows
    if len(reference) < 2 * least:
        return []
    shift = find_shift(output, reference)
    near = np.arange(max(shift.row - least, 1), min(shift.row + least, len(reference) - 2))
    steps = np.diff(reference)
    # The load moves on at its pace while the reference jumps.
    jumps = steps[near] - (steps[near - 1] + steps[near + 1]) / 2
    is_jump = np.abs(jumps - shift.amount) < abs(shift.amount) / 2
    is_clear = shift.explained > max(config.step_gain, shift.trend_explained)
    if abs(shift.amount) < config.step_share * span or not is_clear or not is_jump.any():
        return []
    best = int(np.argmax(np.where(is_jump, np.abs(jumps), 0.0)))
    row, jump = int(near[best]), float(jumps[best])
    return [InspectionFinding("tare", "reference", row + 1, row + 2, float(t_s[row + 1]), jump, abs(jump) / span)]


@dataclass(frozen=True, eq=False)
class Shift:
    """The step over time that explains most of what the output leaves open of the reference.

    Args:
        gains: (n - 1,) share of the open variance that a step after each row takes away.
        row: the best one: last row of the old level.
        amount: new level less the old one, in the reference's unit.
        trend_explained: share that a straight line over time takes away.
    """

    gains: Array
    row: int
    amount: float
    trend_explained: float

    @property
    def explained(self) -> float:
        return float(self.gains[self.row])


def find_shift(output: Array, reference: Array) -> Shift:
    """Fit the reference by a curve over level and direction of the output and one step over time (least squares).

    Step and trend are taken within the cells of the curve, so that the loads before and after need not be alike
    (Frisch and Waugh 1933).
    """
    # A recording without a reference, as an estimate has it, does not wait for SciPy.
    from scipy.ndimage import uniform_filter1d

    is_rising = np.gradient(uniform_filter1d(output, SMOOTHED)) > 0
    cells = _levels(output) + BINS * is_rising
    rest = _within(cells, reference)
    total, n = max(float(rest @ rest), np.finfo(float).tiny), len(rest)
    sums = -np.cumsum(rest)[:-1]
    sizes = np.zeros(n - 1)
    for cell in np.unique(cells):
        is_cell = cells == cell
        before = np.cumsum(is_cell)[:-1]
        count = np.count_nonzero(is_cell)
        sizes += before * (count - before) / count
    sizes = np.maximum(sizes, 1.0)
    gains = sums**2 / sizes / total
    trend = _within(cells, np.arange(n, dtype=np.float64))
    row = int(np.argmax(gains))
    trend_gain = float(rest @ trend) ** 2 / max(float(trend @ trend), 1.0) / total
    return Shift(gains, row, float(sums[row] / sizes[row]), trend_gain)


def _within(cells: Indices, values: Array) -> Array:
    """Return values less their mean in each cell."""
    means = np.bincount(cells, values) / np.maximum(np.bincount(cells), 1)
    return np.asarray(values - means[cells])
