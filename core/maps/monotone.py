"""Monotone transport sample by sample: equal quantiles of the two outputs (one-dimensional optimal transport)."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.config import CurveConfig
from softcal.core.maps.crossing import KEPT
from softcal.core.maps.curve import CurveMap, continued, monotone_curve
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import Array, OutputRecording
from softcal.core.words.reason import reason


@dataclass(frozen=True)
class Monotone:
    """Carry each quantile of the target's samples onto the source's: exact where both ran the same programme.

    The monotone rearrangement is the optimal transport in one dimension for every convex cost (Santambrogio 2015,
    section 2.2). Quantiles of quantised outputs are taken between the steps of the converter, so that the steps of one
    unit do not become steps of the map.
    """

    name: str = "monotone"

    def fit(self, problem: FitProblem) -> CurveMap:
        """Fit the curve.

        Raises:
            UnitRefused: the target's output does not move.
        """
        config = problem.config.curve
        target = _quantiles(problem.target, config)
        if np.ptp(target) <= 0:
            level, unit = float(target[0]), problem.target.output_unit
            raise UnitRefused(reason("still", level=level, unit=unit))
        source = _quantiles(problem.source.unlabelled, config)
        return continued(monotone_curve(target, source, self.name), float(np.ptp(source)), config)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> CurveMap:
        return CurveMap.from_arrays(arrays, self.name)


@lru_cache(maxsize=KEPT)
def _quantiles(recording: OutputRecording, config: CurveConfig) -> Array:
    """Return the quantiles of a recording's output that become knots."""
    # Chebyshev spacing: the ends, where rest and peak levels lie, are resolved best.
    spacing = (1 - np.cos(np.linspace(0, np.pi, config.knots))) / 2
    return between_steps(recording.output, config.end_share + (1 - 2 * config.end_share) * spacing)


def between_steps(samples: Array, shares: Array) -> Array:
    """Return quantiles of quantised samples, interpolated between neighbouring steps.

    Args:
        samples: (n,) outputs, often on the few levels of an analogue-to-digital converter.
        shares: (k,) in 0 ... 1.
    """
    levels, counts = np.unique(samples, return_counts=True)
    middles = (np.cumsum(counts) - counts / 2) / len(samples)
    return np.interp(shares, middles, levels)
