"""Alternative equations of a cause, which a rig may have instead of the catalogue's equation.

A cause is named by its place and character, not by its formula: several relaxation times instead of
one, stop operators instead of a Duhem loop, a power law instead of a logarithm. Each form carries
the identifier of its cause, so that a diagnosis can name the cause and describe what the
catalogue's equation leaves.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Form, Memory, Parameter, Quantity, Step, memory
from softcal.core.twin.signals import direction_state, low_pass, play

STOPS = (0.03, 0.1, 0.25, 0.6)
"""Strokes of the stop operators of a Prandtl–Ishlinskii loop, as shares of the largest input."""

SPLIT_FACTOR = 4.0
"""Two time constants or loop widths begin this factor above and below the one that was fitted."""

POWER = Parameter("power", "", 0.15, 3.0, 0.3)
SETTLING = Parameter("tau", "s", 3.0, 1000.0, 30.0, scale="log")

Maker: TypeAlias = Callable[[Effect], Form]
"""Makes a form of an effect from the effect's own parameters."""


def custom_form(
    step: Step,
    equation: str,
    parameters: Sequence[Parameter],
    carry: Sequence[tuple[int | None, float]],
    constants: Sequence[str] = (),
) -> Maker:
    """Return a function that creates a form with its own parameters.

    Args:
        carry: where its fit begins, see `Form`.
        constants: what it reads off the recording it is fitted to, see `Effect`.
    """

    def make(effect: Effect) -> Form:
        constant_values = tuple((name, np.nan) for name in constants)
        form = replace(
            effect, step=step, parameters=tuple(parameters), equation=equation, forms=(), constants=constant_values
        )
        return Form(form, tuple(carry))

    return make


def doubled_form(equation: str) -> Maker:
    """Return a maker of a form that is the effect twice, with two sizes and two shapes."""

    def make(effect: Effect) -> Form:
        size, shape = effect.parameters
        second = (replace(size, name=f"{size.name}2"), replace(shape, name=f"{shape.name}2"))
        # One faster and one slower: both alike would be a saddle that descent never leaves.
        carry = ((0, 0.5), (1, 1 / SPLIT_FACTOR), (0, 0.5), (1, SPLIT_FACTOR))
        return custom_form(effect.step, equation, (size, shape, *second), carry)(effect)

    return make


def extended_form(step: Step, equation: str, *extra: tuple[Parameter, float], constants: Sequence[str] = ()) -> Maker:
    """Return a function that creates a form with further parameters, each with its starting value."""

    def make(effect: Effect) -> Form:
        base_carry: list[tuple[int | None, float]] = [(k, 1.0) for k in range(len(effect.parameters))]
        carry = [*base_carry, *((None, value) for _, value in extra)]
        return custom_form(step, equation, (*effect.parameters, *(p for p, _ in extra)), carry, constants)(effect)

    return make


def stop_form(step: Step, equation: str, *constants: str) -> Maker:
    """Return a maker of a form of stop operators, one weight for each of `STOPS`.

    Args:
        constants: the largest value of their input, and what else the step reads off.
    """
    weights = [Parameter(f"w{k}", "", -0.5, 1.0, 0.05, neutral=0.0) for k in range(len(STOPS))]
    return custom_form(step, equation, weights, [(0, 0.5)] * len(STOPS), constants)


def constant(values: Sequence[float], state: Memory, at: int, name: str, read: Callable[[], float]) -> float:
    """Return the constant after the parameters of a form, or estimate it from the recording once.

    Args:
        at: its place among the values; a fit gives none.
    """
    if len(values) > at:
        return float(values[at])
    return float(memory(state, name, read())[0])


def pairs(values: Sequence[float]) -> Iterator[tuple[float, float]]:
    """Return size and shape parameters of each part of an effect, or of a form with two parts."""
    return zip(values[::2], values[1::2], strict=True)


def low_passes(signal: Array, step_s: Array, values: Sequence[float], state: Memory) -> Array:
    """Return Σ wᵢ·LP_τᵢ[x], all from rest at 0; values are (w₁, τ₁, ...)."""
    return np.asarray(
        sum(
            size * low_pass(signal, step_s, tau_s, memory(state, f"low_pass{k}", 0.0, 0.0))
            for k, (size, tau_s) in enumerate(pairs(values))
        )
    )


def loops(signal: Array, values: Sequence[float], state: Memory) -> Array:
    """Return 1 + Σ aᵢ·zᵢ of loops of rate-independent hysteresis; values are (a₁, width₁, ...)."""
    parts = (
        size * direction_state(signal, width, memory(state, f"loop{k}", 0.0, signal[0]))
        for k, (size, width) in enumerate(pairs(values))
    )
    return np.asarray(sum(parts, 1.0))


def stops(signal: Array, values: Sequence[float], state: Memory, name: str) -> Array:
    """Return Σ wᵢ·(x − play_rᵢ(x)): stop operators of several strokes (Brokate, Sprekels 1996).

    Args:
        values: a weight for each of `STOPS`, then the largest value of x, of which the strokes are
            shares; that of this run where it is not given.
    """
    out = np.zeros_like(signal)
    largest = constant(values, state, len(STOPS), name, lambda: float(np.max(np.abs(signal))) or 1.0)
    for k, share in enumerate(STOPS):
        width = share * largest
        out += values[k] * (signal - play(signal, width, memory(state, f"stop{k}", signal[0] - width)))
    return out


def drift_forms(step: Callable[[Quantity], Step]) -> tuple[Maker, Maker]:
    """Return the forms of a drift that slows down: a power of time, or a saturation after a few τ.

    Args:
        step: makes a step from a time that is equal to t after 30 s, or runs like t at first.
    """
    return (
        extended_form(step(lambda flow, v, state: 30.0 * (flow.t_s / 30.0) ** v[1]), "power of time", (POWER, 0.8)),
        extended_form(step(lambda flow, v, state: -v[1] * np.expm1(-flow.t_s / v[1])), "settling", (SETTLING, 40.0)),
    )
