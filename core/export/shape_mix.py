"""Linear part of a map: a window keeps a share of itself, plus a combination of smooth shapes.

y = keep x + Σ_k U_k (r_k · x + b_k), U_k the Chebyshev polynomials of the second kind over the
taps. A lag, creep, or the smoothing of a coarse converter moves a window along smooth shapes; five
of them take the place of a matrix of 225 numbers.
"""

from dataclasses import dataclass

import numpy as np

from softcal.core.export.integer_network import ACTIVATION_MAX, KEEP_ONE, SHAPE_CENTRE, SHAPE_HALF, IntegerMix, Integers
from softcal.core.network.network import Network
from softcal.core.recording import Array
from softcal.core.windows import TAPS

MAX_WINDOWS = 3000
STEPS = 5
WINDOW_WEIGHT = 1e-3
"""The window itself counts this much: it settles what f does not see of it."""

RIDGE = 1e-7
MAX_SHIFT = 24
MAX_ROW_SUM = 65_000
"""Of the weights of a row: times 32767 they stay within 32 bits, with room for rounding."""


def shapes(count: int) -> Array:
    """Return U_0 ... U_(count - 1) at (tap - 7) / 8: (TAPS, count)."""
    position = (np.arange(TAPS) - SHAPE_CENTRE) / SHAPE_HALF
    columns = [np.ones(TAPS), 2 * position]
    for _ in range(count - 2):
        columns.append(2 * position * columns[-1] - columns[-2])
    return np.stack(columns[:count], axis=1)


@dataclass(frozen=True, eq=False)
class Mix:
    """A mix with the weights of the device; only its biases are real numbers.

    Args:
        keep: share of the window that stays, in 1/64.
        weights: (k, TAPS) in ± 32767.
        shift: (k,) row k of the weights counts in 2^-shift / 64.
        bias: (k,) in the output unit.
    """

    keep: int
    weights: Integers
    shift: Integers
    bias: Array

    @property
    def rows(self) -> Array:
        """(k, TAPS) weights as real numbers."""
        return np.asarray(self.weights / (KEEP_ONE * 2.0 ** self.shift[:, None]))

    @property
    def matrix(self) -> Array:
        """(TAPS, TAPS)"""
        return np.asarray(self.keep / KEEP_ONE * np.eye(TAPS) + shapes(len(self.bias)) @ self.rows)

    @property
    def offset(self) -> Array:
        """(TAPS,) in the output unit."""
        return np.asarray(shapes(len(self.bias)) @ self.bias)

    def apply(self, windows: Array) -> Array:
        return windows @ self.matrix.T + self.offset

    def in_counts(self, zero: float, lsb: float) -> IntegerMix:
        """Return the device's mix where a sample is zero + lsb * count before and after.

        Raises:
            ValueError: a bias leaves 16 bits, or some window could overflow 32 bits.
        """
        bias = (self.bias + zero * self.rows.sum(axis=1)) / lsb
        bias[0] += (self.keep / KEEP_ONE - 1) * zero / lsb
        return IntegerMix(self.keep, self.weights, self.shift, np.rint(KEEP_ONE * bias).astype(np.int64))


def fit_mix(count: int, windows: Array, mapped: Array, network: Network) -> Mix | None:
    """Fit a mix of `count` shapes so that f answers to the result as to `mapped`.

    Minimises Σ (f(y) - f(mapped))² + a small share of |y - mapped|² by Gauss-Newton steps, each of
    which ends on the device's integers.

    Args:
        windows: (n, TAPS) windows entering.
        mapped: (n, TAPS) target windows.

    Returns:
        None where the weights are too large for their bytes.
    """
    rows = np.linspace(0, len(windows) - 1, min(MAX_WINDOWS, len(windows))).astype(np.int64)
    windows, mapped = windows[rows], mapped[rows]
    exact = network.evaluate(mapped)
    best, min_error, fitted = None, np.inf, mapped
    for _ in range(STEPS):
        mix = _Normal(count, windows, mapped, network, fitted).solve()
        if mix is None:
            break
        fitted = mix.apply(windows)
        error = float(np.mean((network.evaluate(fitted) - exact) ** 2))
        if error < min_error:
            best, min_error = mix, error
    return best


