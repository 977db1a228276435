"""An affine map from rest and peak: blind to how long and how fast each unit was pressed."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.crossing import KEPT
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import Array, OutputRecording


@dataclass(frozen=True)
class LabelShift:
    """Match rest and peak of the two outputs by a gain and an offset.

    What units pressed between the same rest and peaks share, however the time between is spent, are these two levels.
    The peak is read off the crossing measure, N(x) the number of times the output crosses level x, which does not
    change when presses are held longer or made faster.
    """

    name: str = "label_shift"

    def fit(self, problem: FitProblem) -> AffineMap:
        """Fit gain and offset.

        Raises:
            UnitRefused: the output makes no swing that stands out of its noise.
        """
        return AffineMap(problem.ends.gain, problem.ends.offset, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> AffineMap:
        return AffineMap(float(arrays["gain"]), float(arrays["offset"]), self.name)


def dwell_distance(source: OutputRecording, mapped_target: Array, cells: int) -> float:
    """Return how differently two units spend their time: 0 alike, 1 never at one level in one direction.

    Args:
        source: recording of the source, which every unit of a lot is compared with.
        mapped_target: (m, taps) windows of the target after its map.
        cells: levels; each counts twice, once rising and once falling.

    Returns:
        Total variation distance between the shares of time per level and direction.
    """
    edges, source_share = _use(source, cells)
    return float(np.abs(source_share - _shares(mapped_target, edges)).sum() / 2)


@lru_cache(maxsize=KEPT)
def _use(source: OutputRecording, cells: int) -> tuple[Array, Array]:
    """Return the inner edges of the levels, and the share of time in each cell."""
    # Equal shares of the source per cell: each difference from them is then known equally well.
    edges = np.quantile(source.windows[:, -1], np.linspace(0, 1, cells + 1)[1:-1])
    return edges, _shares(source.windows, edges)


def _shares(windows: Array, edges: Array) -> Array:
    cell = _cells(windows, edges)
    return np.asarray(np.bincount(cell, minlength=2 * (len(edges) + 1)) / len(cell))


def _cells(windows: Array, edges: Array) -> NDArray[np.int64]:
    # Loading and unloading pass a level at different loads (hysteresis): they are counted apart.
    rising = windows[:, -5:].mean(axis=1) > windows[:, :5].mean(axis=1)
    return np.asarray(2 * np.searchsorted(edges, windows[:, -1]) + rising, dtype=np.int64)
