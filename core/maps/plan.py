"""A discrete transport plan between windows, and the map it gives to windows it has not seen."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.config import PlanConfig
from softcal.core.recording import Array
from softcal.core.windows import windows

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


@dataclass(frozen=True, eq=False)
class TransportMap:
    """Stored target windows and how far the plan moved each; unseen windows move with their neighbours.

    map(x) = x + sum_k w_k (T(x_k) - x_k) over the nearest stored windows x_k, w_k proportional to the inverse squared
    distance. The paper's nearest neighbour alone would repeat a stored window; its displacement carries what is new.

    Args:
        stored: (m, taps) target windows of the plan.
        displacement: (m, taps) T(x_k) - x_k.
        family: name under which the catalogue rebuilds it.
    """

    stored: Array
    displacement: Array
    family: str
    neighbours: int = PlanConfig.neighbours

    @cached_property
    def _tree(self) -> "cKDTree":
        # Imported here: whoever applies another map does not wait for scipy.
        from scipy.spatial import cKDTree

        return cKDTree(self.stored)

    def apply(self, windows: Array) -> Array:
        distance, row = self._tree.query(windows, k=min(self.neighbours, len(self.stored)))
        distance, row = distance.reshape(len(windows), -1), row.reshape(len(windows), -1)
        # The small term keeps a stored window, at distance 0, finite: it then outweighs all others.
        closeness = 1.0 / (distance**2 + 1e-12 * (1.0 + float(np.ptp(self.stored)) ** 2))
        share = closeness / closeness.sum(axis=1, keepdims=True)
        return np.asarray(windows + np.einsum("nk,nkt->nt", share, self.displacement[row]))

    def apply_signal(self, signal: Array) -> Array:
        return self.apply(windows(signal))

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        return {"stored": self.stored, "displacement": self.displacement}

    def settings(self) -> Settings:
        """Return how many neighbours an unseen window moves with."""
        return {"neighbours": self.neighbours}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]], settings: Settings, family: str) -> "TransportMap":
        neighbours = int(str(settings.get("neighbours", PlanConfig.neighbours)))
        stored, displacement = (np.asarray(arrays[name], np.float64) for name in ("stored", "displacement"))
        return cls(stored, displacement, family, neighbours)


def solve_exact(cost: Array) -> Array:
    """Return the plan of least total cost between uniform weights (Kantorovich; POT's network simplex).

    Args:
        cost: (m, n) cost of carrying target window i to source window j.
    """
    # POT brings torch and scikit-learn along, seconds and 250 MB: only who solves a plan pays.
    import ot

    rows, columns = cost.shape
    return np.asarray(ot.emd(np.full(rows, 1 / rows), np.full(columns, 1 / columns), cost, numItermax=2_000_000))


def squared_distances(a: Array, b: Array) -> Array:
    """Return (m, n) squared Euclidean distances between (m, k) and (n, k) rows."""
    import ot

    return np.asarray(ot.dist(a, b))


def barycentric(plan: Array, source: Array) -> Array:
    """Return where the plan sends each target window on average: (m, taps)."""
    return np.asarray(plan @ source / plan.sum(axis=1, keepdims=True))


def spread_rows(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` row numbers spread evenly over `count`."""
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64)
