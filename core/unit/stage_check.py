"""What a unit reads against what the source's load cell read at the same stage position and history."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from softcal.core.errors import UnitRefused
from softcal.core.maps.phase import NEAR_SHARE, paired_by_stage, stage_histories
from softcal.core.recording import Array, LabelledRecording, OutputRecording

BLOCKS = 8
APART_S = 2.0
"""The source is compared with itself at least this long before and after."""

SLOW_S = 1.0
"""Differences that survive a mean over this long are no noise and no timing: they are creep, drift or a wrong curve."""


@dataclass(frozen=True)
class StageDifference:
    """Difference between estimates and the source's reference at equal stage histories, in the reference unit.

    Args:
        rms: of all windows.
        slow_rms: of its means over `SLOW_S`.
    """

    rms: float
    slow_rms: float

    def beyond(self, floor: "StageDifference") -> "StageDifference":
        """Return what exceeds a floor, in quadrature."""
        return StageDifference(
            float(np.sqrt(max(self.rms**2 - floor.rms**2, 0.0))),
            float(np.sqrt(max(self.slow_rms**2 - floor.slow_rms**2, 0.0))),
        )


def unit_difference(source: LabelledRecording, target: OutputRecording, estimate: Array) -> StageDifference | None:
    """Compare a unit with its source; None where no stage position or too few shared ones are known.

    Args:
        source: labelled recording of the source.
        target: recording of the unit.
        estimate: (m,) of the unit, one per full window.
    """
    try:
        source_rows, target_rows = paired_by_stage(source.unlabelled, target)
    except UnitRefused:
        return None
    difference = estimate[target_rows] - source.window_reference[source_rows]
    return _summed_up(difference, target.t_s[target.window_rows[target_rows]])


def source_difference(source: LabelledRecording, estimate: Array) -> StageDifference | None:
    """Compare the source with itself at other times: what is left is no fault of a unit.

    Args:
        source: labelled recording of the source.
        estimate: (n,) f on its own windows.
    """
    recording = source.unlabelled
    if recording.stage_mm is None or np.ptp(recording.stage_mm) == 0:
        return None
    histories, t_s = stage_histories(recording, recording.stage_mm), recording.t_s[recording.window_rows]
    near = NEAR_SHARE * float(np.ptp(recording.stage_mm))
    differences, times = [], []
    for block in np.array_split(np.arange(len(t_s)), BLOCKS):
        others = np.flatnonzero((t_s < t_s[block[0]] - APART_S) | (t_s > t_s[block[-1]] + APART_S))
        if not len(others):
            continue
        distance, nearest = cKDTree(histories[others]).query(histories[block])
        alike = distance <= near
        differences.append((estimate[block] - source.window_reference[others[nearest]])[alike])
        times.append(t_s[block][alike])
    if not sum(map(len, differences)):
        return None
    return _summed_up(np.concatenate(differences), np.concatenate(times))


def _summed_up(difference: Array, t_s: Array) -> StageDifference:
    _, second = np.unique((t_s // SLOW_S).astype(np.int64), return_inverse=True)
    counts = np.bincount(second)
    means = np.bincount(second, difference) / counts
    return StageDifference(float(np.sqrt(np.mean(difference**2))), float(np.sqrt(np.average(means**2, weights=counts))))
