"""What the time stamps of a recording show: gaps, another rate in a part of it, how many rows fill a window."""

import numpy as np

from softcal.core.inspection.inspection import InspectionFinding
from softcal.core.recording import GAP_FACTOR, RATE_TOLERANCE, Array
from softcal.core.windows import TAPS


def timing_findings(t_s: Array, sample_rate_Hz: float) -> list[InspectionFinding]:
    """Return gaps, and stretches that were sampled at another rate than the rest.

    A gap has its length in s as value and the number of samples that are missing as amount; a stretch at another rate
    has that rate in Hz as value and its share of the rows as amount.
    """
    if len(t_s) < 2:
        return []
    steps, findings = np.diff(t_s), []
    is_long = steps > GAP_FACTOR / sample_rate_Hz
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
            findings.append(
                InspectionFinding("gap", "t_s", row + 1, row + 2, float(t_s[row]), float(steps[row]), missing)
            )
    return findings


def window_share(t_s: Array, samples: int, sample_rate_Hz: float) -> float:
    """Return the share of the rows that would fill a window without gaps and masks and still do.

    Args:
        t_s: (m,) of the valid rows.
        samples: rows of the file.
    """
    breaks = np.flatnonzero(np.diff(t_s) > GAP_FACTOR / sample_rate_Hz) + 1
    lengths = np.diff(np.concatenate([[0], breaks, [len(t_s)]]))
    return float(np.sum(np.maximum(lengths - TAPS + 1, 0)) / max(samples - TAPS + 1, 1))
