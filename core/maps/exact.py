"""The paper's map: exact discrete transport between windows with barycentric projection (Kim et al. 2020, eq. 3)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.plan import TransportMap, barycentric, solve_exact, spread_rows, squared_distances


@dataclass(frozen=True)
class Exact:
    """Solve for the plan of least squared distance, then move each window to the mean of what it is coupled to.

    Assumes that both units were pressed under one distribution of loads. Long recordings are thinned evenly
    (`PlanConfig.most_windows`).
    """

    name: str = "exact"

    def fit(self, problem: FitProblem) -> TransportMap:
        """Fit the map."""
        source, target = problem.source.windows, problem.target.windows
        config = problem.config.plan
        source, target = (rows[spread_rows(len(rows), config.most_windows)] for rows in (source, target))
        plan = solve_exact(squared_distances(target, source))
        return TransportMap(target, barycentric(plan, source) - target, self.name, config.neighbours)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> TransportMap:
        """Rebuild a map from its arrays."""
        return TransportMap.from_arrays(arrays, settings, self.name)
