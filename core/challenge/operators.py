"""Memory operators on a fine, even time grid, independent of the twin's."""

from collections.abc import Callable, Sequence
from typing import TypeVar, cast

import numpy as np
from numba import njit
from scipy.signal import lfilter

from softcal.core.recording import Array

Function = TypeVar("Function", bound=Callable[..., Array])


def recursion(function: Function) -> Function:
    """Compile a function that processes a signal sample by sample."""
    return cast(Function, njit(cache=True)(function))


def low_pass(signal: Array, step_s: float, tau_s: float, start: float = 0.0) -> Array:
    """Solve τ·dy/dt = x − y exactly for an input that is a straight line between grid points.

    Args:
        signal: (n,) x on the grid.
        start: y at the first point.
    """
    ratio = step_s / tau_s
    decay = float(np.exp(-ratio))
    gain = 1.0 - (1.0 - decay) / ratio
    out, _ = lfilter([gain, 1.0 - decay - gain], [1.0, -decay], signal, zi=[start - gain * signal[0]])
    return np.asarray(out)


def low_passes(signal: Array, step_s: float, weights: Sequence[float], taus_s: Sequence[float]) -> Array:
    """Add several low-passes of one input, each with its weight."""
    parts = [w * low_pass(signal, step_s, tau_s) for w, tau_s in zip(weights, taus_s, strict=True)]
    return np.asarray(np.sum(parts, axis=0))


def power_law(signal: Array, step_s: float, fastest_s: float, slowest_s: float) -> Array:
    """Approximate a memory that grows with log t: two branches per octave of time."""
    taus_s = np.geomspace(fastest_s, slowest_s, 2 * max(1, round(np.log2(slowest_s / fastest_s))) + 1)
    weights = np.full(len(taus_s), 1.0 / len(taus_s))
    return low_passes(signal, step_s, weights.tolist(), taus_s.tolist())


@recursion
def play(signal: Array, width: float) -> Array:  # pragma: no cover - compiled
    """Return the output of a clearance (play operator): it lags while rising and follows while falling."""
    out = np.empty_like(signal)
    state = signal[0]
    for k in range(len(signal)):
        if signal[k] - width > state:
            state = signal[k] - width
        elif signal[k] < state:
            state = signal[k]
        out[k] = state
    return out


@recursion
def loop(signal: Array, scale: float) -> Array:  # pragma: no cover - compiled
    """Solve dz/dt = (dx/dt)/scale · (1 − z·sign(dx/dt)) exactly on monotone pieces, from z = 0."""
    out = np.empty_like(signal)
    state = 0.0
    out[0] = state
    for k in range(1, len(signal)):
        step = signal[k] - signal[k - 1]
        target = 1.0 if step > 0.0 else -1.0
        if step != 0.0:
            state = target + (state - target) * np.exp(-abs(step) / scale)
        out[k] = state
    return out


@recursion
def _stop(signal: Array, limit: float) -> Array:  # pragma: no cover - compiled
    out = np.empty_like(signal)
    state = 0.0
    out[0] = state
    for k in range(1, len(signal)):
        state = min(limit, max(-limit, state + signal[k] - signal[k - 1]))
        out[k] = state
    return out


def prandtl_ishlinskii(signal: Array, scale: float) -> Array:
    """Mean of five stop operators with limits around `scale`, each over its limit."""
    limits = (scale * np.array([0.25, 0.5, 1.0, 2.0, 3.5])).tolist()
    return np.asarray(np.mean([_stop(signal, limit) / limit for limit in limits], axis=0))


@recursion
def bouc_wen(signal: Array, scale: float) -> Array:  # pragma: no cover - compiled
    """Solve Bouc and Wen's dz = dx/s − |z|ⁿ·(β·|dx|·sign z + γ·dx)/s; β = 0.7, γ = 0.3, n = 1.6."""
    out = np.empty_like(signal)
    state = 0.0
    out[0] = state
    for k in range(1, len(signal)):
        step = signal[k] - signal[k - 1]
        pieces = 1 + int(abs(step) / (0.02 * scale))
        for _ in range(pieces):
            part = step / pieces / scale
            state += part - abs(state) ** 1.6 * (0.7 * abs(part) * np.sign(state) + 0.3 * part)
        out[k] = state
    return out
