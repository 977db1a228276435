"""Affine maps: one gain and one offset for every sample of a unit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import FitProblem
from softcal.core.words.reason import reason


@dataclass(frozen=True)
class Affine:
    """Match two robust extremes of the outputs: the level at rest and the level of the hardest presses."""

    name: str = "affine"

    def fit(self, problem: FitProblem) -> AffineMap:
        """Fit gain and offset.

        Raises:
            UnitRefused: the target's output does not move between its extremes.
        """
        extremes = problem.config.choice.extremes
        low, high = np.quantile(problem.target.output, extremes)
        source_low, source_high = np.quantile(problem.source.unlabelled.output, extremes)
        if high <= low:
            raise UnitRefused(reason("still", level=float(low), unit=problem.target.output_unit))
        gain = float((source_high - source_low) / (high - low))
        return AffineMap(gain, float(source_low - gain * low))

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> AffineMap:
        return AffineMap(float(arrays["gain"]), float(arrays["offset"]))


@dataclass(frozen=True)
class IdentityFamily:
    """Do nothing: the candidate every other map has to beat."""

    name: str = "identity"

    def fit(self, problem: FitProblem) -> AffineMap:
        return AffineMap(1.0, 0.0, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> AffineMap:
        return AffineMap(1.0, 0.0, self.name)