class _Normal:
    """Normal equations of a mix: (TAPS + 1, k) weights of taps and a constant, then keep."""

    def __init__(self, count: int, windows: Array, mapped: Array, network: Network, fitted: Array) -> None:
        """Linearise f at `fitted`, the windows of the step before."""
        self._count, self._centre, self._spread = count, float(windows.mean()), float(windows.std())
        moved = (windows - self._centre) / self._spread
        target_windows = (mapped - self._centre) / self._spread
        estimate, slope = network.gradient(fitted)
        # Estimates in units of the window: both parts of the sum then count in the same measure.
        scale = float(np.sqrt(np.mean(slope**2)))
        slope = slope / scale
        missing = (network.evaluate(mapped) - estimate) / (scale * self._spread)
        basis = shapes(count)
        taps = np.hstack([moved, np.ones((len(moved), 1))])
        design = np.einsum("nt,nk->ntk", taps, slope @ basis).reshape(len(moved), -1)
        design = np.hstack([design, np.sum(slope * moved, axis=1)[:, None]])
        target = missing + np.sum(slope * (fitted - self._centre), axis=1) / self._spread
        cross = (taps.T @ moved @ basis).reshape(-1)
        window_terms = np.block([
            [np.kron(taps.T @ taps, basis.T @ basis), cross[:, None]],
            [cross[None, :], np.array([[np.sum(moved**2)]])],
        ])  # fmt: skip
        right = np.append((taps.T @ target_windows @ basis).reshape(-1), np.sum(moved * target_windows))
        self._matrix = design.T @ design + WINDOW_WEIGHT * window_terms
        self._matrix += RIDGE * float(np.trace(self._matrix)) / len(right) * np.eye(len(right))
        self._right = design.T @ target + WINDOW_WEIGHT * right

    def solve(self) -> Mix | None:
        """Return the best mix on the device's integers; None where a weight is too large."""
        # The share that stays is fixed first: every other unknown is linear beside it.
        keep = int(np.clip(round(KEEP_ONE * float(np.linalg.solve(self._matrix, self._right)[-1])), 0, 255))
        weights = self.weights(keep / KEEP_ONE)
        filled = np.maximum(np.abs(weights).max(axis=1) / ACTIVATION_MAX, np.abs(weights).sum(axis=1) / MAX_ROW_SUM)
        if not np.all(np.isfinite(filled)) or filled.max() > 1 / KEEP_ONE:
            return None
        # The largest shift at which a row still fits its bytes is the finest step it can have.
        headroom_bits = np.log2(1 / KEEP_ONE / np.maximum(filled, 2.0**-MAX_SHIFT / ACTIVATION_MAX))
        shift = np.clip(np.floor(headroom_bits), 0, MAX_SHIFT).astype(np.int64)
        step = 1 / (KEEP_ONE * 2.0**shift)
        integers = np.rint(weights / step[:, None]).astype(np.int64)
        return Mix(keep, integers, shift, self.bias(keep / KEEP_ONE, integers * step[:, None]))

    def weights(self, keep: float) -> Array:
        """Return the least-squares weights (k, TAPS) for a given share."""
        right = self._right[:-1] - self._matrix[:-1, -1] * keep
        return np.asarray(np.linalg.solve(self._matrix[:-1, :-1], right).reshape(TAPS + 1, -1)[:-1].T)

    def bias(self, keep: float, weights: Array) -> Array:
        """Return the best biases (k,) for given weights, in the output unit."""
        split = TAPS * self._count
        right = self._right[split:-1] - self._matrix[split:-1, -1] * keep
        right -= self._matrix[split:-1, :split] @ weights.T.reshape(-1)
        constant = np.linalg.solve(self._matrix[split:-1, split:-1], right)
        level = keep * self._centre * np.eye(self._count)[0]
        return np.asarray(constant * self._spread + self._centre * np.eye(self._count)[0] - level
                          - self._centre * weights.sum(axis=1))  # fmt: skip
