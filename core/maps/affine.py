"""Affine maps: one gain and one offset for every sample of a unit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.interface import FitProblem
from softcal.core.reason import reason
from softcal.core.recording import Array
from softcal.core.windows import windows


@dataclass(frozen=True)
class AffineMap:
    """source sample = offset + gain * target sample, for every tap alike.

    Args:
        gain: source output unit per target output unit.
        offset: in the source's output unit.
        family: name under which the catalogue rebuilds it.
    """

    gain: float
    offset: float
    family: str = "affine"

    def apply(self, windows: Array) -> Array:
        """Carry (n, taps) target windows into the source's window space."""
        return self.offset + self.gain * windows

    def apply_signal(self, signal: Array) -> Array:
        """Carry every full window of a gap-free signal: (n - taps + 1, taps)."""
        return windows(self.offset + self.gain * signal)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return gain and offset."""
        return {"gain": np.array(self.gain), "offset": np.array(self.offset)}

    def settings(self) -> Settings:
        """Nothing beside the arrays."""
        return {}


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
        """Rebuild a map from its arrays."""
        return AffineMap(float(arrays["gain"]), float(arrays["offset"]))


@dataclass(frozen=True)
class Identity:
    """Do nothing: the candidate every other map has to beat."""

    name: str = "identity"

    def fit(self, problem: FitProblem) -> AffineMap:
        """Return gain 1 and offset 0."""
        return AffineMap(1.0, 0.0, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> AffineMap:
        """Rebuild the identity."""
        return AffineMap(1.0, 0.0, self.name)
