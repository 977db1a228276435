"""Half way between two matches that err for different reasons: rest and peak, and the quantiles of the samples."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.curve import CurveMap
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.monotone import Monotone


@dataclass(frozen=True)
class Between:
    """Average the curve of equal quantiles (`Monotone`) with the line through rest and peak (`LabelShift`).

    The line takes a unit to be bent exactly as its source. The curve takes its time to be spent exactly as the
    source's. From outputs alone a bend and a dwell look alike, so neither can be shown to be right. Their errors have
    different causes. The mean of two estimates whose errors are not alike errs less than either (Bates and Granger
    1969). The weights are equal, since nothing tells which is better.
    """

    name: str = "between"

    def fit(self, problem: FitProblem) -> CurveMap:
        """Fit both and average them.

        Raises:
            UnitRefused: the output makes no swing that stands out of its noise.
        """
        match, curve = problem.ends, Monotone().fit(problem)
        weight = problem.config.choice.curve_weight
        line = match.offset + match.gain * curve.knots
        return CurveMap(curve.knots, weight * curve.values + (1 - weight) * line, self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> CurveMap:
        return CurveMap.from_arrays(arrays, self.name)
