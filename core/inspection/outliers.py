"""Samples that no sensor gave: overflow codes, spikes faster than any press, dropouts. Quantiles alone decide."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.inspection.config import InspectionConfig
from softcal.core.recording import GAP_FACTOR, Array, Mask

CODES = (
    *(sign * code for code in (9.9e37, 9.91e37, 999.0, 9999.0, 99999.0, 999999.0) for sign in (1.0, -1.0)),
    *(float(2**bits - 1) for bits in (7, 8, 15, 16, 23, 24, 31, 32)),
    *(float(-(2**bits)) for bits in (7, 15, 23, 31)),
)
"""What loggers write where they have no sample: SCPI's overflow and not-a-number, nines, and the ends of integers."""


@dataclass(frozen=True, eq=False)
class Scale:
    """Robust scales of a column: usual step and usual excursion.

    Args:
        span: between its 1 % and 99 % quantiles.
        step: smallest step of the readout.
        jump: 99 % quantile of the differences of neighbours.
    """

    span: float
    step: float
    jump: float


def column_scale(values: Array) -> Scale:
    """Return the scale of a column without missing samples."""
    low, high = np.quantile(values, (0.01, 0.99))
    steps = np.abs(np.diff(values))
    return Scale(
        float(high - low),
        float(np.min(np.diff(np.unique(values)), initial=np.inf)),
        float(np.quantile(steps, 0.99)) if len(steps) else 0.0,
    )


def find_overflows(values: Array, config: InspectionConfig) -> Mask:
    """Return which samples of a column are overflow codes or lie beyond anything the others show, (n,).

    Values are removed from the ends while they are isolated: one column may contain several codes.
    """
    is_code = ~np.isfinite(values) & ~np.isnan(values)
    while True:
        remaining = values[np.isfinite(values) & ~is_code]
        ends = {end for end in (remaining.min(initial=np.inf), remaining.max(initial=-np.inf)) if np.isfinite(end)}
        codes = [end for end in ends if _is_overflow_code(remaining, end, config)]
        if not codes:
            return is_code
        is_code |= np.isin(values, codes)


def _is_overflow_code(values: Array, end: float, config: InspectionConfig) -> bool:
    others = values[values != end]
    if len(others) <= len(values) / 2:
        return False
    low, middle, high = np.quantile(others, (0.01, 0.5, 0.99))
    count = len(values) - len(others)
    factor = config.code_factor if end in CODES else config.overflow_factor
    is_rare = end in CODES or count <= config.outlier_share * len(values)
    return bool(is_rare and high > low and abs(end - middle) > factor * (high - low))


def find_spikes(t_s: Array, values: Array, sample_rate_Hz: float, min_share: float, config: InspectionConfig) -> Mask:
    """Return the spikes of a column, (n,): excursions that return faster than any press.

    The height of a run of samples is how far all of them lie beyond both its neighbours. What is usual is learned from
    the recording itself: noise, steps of the converter and taps have heights too.

    Args:
        values: (n,) without missing samples.
        min_share: lower spikes, as a share of the range, are none.
    """
    longest = min(max(1, round(config.spike_s * sample_rate_Hz)), config.max_spike_samples)
    is_spike = np.zeros(len(values), dtype=np.bool_)
    if len(values) <= 2 * longest + 2:
        return is_spike
    filled = values
    while True:
        new = _spike_rows(t_s, filled, longest, GAP_FACTOR / sample_rate_Hz, min_share, config) & ~is_spike
        if not new.any():
            return is_spike
        is_spike |= new
        filled = fill(values, is_spike)


def fill(values: Array, is_invalid: Mask) -> Array:
    """Return a column with invalid samples on the line between their neighbours."""
    if not is_invalid.any() or is_invalid.all():
        return values
    filled, rows = values.copy(), np.flatnonzero(~is_invalid)
    filled[is_invalid] = np.interp(np.flatnonzero(is_invalid), rows, values[rows])
    return filled


