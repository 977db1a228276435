"""The recursions of the twin: low-pass, play operator, rate-independent state, time shift.

Each carries its state in a small array, so a stream and a batch give the same numbers.
"""

from collections.abc import Callable
from typing import TypeVar, cast

import numba
import numpy as np

from softcal.core.recording import Array

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile with numba and keep the machine code on disk; the types stay visible."""
    return cast(Function, numba.njit(cache=True, error_model="numpy")(function))


@compiled
def low_pass(signal: Array, step_s: Array, tau_s: float, state: Array) -> Array:
    """Return the low-pass τ·dy/dt = x − y, exact for an input that is straight between samples.

    Args:
        signal: (n,) input x.
        step_s: (n,) time since the sample before, s; 0 at the start of a run.
        tau_s: time constant τ > 0.
        state: (2,) y and x at the sample before; (0, ·) starts at rest at 0. Updated in place.
    """
    out = np.empty_like(signal)
    y, x0 = state[0], state[1]
    h_before, decay, old, new = -1.0, 1.0, 0.0, 0.0
    for k in range(len(signal)):
        x1 = signal[k]
        h = step_s[k] / tau_s
        # Most recordings have one period: the exponential is computed once, not per sample.
        if h != h_before:
            decay = np.exp(-h)
            # For steps far below the time constant the quotient is 0 / 0; its limit is 1.
            mean = (1.0 - decay) / h if h > 1e-9 else 1.0
            old, new, h_before = mean - decay, 1.0 - mean, h
        y = decay * y + old * x0 + new * x1
        x0 = x1
        out[k] = y
    state[0], state[1] = y, x0
    return out


@compiled
def play(signal: Array, width: float, state: Array) -> Array:
    """Return the play operator of width b: y is constant while x stays in [y, y + b], then follows x.

    Args:
        state: (1,) y at the sample before; 0 at the start of a run, which begins retracted.
    """
    out = np.empty_like(signal)
    y = state[0]
    for k in range(len(signal)):
        # The inner maximum pushes the lower wall along, the outer minimum the upper one.
        y = min(max(y, signal[k] - width), signal[k])
        out[k] = y
    state[0] = y
    return out


@compiled
def direction_state(signal: Array, scale: float, state: Array) -> Array:
    """Return z of dz/dx = (1 − z·sign(dx))/scale: +1 after long loading, −1 after unloading.

    The step between two samples is solved exactly: z goes to ±1 by exp(−|Δx|/scale).

    Args:
        state: (2,) z and x at the sample before; (0, x(0)) at the start of a run.
    """
    out = np.empty_like(signal)
    z, x0 = state[0], state[1]
    for k in range(len(signal)):
        move = signal[k] - x0
        if move > 0.0:
            z = 1.0 - (1.0 - z) * np.exp(-move / scale)
        elif move < 0.0:
            z = -1.0 + (1.0 + z) * np.exp(move / scale)
        x0 = signal[k]
        out[k] = z
    state[0], state[1] = z, x0
    return out


@compiled
def completed_presses(deformation: Array, state: Array) -> Array:
    """Return the number of completed presses at each sample: contact and loss of contact.

    Args:
        deformation: (n,) δ in mm, 0 without contact.
        state: (2,) presses so far, and 1 while in contact. Updated in place.
    """
    out = np.empty_like(deformation)
    count, touching = state[0], state[1]
    for k in range(len(deformation)):
        if deformation[k] > 0.0:
            touching = 1.0
        elif touching > 0.0:
            count, touching = count + 1.0, 0.0
        out[k] = count
    state[0], state[1] = count, touching
    return out


def largest_so_far(signal: Array, state: Array) -> Array:
    """Return the running maximum up to each sample; state (1,) holds the maximum before and is updated."""
    largest = np.maximum(np.maximum.accumulate(signal), state[0])
    state[0] = largest[-1]
    return np.asarray(largest)


def extend_buffer(t_s: Array, values: Array, instants_s: Array, state: dict[str, Array]) -> tuple[Array, Array]:
    """Return buffered times and values at the end of this chunk; keep those that the next chunk may need.

    Args:
        t_s: (n,) instants of this chunk.
        values: (n,) the signal there.
        instants_s: (n,) instants at which it is read, ascending.
    """
    buffer_s = np.concatenate([state.get("t_s", np.empty(0)), t_s])
    buffer = np.concatenate([state.get("output_V", np.empty(0)), values])
    # The oldest instant of the next chunk moves with the clock; one sample more interpolates.
    first = max(0, int(np.searchsorted(buffer_s, min(instants_s[-1], buffer_s[-1]))) - 2)
    state["t_s"], state["output_V"] = buffer_s[first:], buffer[first:]
    return buffer_s, buffer


def read_at(t_s: Array, values: Array, instants_s: Array, state: dict[str, Array]) -> Array:
    """Return a signal at other times, linear between samples and constant beyond the last."""
    return np.interp(instants_s, *extend_buffer(t_s, values, instants_s, state))
