"""The paper's map: exact discrete transport between windows with barycentric projection (Kim et al. 2020, eq. 3)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.config import PlanConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.plan import TransportMap, barycentric, solve_exact, spread_rows, squared_distances
from softcal.core.recording import Array

NAME = "exact"


def exact_map(target: Array, source: Array, placed: Array, config: PlanConfig) -> TransportMap:
    """Couple target windows with source windows at least squared distance, and carry them to where the source stands.

    Args:
        target: (m, taps) windows.
        source: (n, taps) windows they are coupled with.
        placed: (n, taps) where these stand in the space f reads; the source windows themselves, unless they were moved.
    """
    rows = spread_rows(len(source), config.most_windows)
    target, source, placed = target[spread_rows(len(target), config.most_windows)], source[rows], placed[rows]
    plan = solve_exact(squared_distances(target, source))
    return TransportMap(target, barycentric(plan, placed) - target, NAME, config.neighbours)


@dataclass(frozen=True)
class Exact:
    """Solve for the plan of least squared distance, then move each window to the mean of what it is coupled to.

    Assumes that both units were pressed under one distribution of loads. Long recordings are thinned evenly
    (`PlanConfig.most_windows`).
    """

    name: str = NAME

    def fit(self, problem: FitProblem) -> TransportMap:
        source = problem.source.windows
        return exact_map(problem.target.windows, source, source, problem.config.plan)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> TransportMap:
        return TransportMap.from_arrays(arrays, settings, self.name)
