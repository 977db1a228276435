"""An affine map from level crossings: blind to how long and how fast each unit was pressed."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.affine import AffineMap
from softcal.core.maps.crossing import LevelPath, averaging_length, level_path
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import Array

SHARES = np.array([0.005, 0.01, 0.02, 0.05, 0.1, 0.9, 0.95, 0.98, 0.99, 0.995, 1.0])
"""Shares of the path at which levels are matched: near rest and near the peaks, which units share most."""

ALL_SHARES = np.linspace(0.02, 0.98, 49)
"""Shares over the whole path: where they ask for another gain than its ends, the depths of the presses differ."""


@dataclass(frozen=True)
class LabelShift:
    """Match the crossing measures of the two outputs by a gain and an offset.

    With N(x) the number of times the output crosses level x, both recordings hold the same N up to a factor when the
    units are pressed between the same rest and peaks, however the time between is spent. Gain and offset match the
    quantiles of the two measures near both ends in their first two moments, the affine transport of one dimension; the
    weight of each source sample follows afterwards as the ratio of the time spent (`level_weights`).
    """

    name: str = "label_shift"

    def fit(self, problem: FitProblem) -> AffineMap:
        """Fit gain and offset.

        Raises:
            UnitRefused: one of the outputs makes no swing that stands out of its noise.
        """
        source_path, target_path = paths(problem)
        gain, offset = matched(source_path, target_path)
        return AffineMap(gain, offset, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> AffineMap:
        """Rebuild a map from its arrays."""
        return AffineMap(float(arrays["gain"]), float(arrays["offset"]), self.name)


def paths(problem: FitProblem) -> tuple[LevelPath, LevelPath]:
    """Return the swings of source and target, both averaged over the same number of samples.

    Raises:
        UnitRefused: one of them makes no swing.
    """
    source, target = problem.source.unlabelled, problem.target
    average = max(averaging_length(source), averaging_length(target))
    source_path, target_path = level_path(source, average), level_path(target, average)
    if target_path is None or source_path is None:
        raise UnitRefused("output makes no swing that stands out of its noise; press the unit and record again")
    return source_path, target_path


def matched(source: LevelPath, target: LevelPath, shares: Array = SHARES) -> tuple[float, float]:
    """Return gain and offset that carry the target's crossing measure onto the source's at some shares of the path."""
    source_levels, target_levels = source.quantiles(shares), target.quantiles(shares)
    gain = float(np.std(source_levels) / np.std(target_levels))
    return gain, float(source_levels.mean() - gain * target_levels.mean())


def level_weights(source: Array, mapped_target: Array, cells: int = 20) -> tuple[float, Array]:
    """Return how differently the two units spend their time, and the weights that make up for it.

    Args:
        source: (n, taps) windows of the source.
        mapped_target: (m, taps) windows of the target after its map.
        cells: levels; each counts twice, once rising and once falling.

    Returns:
        Total variation distance between the shares of time per level and direction (0 ... 1), and (n,) weights of the
        source windows, mean 1.
    """
    edges = np.quantile(source[:, -1], np.linspace(0, 1, cells + 1)[1:-1])
    source_cell, target_cell = _cells(source, edges), _cells(mapped_target, edges)
    source_share = np.bincount(source_cell, minlength=2 * cells) / len(source)
    target_share = np.bincount(target_cell, minlength=2 * cells) / len(mapped_target)
    ratio = target_share / np.maximum(source_share, 1.0 / len(source))
    weights = ratio[source_cell]
    return float(np.abs(source_share - target_share).sum() / 2), weights / max(float(weights.mean()), 1e-12)


def _cells(windows: Array, edges: Array) -> NDArray[np.int64]:
    rising = windows[:, -5:].mean(axis=1) > windows[:, :5].mean(axis=1)
    return np.asarray(2 * np.searchsorted(edges, windows[:, -1]) + rising, dtype=np.int64)
