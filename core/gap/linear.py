"""The numerics of a fit: coordinates of parameters, bounds that grow with the rig, coloured noise.

Pads of 0.2 N and of 200 N, outputs in V or mV, strokes of 0.3 or 30 mm give the same diagnosis. Time is not scaled:
creep, mains and clocks have their own.

Noise that is not white has a part that fades beside a white one: a first-order process, correlation exp(−t/τ). A Kalman
filter turns the sum into independent values of variance 1; it is the exact likelihood, for any step of time and with
samples left out (Brockwell and Davis, Time Series: Theory and Methods, 2nd ed. 1991, ch. 12).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.signals import compiled

if TYPE_CHECKING:
    from softcal.core.gap.case import Case

DIFFERENCE = 2e-4
"""Step of a derivative, in usual sizes of a parameter: beyond corners of play and clipping."""


@dataclass(frozen=True)
class Prior:
    """What is known of a base parameter before any run: which one, its mean and SD in coordinates of the fit."""

    index: int
    mean: float
    sd: float


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
            span = max((float(np.ptp(v)) for v in case.recorded(channel)), default=0.0)
            spans[unit] = span / COMMON[unit] or None
        # Without a cell, or without a stage, the pad is as stiff as the common one.
        positive_sizes = [size for size in spans.values() if size]
        common = positive_sizes[0] if positive_sizes else 1.0
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


def gram(rows: Array) -> Array:
    """Return rows·rowsᵀ, (k, k), of (k, n) rows."""
    return np.asarray(rows @ rows.T)


def wave_sums(grid_Hz: Array, t_s: Array, values: Array) -> NDArray[np.complex128]:
    """Return Σ vₖ·exp(−2πi·f·tₖ), (m,), of (n,) values at (n,) times, for (m,) frequencies."""
    return np.array([values @ np.exp(-2j * np.pi * f * t_s) for f in grid_Hz])


def energy(vector: Array) -> float:
    """Return the sum of squares."""
    return float(vector @ vector)


def projected(rows: Sequence[Array], subspace: Array) -> Array:
    """Return (k, n) orthonormal rows that span what others, (m, n), leave of these."""
    away = orthonormal(np.asarray(subspace))
    residuals = [row - (away @ row) @ away for row in rows] if len(away) else list(rows)
    # What the fit imitates to a ten-thousandth of its energy is rounding.
    stand = [
        row
        for row, row_before in zip(residuals, rows, strict=True)
        if float(row @ row) > 1e-4 * float(row_before @ row_before) > 0.0
    ]
    return orthonormal(np.array(stand))


def orthonormal(rows: Array, min_strength: float = 1e-6) -> Array:
    """Return (k, n) orthonormal rows that span rows, but for those whose share of the strongest is least."""
    if not len(rows):
        return np.zeros((0, 0))
    size = np.sqrt(np.sum(rows**2, axis=1))
    unit = rows[size > 0.0] / size[size > 0.0][:, None]
    if not len(unit):
        return np.zeros((0, rows.shape[1]))
    strength, axes = np.linalg.eigh(unit @ unit.T)
    is_strong = strength > min_strength * strength[-1]
    return np.asarray((axes[:, is_strong] / np.sqrt(strength[is_strong])).T @ unit)


def bounded_sizes(normal: Array, slope: Array, has: Array, largest: Array, are_relative: NDArray[np.bool_]) -> Array:
    """Solve (runs, k, k) normal equations within bounds; a direction that a run lacks gets 0.

    Of those that are relative the middle run is taken off: one far off must not move the others.
    """
    strength = np.diagonal(normal, axis1=1, axis2=2)
    is_determined = strength > 0.0
    scale = np.sqrt(np.where(is_determined, strength, 1.0))
    # The ridge divides what two directions that look alike share among both.
    alike = normal / (scale[:, :, np.newaxis] * scale[:, np.newaxis]) + 1e-6 * np.eye(slope.shape[1])
    free = np.linalg.solve(alike, (slope / scale)[..., np.newaxis])[..., 0] / scale + has
    for i in np.flatnonzero(are_relative & is_determined.any(axis=0)):
        sizes = np.sort(free[is_determined[:, i], i])
        free[is_determined[:, i], i] -= 0.5 * (sizes[(len(sizes) - 1) // 2] + sizes[len(sizes) // 2])
    return np.asarray(np.clip(free, -largest, largest) - has)


COMMON_STEP_s = 0.02
"""Time between two samples of a common rig."""


@dataclass(frozen=True)
class NoiseCorrelation:
    """The part of a channel's noise that fades: its SD, and the time to a correlation of 1/e."""

    spread: float
    fading_s: float

    def slow_variance(self, step_s: float) -> float:
        """Return the variance of white noise that is as strong as this one near zero frequency."""
        decay = float(np.exp(-step_s / self.fading_s))
        return float(self.spread**2 * (1.0 + decay) / (1.0 - decay))


