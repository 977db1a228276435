"""Parameters in a fit: the coordinates it moves them in, and bounds that grow with the rig.

Pads of 0.2 N and of 200 N, outputs in V or mV, strokes of 0.3 or 30 mm give the same diagnosis.
Time is not scaled: creep, mains and clocks have their own.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter

if TYPE_CHECKING:
    from softcal.core.gap.case import Case

LARGEST_LOG = float(np.log(np.finfo(np.float64).max))


def to_fit(parameter: Parameter, value: float) -> float:
    """Return the coordinate in which the fit moves this parameter."""
    if parameter.scale == "log":
        return float(np.log(value))
    return 0.0 if np.isinf(value) else (1.0 / value**2 if parameter.scale == "inverse_square" else value)


def from_fit(parameter: Parameter, coordinate: float) -> float:
    """Return the physical value at this coordinate of the fit."""
    if parameter.scale == "log":
        return float(np.exp(min(coordinate, LARGEST_LOG)))
    if parameter.scale == "inverse_square":
        return float(coordinate**-0.5) if coordinate > 0 else float("inf")
    return coordinate


def fit_scale(parameter: Parameter) -> float:
    """Return a natural step of this parameter in the coordinates of the fit."""
    if parameter.scale == "log":
        return 1.0
    # What is usually 0 tells no size; narrow bounds do.
    return abs(to_fit(parameter, parameter.usual)) or min(1.0, 0.1 * (parameter.high - parameter.low))


def start_coordinates(effects: Sequence[Effect], values: Sequence[Sequence[float]]) -> Array:
    """Return the coordinates of effect values, to be put after those of a base."""
    return np.array(
        [
            to_fit(p, v)
            for effect, row in zip(effects, values, strict=True)
            for p, v in zip(effect.parameters, row, strict=True)
        ]
    )


COMMON = {"N": 8.0, "mm": 3.0, "ohm": 10.0, "V": 4.0}
"""Force, stroke, series resistor and supply of the rig of the catalogue's bounds."""

FACTOR = re.compile(r"(N|mm|ohm|V|s|K|Hz|rad|1)([²³]?)")
POWERS = {"": 1, "²": 2, "³": 3}


@dataclass(frozen=True)
class RigScale:
    """How large a rig is against the common one, by unit; other units are not scaled."""

    sizes: tuple[tuple[str, float], ...] = ()

    @classmethod
    def of(cls, case: "Case") -> "RigScale":
        """Read force and stroke off the runs that are pressed, the others off the metadata."""
        spans = {}
        for unit, channel in (("mm", "stage_mm"), ("N", "force_N")):
            reach = max((float(np.ptp(v)) for v in case.recorded(channel)), default=0.0)
            spans[unit] = reach / COMMON[unit] or None
        # Without a cell, or without a stage, the pad is as stiff as the common one.
        known = [size for size in spans.values() if size]
        common = known[0] if known else 1.0
        readout = case.readout
        sizes = {unit: size or common for unit, size in spans.items()}
        sizes |= {"ohm": readout.r_series_ohm / COMMON["ohm"], "V": readout.vref_V / COMMON["V"]}
        return cls(tuple(sizes.items()))

    def factor(self, unit: str) -> float:
        """Return by what a quantity of this unit, as `N/mm³`, is larger than on the common rig."""
        sizes, (over, _, under) = dict(self.sizes), unit.partition("/")
        matches = [FACTOR.fullmatch(part.strip()) for part in (over, under)]
        times, per = (sizes.get(one[1], 1.0) ** POWERS[one[2]] if one else 1.0 for one in matches)
        return times / per

    def sized(self, parameter: Parameter) -> Parameter:
        """Return a parameter with the bounds and the usual size that it has on this rig."""
        return _sized(self, parameter)


@lru_cache(maxsize=4096)
def _sized(scale: RigScale, parameter: Parameter) -> Parameter:
    factor = scale.factor(parameter.unit)
    return replace(parameter, low=factor * parameter.low, high=factor * parameter.high, usual=factor * parameter.usual)
