"""Small products over long vectors, compiled: a few rows are too thin for a threaded BLAS."""

import numpy as np
from numpy.typing import NDArray

from softcal.core.recording import Array
from softcal.core.twin.signals import compiled


@compiled
def gram(rows: Array) -> Array:
    """Return rows·rowsᵀ, (k, k), of (k, n) rows."""
    k = rows.shape[0]
    out = np.empty((k, k))
    for i in range(k):
        for j in range(i, k):
            # Half of the products: the matrix is symmetric.
            out[i, j] = out[j, i] = _dot(rows[i], rows[j])
    return out


@compiled
def dots(rows: Array, vector: Array) -> Array:
    """Return rows·vector, (k,), of (k, n) rows."""
    out = np.empty(rows.shape[0])
    for i in range(rows.shape[0]):
        out[i] = _dot(rows[i], vector)
    return out


@compiled
def _dot(one: Array, other: Array) -> float:
    # Four partial sums: a single one would wait for itself at every step.
    a = b = c = d = 0.0
    whole = len(one) // 4 * 4
    for k in range(0, whole, 4):
        a += one[k] * other[k]
        b += one[k + 1] * other[k + 1]
        c += one[k + 2] * other[k + 2]
        d += one[k + 3] * other[k + 3]
    for k in range(whole, len(one)):
        a += one[k] * other[k]
    return a + b + c + d


@compiled
def combine(coefficients: Array, rows: Array) -> Array:
    """Return Σ cᵢ·rowᵢ, (n,), of (k, n) rows."""
    out = np.zeros(rows.shape[1])
    for i in range(rows.shape[0]):
        weight = coefficients[i]
        for k in range(rows.shape[1]):
            out[k] += weight * rows[i, k]
    return out


@compiled
def wave_sums(grid_Hz: Array, t_s: Array, values: Array) -> NDArray[np.complex128]:
    """Return Σ vₖ·exp(−2πi·f·tₖ), (m,), of (n,) values at (n,) times, for (m,) frequencies."""
    out = np.empty(len(grid_Hz), dtype=np.complex128)
    for i in range(len(grid_Hz)):
        turn = 2.0 * np.pi * grid_Hz[i]
        real = imaginary = 0.0
        for k in range(len(t_s)):
            real += values[k] * np.cos(turn * t_s[k])
            imaginary -= values[k] * np.sin(turn * t_s[k])
        out[i] = complex(real, imaginary)
    return out


def energy(vector: Array) -> float:
    """Return the sum of squares."""
    return float(dots(vector.reshape(1, -1), vector)[0])
