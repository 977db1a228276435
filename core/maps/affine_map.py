"""One gain and one offset for every sample: the form of several families, and of the identity."""

from dataclasses import dataclass

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.interface import FitProblem
from softcal.core.messages.reason import reason
from softcal.core.recording import Array, Arrays
from softcal.core.windows import windows

IDENTITY, AFFINE, TWO_POINT = "identity", "affine", "two_point"


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
    family: str = AFFINE

    def apply(self, windows: Array) -> Array:
        return self.offset + self.gain * windows

    def apply_signal(self, signal: Array) -> Array:
        return windows(self.offset + self.gain * signal)

    def arrays(self) -> Arrays:
        return {"gain": np.array(self.gain), "offset": np.array(self.offset)}

    def settings(self) -> Settings:
        return {}

    @classmethod
    def from_arrays(cls, arrays: Arrays, settings: Settings, family: str) -> "AffineMap":
        return cls(float(arrays["gain"]), float(arrays["offset"]), family)


def fit_identity(problem: FitProblem) -> AffineMap:
    """Do nothing: the candidate every other map has to beat."""
    return AffineMap(1.0, 0.0, IDENTITY)


def fit_affine(problem: FitProblem) -> AffineMap:
    """Match two robust extremes of the outputs: the level at rest and the level of the hardest presses."""
    extremes = problem.config.crossing.robust_range
    low, high = np.quantile(problem.target.output, extremes)
    source_low, source_high = np.quantile(problem.source.unlabelled.output, extremes)
    if high <= low:
        raise UnitRefused(reason("still", level=float(low), unit=problem.target.output_unit))
    gain = float((source_high - source_low) / (high - low))
    return AffineMap(gain, float(source_low - gain * low))


def fit_two_point(problem: FitProblem) -> AffineMap:
    """Match rest and peak of the two outputs, blind to how long and how fast each unit was pressed.

    What units pressed between the same rest and peaks share, however the time between is spent, are these two levels.
    The peak is read off the crossing measure, N(x) the number of times the output crosses level x, which does not
    change when presses are held longer or made faster.
    """
    return AffineMap(problem.ends.gain, problem.ends.offset, TWO_POINT)
