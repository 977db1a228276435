"""Findings in the level of an output: baseline jumps, stuck stretches, counter wraps, clipped ends."""

from dataclasses import dataclass

import numpy as np

from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.inspection import InspectionFinding
from softcal.core.inspection.outliers import column_scale
from softcal.core.metrics import quantile
from softcal.core.recording import Array, Indices

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles that all move where a baseline does."""


def level_findings(
    t_s: Array, output: Array, sample_rate_Hz: float, config: InspectionConfig
) -> list[InspectionFinding]:
    """Return steps, wraps, stuck stretches and flat ends of an output without outliers."""
    wraps = _wraps(t_s, output, config)
    steps = [] if wraps else _step(t_s, output, config)
    clipped = [
        InspectionFinding("clipped", "output", int(rows[0]), int(rows[0]) + 1, float(t_s[rows[0]]), level, len(rows))
        for level, rows in find_flat_ends(output, config)
    ]
    return [*wraps, *steps, *_stuck(t_s, output, sample_rate_Hz, config), *clipped]


def _wraps(t_s: Array, output: Array, config: InspectionConfig) -> list[InspectionFinding]:
    """Return where a counter wrapped: a jump by nearly a power of two, between integers."""
    steps, span = np.diff(output), float(np.ptp(output))
    if np.any(output != np.round(output)) or span < 2**8:
        return []
    modulus = 2.0 ** np.round(np.log2(np.maximum(np.abs(steps), 1)))
    # A counter that wraps shows nearly all of its range, and no other movement is as fast.
    is_wrap = (modulus >= 2**8) & (np.abs(steps) >= config.wrap_share * modulus) & (modulus >= config.wrap_share * span)
    usual = float(quantile(np.abs(steps), 0.9))
    return [
        InspectionFinding(
            "wrap", "output", row + 1, row + 2, float(t_s[row + 1]), float(steps[row]), float(modulus[row])
        )
        for row in np.flatnonzero(is_wrap & (np.abs(steps) > config.jump_factor * usual)).tolist()
    ]


def _step(t_s: Array, output: Array, config: InspectionConfig) -> list[InspectionFinding]:
    """Return the step of an output whose whole range moves at once: another programme moves but its peaks."""
    shift, span = find_shift(output, np.zeros(len(output), dtype=np.int64)), column_scale(output).span
    before, after = output[: shift.row + 1], output[shift.row + 1 :]
    if min(len(before), len(after)) < config.step_rows:
        return []
    moved = quantile(after, LEVELS) - quantile(before, LEVELS)
    middle = float(np.median(moved))
    is_shift = bool(np.all(np.abs(moved - middle) < abs(middle) / 2)) and abs(middle) >= config.step_share * span
    near = slice(max(shift.row - config.step_rows, 0), shift.row + config.step_rows)
    jumps = np.diff(output[near])
    at = int(np.argmin(np.abs(jumps - middle)))
    # A drift moves the whole range too, but at no place at once.
    if (
        not is_shift
        or abs(jumps[at] - middle) > abs(middle) / 2
        or shift.gains[shift.row] < max(config.step_gain, shift.trend_explained)
    ):
        return []
    row = near.start + at
    share = abs(middle) / span
    return [InspectionFinding("step", "output", row + 1, row + 2, float(t_s[row + 1]), middle, share)]


def _stuck(t_s: Array, output: Array, sample_rate_Hz: float, config: InspectionConfig) -> list[InspectionFinding]:
    starts, lengths = equal_runs(output)
    order = np.argsort(lengths)[::-1]
    if len(order) < 2:
        return []
    longest = order[0]
    start, length = int(starts[longest]), int(lengths[longest])
    scale = column_scale(output)
    low, high = quantile(output, (0.05, 0.95))
    is_inside = low + config.step_share * scale.span < output[start] < high - config.step_share * scale.span
    others = int(lengths[order[1]])
    if not is_inside or length < config.stuck_s * sample_rate_Hz or length < config.stuck_factor * others:
        return []
    seconds = length / sample_rate_Hz
    finding = InspectionFinding(
        "stuck", "output", start, start + length, float(t_s[start]), float(output[start]), seconds
    )
    return [finding]


def find_flat_ends(output: Array, config: InspectionConfig) -> list[tuple[float, Indices]]:
    """Return level and rows of each end of an output's range at which the output saturates repeatedly.

    There its last value is far more frequent than what lies just inside: a readout that is cut off, or holds to the
    last digit. The end at which it begins is that of rest.
    """
    (low, high), ends = quantile(output, (0.01, 0.99)), []
    # A coarse converter has levels wider than that.
    band = max(config.flat_band * (high - low), 1.5 * column_scale(output).step)
    starts, lengths = equal_runs(output)
    for level in (float(output.max()), float(output.min())):
        runs = starts[(output[starts] == level) & (lengths >= config.hold_rows)]
        rows = np.flatnonzero(output == level)
        inside = np.count_nonzero(np.abs(output - level) <= band) - len(rows)
        is_rest = abs(level - float(np.median(output[: config.step_rows]))) < (high - low) / 2
        if not is_rest and len(runs) >= config.flat_runs and len(rows) > config.flat_factor * inside:
            ends.append((level, rows.astype(np.int64)))
    return ends


def equal_runs(values: Array) -> tuple[Indices, Indices]:
    """Return where runs of one value start and how long they are."""
    starts = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0]))
    return starts, np.diff(np.concatenate([starts, [len(values)]]))


@dataclass(frozen=True, eq=False)
class Shift:
    """A step in time that explains most of the variance of a series, or of its residual within cells.

    Args:
        gains: (n - 1,) share of the open variance that a step after each row takes away.
        row: the best one: last row of the old level.
        amount: new level less the old one.
        residual: (n,) the series less its mean in each cell.
        trend_explained: share that a straight line over time takes away.
    """

    gains: Array
    row: int
    amount: float
    residual: Array
    trend_explained: float


def find_shift(values: Array, cells: Indices) -> Shift:
    """Fit a series by its mean in each cell and one step over time (least squares, CUSUM).

    Step and trend are estimated within the cells, so that the loading before and after may differ (Frisch and
    Waugh 1933).

    Args:
        cells: (n,) of each sample; all equal for the level alone.
    """
    rest = _within(cells, values)
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
    return Shift(gains, row, float(sums[row] / sizes[row]), rest, trend_gain)


def _within(cells: Indices, values: Array) -> Array:
    """Return values less their mean in each cell."""
    means = np.bincount(cells, values) / np.maximum(np.bincount(cells), 1)
    return np.asarray(values - means[cells])
