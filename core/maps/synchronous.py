"""Pairs at equal time: source and target were pressed by the same load at once."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.paired import PairedMap, fit_pairs, paired_map_from_arrays
from softcal.core.maps.synchrony import paired_rows
from softcal.core.words.reason import reason


@dataclass(frozen=True)
class Synchronous:
    """Pair windows taken at the same time and regress the source's on the target's."""

    name: str = "synchronous"

    def fit(self, problem: FitProblem) -> PairedMap:
        """Fit the map.

        Raises:
            UnitRefused: the outputs show no common load at equal time.
        """
        synchrony = problem.synchrony
        if not synchrony.is_synchronous:
            raise UnitRefused(reason("not_synchronous", correlation=synchrony.rank_correlation))
        source_rows, target_rows = paired_rows(
            problem.source.unlabelled, problem.target, synchrony, problem.config.synchrony
        )
        least = problem.config.synchrony.min_pairs
        if len(target_rows) < least:
            raise UnitRefused(reason("few.times", windows=len(target_rows), enough=least))
        return fit_pairs(problem, source_rows, target_rows, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> PairedMap:
        return paired_map_from_arrays(arrays, self.name)
