"""Findings in the time stamps of a recording: gaps, pauses, another rate in a part, rows per window."""

import numpy as np

from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.inspection import InspectionFinding
from softcal.core.recording import GAP_FACTOR, RATE_TOLERANCE, Array, Mask
from softcal.core.windows import TAPS


def timing_findings(
    t_s: Array, output: Array, sample_rate_Hz: float, config: InspectionConfig
) -> list[InspectionFinding]:
    """Return gaps, pauses, and stretches that were sampled at another rate than the rest.

    A gap or a pause has its length in s as value and the number of samples that are missing as amount; a stretch at
    another rate has that rate in Hz as value and its share of the rows as amount. A pause is a gap of many seconds
    with the output at rest before and after: the logger was stopped between two presses.

    Args:
        output: (n,) without missing samples.
    """
    if len(t_s) < 2:
        return []
    steps, findings = np.diff(t_s), []
    is_long = steps > GAP_FACTOR / sample_rate_Hz
    is_at_rest = _rest_rows(output, config)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_long, [False]])))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        usual = float(np.median(steps[start:stop]))
        # So many long steps in a row, as long as each other, are no gaps but another rate.
        if stop - start >= TAPS and np.mean(np.abs(steps[start:stop] / usual - 1) < 10 * RATE_TOLERANCE) > 0.5:
            share = (stop - start) / len(t_s)
            findings.append(InspectionFinding("rate", "t_s", start, stop + 1, float(t_s[start]), 1 / usual, share))
            continue
        for row in range(start, stop):
            missing = float(round(steps[row] * sample_rate_Hz) - 1)
            neighbours = slice(max(row + 1 - config.pause_rows, 0), row + 1 + config.pause_rows)
            is_pause = steps[row] >= config.pause_s and bool(is_at_rest[neighbours].all())
            kind = "pause" if is_pause else "gap"
            findings.append(
                InspectionFinding(kind, "t_s", row + 1, row + 2, float(t_s[row]), float(steps[row]), missing)
            )
    return findings


def _rest_rows(output: Array, config: InspectionConfig) -> Mask:
    """Return which samples lie where the output rests, (n,): at the end of its range that
    holds more samples."""
    low, high = np.quantile(output, (0.01, 0.99))
    band = config.rest_band * (high - low)
    is_low, is_high = output <= low + band, output >= high - band
    return np.asarray(is_low if np.count_nonzero(is_low) >= np.count_nonzero(is_high) else is_high)


def window_share(t_s: Array, samples: int, sample_rate_Hz: float) -> float:
    """Return the share of the rows that would fill a window without gaps and masks and still do.

    Args:
        t_s: (m,) of the valid rows.
        samples: rows of the file.
    """
    breaks = np.flatnonzero(np.diff(t_s) > GAP_FACTOR / sample_rate_Hz) + 1
    lengths = np.diff(np.concatenate([[0], breaks, [len(t_s)]]))
    return float(np.sum(np.maximum(lengths - TAPS + 1, 0)) / max(samples - TAPS + 1, 1))
