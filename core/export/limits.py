"""What stands beside an estimate in floating point: the 90 % interval by level, the calibrated range, the clamp."""

from dataclasses import dataclass

import numpy as np

from softcal.core.export.blob import MAX_BANDS
from softcal.core.export.compile_map import InputScale
from softcal.core.export.integer_network import Integers
from softcal.core.export.quantise import code_range
from softcal.core.recording import Array


@dataclass(frozen=True, eq=False)
class Limits:
    """The limits of one unit, as its device file has them, in physical units.

    Args:
        output_low, output_high: sensor output the unit was calibrated with, in the output unit.
        estimate_low, estimate_high: the estimate is clamped to these, in reference units.
        levels: (b - 1,) estimates at which the next band begins, rising.
        minus, plus: (b,) reach of the 90 % interval below and above the estimate, by band.
    """

    output_low: float
    output_high: float
    estimate_low: float
    estimate_high: float
    levels: Array
    minus: Array
    plus: Array


def limits_of(exact: Array, lower: Array, upper: Array, output: Array, scale: InputScale) -> Limits:
    """Find the limits of a unit from its own recording.

    Args:
        exact: (m,) f∘γ at every window, in reference units.
        lower, upper: (m,) ends of its 90 % interval.
        output: (n,) the recording, in the output unit.
        scale: of the device's codes; the range is that of the codes.
    """
    code_min, code_max = code_range(scale, output)
    low, high, margin = float(exact.min()), float(exact.max()), float(np.ptp(exact)) / 4
    return Limits(
        scale.zero + scale.lsb * (code_min - 0.5),
        scale.zero + scale.lsb * (code_max + 0.5),
        low - margin,
        high + margin,
        *reach_by_band(exact, exact - lower, upper - exact),
    )


def reach_by_band(estimate: Array | Integers, below: Array, above: Array) -> tuple[Array, Array, Array]:
    """Return levels between `MAX_BANDS` bands of an estimate, and its mean reach below and above in each.

    Args:
        estimate, below, above: (m,), the reach in any unit; a band without an estimate has that of all.
    """
    levels = np.linspace(estimate.min(), estimate.max(), MAX_BANDS + 1)[1:-1]
    band = np.searchsorted(levels, estimate, side="left")
    here = [band == k if (band == k).any() else np.ones(len(estimate), dtype=bool) for k in range(MAX_BANDS)]
    minus, plus = (np.array([np.mean(reach[rows]) for rows in here]) for reach in (below, above))
    return levels, minus, plus
