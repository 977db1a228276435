"""Pairs at equal stage position: two units pressed equally deep, with equal histories, carry equal loads.

The station knows the stage position of both recordings, although the load on the unit is not measured.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.config import MapConfig, PhaseConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.paired import PairedMap, fit_pairs, paired_map_from_arrays
from softcal.core.recording import Array, OutputRecording
from softcal.core.words.reason import reason


@dataclass(frozen=True)
class Phase:
    """Pair windows whose stage histories agree and regress the source's on the target's.

    Assumes that equal travel means equal load: true for pads from one mould, not for units of different stiffness.
    """

    name: str = "phase"

    def fit(self, problem: FitProblem) -> PairedMap:
        """Fit the map.

        Raises:
            UnitRefused: a recording has no stage position, or the two share too few positions.
        """
        source, target = problem.source.unlabelled, problem.target
        source_rows, target_rows = paired_by_stage(source, target, problem.config)
        return fit_pairs(problem, source_rows, target_rows, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> PairedMap:
        return paired_map_from_arrays(arrays, self.name)


def paired_by_stage(
    source: OutputRecording, target: OutputRecording, config: MapConfig
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the windows of both recordings at equal stage position, direction and recent history.

    Returns:
        Row numbers into `source.windows` and `target.windows`, equal lengths, in the target's time order.

    Raises:
        UnitRefused: a recording has no stage position, or too few positions are shared.
    """
    if source.stage_mm is None or target.stage_mm is None:
        raise UnitRefused(reason("no_position"))
    # Imported here: whoever applies a map does not wait for scipy.
    from scipy.spatial import cKDTree

    phase = config.phase
    known, asked = (stage_histories(r, r.stage_mm, phase) for r in (source, target) if r.stage_mm is not None)
    travel_mm = float(np.ptp(target.stage_mm))
    # Twice as many as the fit reads: some of them find no partner.
    rows = np.linspace(0, len(asked) - 1, min(2 * config.pairs.pairs, len(asked))).astype(np.int64)
    distance_mm, nearest = np.empty(len(rows)), np.empty(len(rows), np.int64)
    seen = _seen_entries(target, phase)[rows]
    # One tree for each length of known history: what lies before a gap must not be compared as if it were known.
    for entries in np.unique(seen):
        group = seen == entries
        tree = cKDTree(known[:, :entries])
        distance_mm[group], nearest[group] = tree.query(asked[rows[group], :entries])
    # A share of the travel, so that one number serves strokes of 1 mm and of 20 mm.
    alike = distance_mm <= phase.near_share * travel_mm
    if travel_mm <= 0 or alike.sum() < phase.min_pairs:
        raise UnitRefused(reason("few.positions", windows=int(alike.sum()), enough=phase.min_pairs))
    return nearest[alike].astype(np.int64), rows[alike]


def stage_histories(recording: OutputRecording, stage_mm: Array, config: PhaseConfig) -> Array:
    """Return where the stage stood now and before each full window, weighted: (m, len(config.history)) in mm."""
    ago_s = np.array(config.history) / recording.sample_rate_Hz
    asked_s = recording.t_s[recording.window_rows][:, None] - ago_s[None, :]
    return np.asarray(np.interp(asked_s, recording.t_s, stage_mm) * np.array(config.history_weight))


def _seen_entries(recording: OutputRecording, config: PhaseConfig) -> NDArray[np.int64]:
    """Return how many entries of each full window's history were recorded: what lies before a gap is not known.

    Before a recording begins the stage is taken to have stood where it begins.
    """
    begins_s = np.concatenate([np.full(s.stop - s.start, recording.t_s[s.start]) for s in recording.segments])
    # Nothing moved before the first sample; only gaps inside hide movements.
    begins_s[recording.segments[0]] = -np.inf
    ago_s = np.array(config.history) / recording.sample_rate_Hz
    # Half a sample of slack: times are kept in floating point.
    is_seen = recording.t_s[:, None] - ago_s >= begins_s[:, None] - 0.5 / recording.sample_rate_Hz
    return np.asarray(is_seen[recording.window_rows].sum(axis=1))