@dataclass(frozen=True, eq=False)
class Stretch:
    """A residual of one channel of one run, or a part: (n,) each; `is_used` is 1 where a sample counts."""

    error: Array
    step_s: Array
    is_used: Array


@dataclass(frozen=True)
class Noise:
    """White and fading noise of one channel; `gain` is log likelihood above white noise alone."""

    white: float
    correlation: NoiseCorrelation
    log_likelihood: float
    gain: float


def log_likelihood(stretches: Sequence[Stretch], white: float, correlation: NoiseCorrelation) -> float:
    """Return the log likelihood of stretches under noise that is given."""
    error, step_s, is_used = joined(stretches)
    squares, log_det = noise_terms(error, step_s, is_used, correlation.spread / white, correlation.fading_s)
    return -0.5 * (squares / white**2 + log_det + float(is_used.sum()) * 2.0 * float(np.log(white)))


def joined(stretches: Sequence[Stretch]) -> tuple[Array, Array, Array]:
    """Return errors, steps of time and uses, (n,) each, of stretches one after the other, for ever apart."""
    steps = [np.append(np.inf, s.step_s[1:]) for s in stretches]
    return (
        np.concatenate([s.error for s in stretches]),
        np.concatenate(steps),
        np.concatenate([s.is_used for s in stretches]),
    )


def noise_terms(error: Array, step_s: Array, is_used: Array, ratio: float, fading_s: float) -> tuple[float, float]:
    """Return Σ e²/S and Σ ln S of innovations; white noise has variance 1, the other `ratio`²."""
    steps = filter_of(np.ones(len(error)), is_used, step_s, ratio, fading_s)
    return energy(filtered(error, steps)), -2.0 * float(np.sum(np.log(steps[2][is_used > 0.0])))


@compiled
def filter_of(noise: Array, is_used: Array, step_s: Array, spread: float, fading_s: float) -> Array:
    """Return (3, n): what the filter keeps of its state, takes of an innovation, divides it by."""
    out = np.zeros((3, len(noise)))
    variance = spread * spread
    for k in range(len(noise)):
        decay = np.exp(-step_s[k] / fading_s) if k > 0 else 0.0
        if k > 0:
            variance = decay * decay * variance + spread * spread * (1.0 - decay * decay)
        out[0, k] = decay
        if is_used[k] > 0.0:
            total = variance + noise[k] * noise[k]
            out[1, k], out[2, k] = variance / total, 1.0 / np.sqrt(total)
            variance -= variance * variance / total
    return out


@compiled
def filtered(values: Array, steps: Array) -> Array:
    """Return (n,) innovations over their standard deviation; 0 where a sample is left out."""
    out = np.empty(len(values))
    mean = 0.0
    for k in range(len(values)):
        mean = steps[0, k] * mean
        off = values[k] - mean
        out[k] = off * steps[2, k]
        mean += steps[1, k] * off
    return out