def _spike_rows(
    t_s: Array, values: Array, longest: int, gap_s: float, min_share: float, config: InspectionConfig
) -> Mask:
    # The first and the last sample have one neighbour: beside them stands what the next samples usually are.
    lengths, margin = range(1, longest + 1), 2 * longest + 1
    ends = np.median(values[:margin]), np.median(values[-margin:])
    padded = np.concatenate([ends[:1], values, ends[1:]])
    period_s = gap_s / GAP_FACTOR
    times_s = np.concatenate([[t_s[0] - period_s], t_s, [t_s[-1] + period_s]])
    steps = np.abs(np.diff(padded))
    min_height = max(min_share * column_scale(values).span, np.finfo(float).tiny)
    low, high = _inlier_range(values, min_height, config)
    is_apart = (values <= low) | (values >= high)
    heights = {(length, sign): _run_heights(sign * padded, length) for length in lengths for sign in (1, -1)}
    # Spikes, and the lines that stand in their place, have finer steps than the readout.
    count = float(np.quantile(steps[steps > 0], config.readout_step)) if np.any(steps > 0) else 0.0
    unusual = _unusual_heights(heights, count, config)
    hits: list[tuple[float, int, int, int]] = []
    highest = {sign: np.zeros(len(padded)) for sign in (1, -1)}
    for (length, sign), height in heights.items():
        is_all_apart = np.lib.stride_tricks.sliding_window_view(is_apart, length).all(axis=1)
        is_high = height > unusual[sign]
        # A recording may start or end within a press.
        is_high[[0, -1]] = False
        # Where samples are missing, or come at a slower rate, a run lasts as long as a press.
        is_short = times_s[length + 1 :] - times_s[: -length - 1] <= (length + 1) * gap_s
        starts = np.flatnonzero((is_high | is_all_apart) & (height > min_height) & is_short)
        edges = (steps[:-length] + steps[length:]) / max(unusual[sign], min_height)
        hits += [(-float(edges[start]), length, int(start), sign) for start in starts]
        for k in range(length):
            highest[sign][starts + 1 + k] = np.maximum(highest[sign][starts + 1 + k], height[starts])
    is_spike = np.zeros(len(values), dtype=np.bool_)
    # A spike makes runs beside it and around it high, too. The one whose edges are the most unusual is the spike; the
    # others are looked at again without it. What lies between two spikes is good, however far both are from it.
    ranked = [
        (bool(2 * min(highest[-sign][[row, row + length + 1]]) > heights[length, sign][row]), edge, length, row)
        for edge, length, row, sign in hits
    ]
    for _, _, length, start in sorted(ranked):
        if not is_spike[max(start - 1, 0) : start + length + 1].any():
            is_spike[start : start + length] = True
    return is_spike


def _run_heights(values: Array, length: int) -> Array:
    """Return by how much runs of samples lie above both neighbours, (n - length - 1,), 0 where not all do."""
    runs = np.lib.stride_tricks.sliding_window_view(values[1:-1], length)
    before, after = values[: len(runs)], values[length + 1 :]
    return np.asarray(np.maximum(runs.min(axis=1) - np.maximum(before, after), 0.0))


def _unusual_heights(
    heights: Mapping[tuple[int, int], Array], count: float, config: InspectionConfig
) -> dict[int, float]:
    """Return the height that no usual excursion has, up (1) and down (-1).

    Presses peak to one side: excursions to the other side are compared with the excursions of that side.

    Args:
        heights: (length, side) → height of each run.
        count: step of the readout.
    """
    usual, rare = (
        {side: max(float(np.quantile(heights[key], part)) for key in heights if key[1] == side) for side in (1, -1)}
        for part in (config.usual_excursion, config.rare_excursion)
    )
    return {
        side: max(
            min(config.spike_factor * usual[side], config.rare_factor * rare[side]),
            config.other_side_factor * usual[-side],
            config.spike_counts * count,
        )
        for side in (1, -1)
    }


def _inlier_range(values: Array, min_gap: float, config: InspectionConfig) -> tuple[float, float]:
    """Return the last values beyond which a few others lie apart by a gap; infinite where none do."""
    ordered = np.sort(values)
    few = max(1, int(config.outlier_share * len(values)))
    lower, upper = ordered[: few + 1], ordered[-few - 1 :]
    low, high = np.flatnonzero(np.diff(lower) > min_gap), np.flatnonzero(np.diff(upper) > min_gap)
    return (
        float(lower[low[-1]]) if len(low) else -np.inf,
        float(upper[high[0] + 1]) if len(high) else np.inf,
    )
