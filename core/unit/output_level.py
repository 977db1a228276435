"""Where the output of a unit stands, and how its estimates read their loads: two straight-line summaries."""

from dataclasses import dataclass

import numpy as np

from softcal.core.metrics import quantile
from softcal.core.recording import Array, OutputRecording


@dataclass(frozen=True)
class OutputLevel:
    """Where the output of a unit stands at rest, and its span to its highest loads (above 0), in the output's unit."""

    rest: float
    span: float


@dataclass(frozen=True)
class LoadLine:
    """How a unit reads its loads: estimate = zero + gain x reference (least squares); gain 1 reads them in full.

    The zero is in the reference unit.
    """

    gain: float
    zero: float


def output_level(recording: OutputRecording, *, is_rising: bool, rest: float) -> OutputLevel:
    """Return where the output of a unit stands, at the quantiles `rest` and 1 - `rest` of its samples."""
    low, high = (float(value) for value in quantile(recording.output, (rest, 1 - rest)))
    return OutputLevel(low if is_rising else high, high - low)


def load_line(estimate: Array, reference: Array) -> LoadLine:
    """Return the line of (n,) estimates over the reference, rows without an estimate (NaN) left out."""
    rows = np.isfinite(estimate)
    gain, zero = np.polyfit(reference[rows], estimate[rows], 1)
    return LoadLine(float(gain), float(zero))
