"""An affine map from rest and peak: blind to how long and how fast each unit was pressed."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.ends import match_ends
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import Array


@dataclass(frozen=True)
class LabelShift:
    """Match rest and peak of the two outputs by a gain and an offset.

    What units pressed between the same rest and peaks share, however the time between is spent, are these two levels.
    The peak is read off the crossing measure, N(x) the number of times the output crosses level x, which does not
    change when presses are held longer or made faster. The weight of each source sample follows afterwards as the ratio
    of the time spent (`level_weights`).
    """

    name: str = "label_shift"

    def fit(self, problem: FitProblem) -> AffineMap:
        """Fit gain and offset.

        Raises:
            UnitRefused: the output makes no swing that stands out of its noise.
        """
        match = match_ends(problem.source, problem.target, problem.config)
        return AffineMap(match.gain, match.offset, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> AffineMap:
        """Rebuild a map from its arrays."""
        return AffineMap(float(arrays["gain"]), float(arrays["offset"]), self.name)


def level_weights(source: Array, mapped_target: Array, cells: int) -> tuple[float, Array]:
    """Return how differently the two units spend their time, and the weights that make up for it.

    Args:
        source: (n, taps) windows of the source.
        mapped_target: (m, taps) windows of the target after its map.
        cells: levels; each counts twice, once rising and once falling.

    Returns:
        Total variation distance between the shares of time per level and direction (0 ... 1), and (n,) weights of the
        source windows, mean 1.
    """
    # Equal shares of the source per cell: each ratio below is then known equally well.
    edges = np.quantile(source[:, -1], np.linspace(0, 1, cells + 1)[1:-1])
    source_cell, target_cell = _cells(source, edges), _cells(mapped_target, edges)
    source_share = np.bincount(source_cell, minlength=2 * cells) / len(source)
    target_share = np.bincount(target_cell, minlength=2 * cells) / len(mapped_target)
    # A cell the source never visited counts as one sample, or a single stray would weigh without bound.
    ratio = target_share / np.maximum(source_share, 1.0 / len(source))
    weights = ratio[source_cell]
    return float(np.abs(source_share - target_share).sum() / 2), weights / max(float(weights.mean()), 1e-12)


def _cells(windows: Array, edges: Array) -> NDArray[np.int64]:
    # Loading and unloading pass a level at different loads (hysteresis): they are counted apart.
    rising = windows[:, -5:].mean(axis=1) > windows[:, :5].mean(axis=1)
    return np.asarray(2 * np.searchsorted(edges, windows[:, -1]) + rising, dtype=np.int64)
