"""The linear algebra of a fit: projections, run offsets within bounds, coloured noise.

Noise that is not white has a part that fades beside a white one: a first-order process, correlation exp(−t/τ). A Kalman
filter turns the sum into independent values of variance 1; it is the exact likelihood, for any step of time and with
samples left out (Brockwell and Davis, Time Series: Theory and Methods, 2nd ed. 1991, ch. 12).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.recording import Array, Mask
from softcal.core.twin.signals import compiled


def gram(rows: Array) -> Array:
    """Return rows·rowsᵀ, (k, k), of (k, n) rows."""
    return np.asarray(rows @ rows.T)


def scaled_inverse(normal: Array) -> Array:
    """Return the pseudo-inverse of normal equations, (k, k), each row counted in its own size.

    Two directions that samples cannot tell apart make them singular: so scaled, that does not depend on their units.
    """
    size = np.sqrt(np.diag(normal))
    size = np.where(size > 0.0, size, 1.0)
    scale = np.outer(size, size)
    return np.asarray(np.linalg.pinv(normal / scale, rcond=1e-12, hermitian=True) / scale)


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


def bounded_sizes(normal: Array, slope: Array, has: Array, largest: Array, are_relative: Mask) -> Array:
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
    error, step_s, is_used = join_stretches(stretches)
    squares, log_det = noise_terms(error, step_s, is_used, correlation.spread / white, correlation.fading_s)
    return -0.5 * (squares / white**2 + log_det + float(is_used.sum()) * 2.0 * float(np.log(white)))


def join_stretches(stretches: Sequence[Stretch]) -> tuple[Array, Array, Array]:
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
