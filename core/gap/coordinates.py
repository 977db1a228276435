"""In which coordinates a fit moves the parameters of a twin."""

from collections.abc import Sequence

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter

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
