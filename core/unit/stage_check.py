"""What a unit reads against what the source's load cell read at the same stage position and history."""

from dataclasses import dataclass

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.paired import paired_by_stage, stage_histories
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.method import Method


@dataclass(frozen=True)
class StageDifference:
    """Difference between estimates and the source's reference at equal stage histories, in the reference unit.

    Args:
        slow_rms: of its means over a second or so (`StageCheckConfig.slow_s`).
    """

    rms: float
    slow_rms: float

    def beyond(self, floor: "StageDifference") -> "StageDifference":
        """Return what exceeds a floor, in quadrature."""
        return StageDifference(
            float(np.sqrt(max(self.rms**2 - floor.rms**2, 0.0))),
            float(np.sqrt(max(self.slow_rms**2 - floor.slow_rms**2, 0.0))),
        )


def unit_difference(
    source: LabelledRecording, target: OutputRecording, estimate: Array, method: Method
) -> StageDifference | None:
    """Compare a unit with its source; None where no stage position or too few shared ones are known.

    Args:
        estimate: (m,) of the unit, one per full window.
    """
    try:
        source_rows, target_rows = paired_by_stage(source.unlabelled, target, method.map)
    except UnitRefused:
        return None
    difference = estimate[target_rows] - source.window_reference[source_rows]
    return _summed_up(difference, target.t_s[target.window_rows[target_rows]], method.stage_check.slow_s)


def source_difference(source: LabelledRecording, estimate: Array, method: Method) -> StageDifference | None:
    """Compare the source with itself at other times: what is left is no fault of a unit.

    Args:
        estimate: (n,) f on its own windows.
    """
    recording, config = source.unlabelled, method.stage_check
    if recording.stage_mm is None or np.ptp(recording.stage_mm) == 0:
        return None
    # Most lots have no stage: they need not load it.
    from scipy.spatial import cKDTree

    histories = stage_histories(recording, recording.stage_mm, method.map.phase)
    t_s = recording.t_s[recording.window_rows]
    near = method.map.phase.near_share * float(np.ptp(recording.stage_mm))
    differences, times = [], []
    for block in np.array_split(np.arange(len(t_s)), config.blocks):
        # A window must not be compared with itself or its neighbours: they agree whatever the source repeats.
        first_s, last_s = t_s[block[0]] - config.apart_s, t_s[block[-1]] + config.apart_s
        others = np.flatnonzero((t_s < first_s) | (t_s > last_s))
        if not len(others):
            continue
        distance, nearest = cKDTree(histories[others]).query(histories[block])
        alike = distance <= near
        differences.append((estimate[block] - source.window_reference[others[nearest]])[alike])
        times.append(t_s[block][alike])
    if not sum(map(len, differences)):
        return None
    return _summed_up(np.concatenate(differences), np.concatenate(times), config.slow_s)


def _summed_up(difference: Array, t_s: Array, slow_s: float) -> StageDifference:
    # Means over a second leave level and gain and take the noise off: both are wanted apart.
    _, second = np.unique((t_s // slow_s).astype(np.int64), return_inverse=True)
    counts = np.bincount(second)
    means = np.bincount(second, difference) / counts
    return StageDifference(float(np.sqrt(np.mean(difference**2))), float(np.sqrt(np.average(means**2, weights=counts))))
