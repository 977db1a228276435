"""Empirical terms: a coefficient times a variable of the twin, added to a signal of the chain.

A term describes a residual that no equation of the catalogue explains. It names no cause. Every variable is
computed from the twin's state at that instant (stage position, time, its own force and depth,
temperature), never from a recording, and carries its state from chunk to chunk.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, memory
from softcal.core.twin.signals import direction_state, largest_so_far, low_pass

TermTarget = Literal["F", "force_N", "output_V"]
"""What a term is added to: the force, which every later stage feels; the reading; the output."""

TERM_TARGETS: tuple[TermTarget, ...] = get_args(TermTarget)
HOOKS: Mapping[TermTarget, Hook] = {"F": Hook.FORCE, "force_N": Hook.READING, "output_V": Hook.CLOCK}
STAGES: Mapping[TermTarget, str] = {"F": "mechanics", "force_N": "load_cell", "output_V": "electronics"}
UNITS: Mapping[TermTarget, str] = {"F": "N", "force_N": "N", "output_V": "V"}

MEMORY_s = (0.1, 0.5, 2.0, 8.0, 30.0)
"""Fading times of the memories: a few samples to a whole run, a factor of four to five apart."""

SHARP, BLUNT = 0.01, 0.1
"""Shares of the deepest press within which `direction` turns after a reversal."""

CONTACT_FADE = 0.05
"""Share of the deepest press over which `touch` fades."""


Column: TypeAlias = Callable[[Flow, Memory, "EmpiricalTerm"], Array]
"""Make a variable, (n,), from what the term says a load of 1 and a depth of 1 are."""


@dataclass(frozen=True)
class Variable:
    """One variable of the twin, a regressor of empirical terms.

    Args:
        unit: of its values, empty where it is a share of the largest.
        column: (n,) its values at the instants of a flow.
        needs: the recorded channel it cannot do without.
    """

    unit: str
    column: Column
    needs: str = ""


def _load(flow: Flow, _: Memory, term: "EmpiricalTerm") -> Array:
    return np.asarray(flow.force_N / term.load_N)


def _depth(flow: Flow, term: "EmpiricalTerm") -> Array:
    return np.asarray(flow.deformation_mm / term.depth_mm)


def _per_s(values: Array, flow: Flow, last: Array) -> Array:
    change = np.diff(values, prepend=last[0])
    last[0] = values[-1]
    return np.divide(change, flow.step_s, out=np.zeros(len(values)), where=flow.step_s > 0.0)


def _rate(flow: Flow, state: Memory, term: "EmpiricalTerm") -> Array:
    load = _load(flow, state, term)
    return _per_s(load, flow, memory(state, "load", load[0]))


def _acceleration(flow: Flow, state: Memory, term: "EmpiricalTerm") -> Array:
    depth = _depth(flow, term)
    return _per_s(_per_s(depth, flow, memory(state, "depth", depth[0])), flow, memory(state, "speed", 0.0))


def _direction(width: float) -> Column:
    def column(flow: Flow, state: Memory, term: "EmpiricalTerm") -> Array:
        depth = _depth(flow, term)
        start = memory(state, "direction", 0.0, depth[0])
        return direction_state(depth, width, start) * (depth > 0.0)

    return column


def _contact_share(flow: Flow, _: Memory, term: "EmpiricalTerm") -> Array:
    depth = _depth(flow, term)
    return np.exp(-depth / CONTACT_FADE) * (depth > 0.0)


def _deepest(flow: Flow, state: Memory, term: "EmpiricalTerm") -> Array:
    depth = _depth(flow, term)
    return largest_so_far(depth, memory(state, "deepest", 0.0)) * (depth > 0.0)


def _position(flow: Flow, _: Memory, term: "EmpiricalTerm") -> Array:
    # A stage that stands far above the pad, as at rest, is as far as one that has just left it.
    return np.maximum(flow.stage_mm, flow.contact_mm - term.depth_mm) / term.depth_mm


def _memory(tau_s: float) -> Column:
    return lambda flow, state, term: low_pass(
        _load(flow, state, term), flow.step_s, tau_s, memory(state, "remembered", 0.0, 0.0)
    )


def _product(one: Column, other: Column) -> Column:
    return lambda flow, state, term: one(flow, state, term) * other(flow, state, term)


_PLAIN = {
    "t": Variable("s", lambda flow, _, __: flow.t_s),
    "direction": Variable("", _direction(SHARP)),
    "blunt direction": Variable("", _direction(BLUNT)),
    "rate": Variable("1/s", _rate),
    "deepest": Variable("", _deepest, "stage_mm"),
    "T": Variable("K", lambda flow, _, __: flow.warmed_K, "temperature_C"),
    **{f"memory(load, {tau_s:g} s)": Variable("", _memory(tau_s)) for tau_s in MEMORY_s},
}

VARIABLES: Mapping[str, Variable] = MappingProxyType(
    _PLAIN
    | {f"load·{name}": Variable(v.unit, _product(_load, v.column), v.needs) for name, v in _PLAIN.items()}
    | {
        "load": Variable("", _load),
        "load²": Variable("", lambda flow, state, term: _load(flow, state, term) ** 2),
        "load³": Variable("", lambda flow, state, term: _load(flow, state, term) ** 3),
        "touch": Variable("", _contact_share),
        "touch·direction": Variable("", _product(_contact_share, _direction(SHARP))),
        "acceleration": Variable("1/s²", _acceleration, "stage_mm"),
        "position": Variable("", _position, "stage_mm"),
    }
)
"""What a term may follow, by name. A load and a depth of 1 are the largest recorded."""

_INVERSE = {"": "", "s": "/s", "K": "/K", "1/s": "·s", "1/s²": "·s²"}


@dataclass(frozen=True)
class EmpiricalTerm:
    """place += coefficient · variable.

    Args:
        load_N, depth_mm: load and depth that correspond to 1.

    Raises:
        InputError: unknown place or variable, a coefficient not finite, or a span not above 0.
    """

    place: TermTarget
    variable: str
    coefficient: float
    load_N: float
    depth_mm: float

    def __post_init__(self) -> None:
        if self.place not in TERM_TARGETS:
            raise InputError(f"an empirical term acts on {self.place!r}; known are {', '.join(TERM_TARGETS)}")
        if self.variable not in VARIABLES:
            raise InputError(f"an empirical term follows {self.variable!r}; known are {', '.join(VARIABLES)}")
        if not np.isfinite(self.coefficient):
            raise InputError(f"{self.place} += … {self.variable}: the coefficient is {self.coefficient}")
        if not (0.0 < self.load_N < np.inf and 0.0 < self.depth_mm < np.inf):
            raise InputError(f"{self.place} += … {self.variable}: load_N and depth_mm must be above 0")

    @property
    def unit(self) -> str:
        return UNITS[self.place] + _INVERSE[VARIABLES[self.variable].unit]

    @property
    def formula(self) -> str:
        return f"{self.place} += {self.coefficient:.3g} {self.unit} · {self.variable}"

    @cached_property
    def effect(self) -> Effect:
        """The term as a step of the chain; its coefficient is its one parameter."""
        # A hundredth of the common range: a step for derivatives, far from any bound.
        usual = 0.01 * (self.load_N if UNITS[self.place] == "N" else 1.0)
        size = Parameter("coefficient", self.unit, -1e4 * usual, 1e4 * usual, usual, neutral=0.0)
        return Effect(
            id=f"{self.place} += {self.variable}",
            stage=STAGES[self.place],
            hook=HOOKS[self.place],
            equation=f"{self.place} += c·{self.variable}",
            source="empirical",
            parameters=(size,),
            step=partial(_step, self),
        )


def _step(term: EmpiricalTerm, flow: Flow, values: Sequence[float], state: Memory) -> None:
    if len(flow.deformation_mm) != len(flow.t_s):
        # A resistor or a weight in place of the pad: nothing is pressed.
        return
    added = values[0] * VARIABLES[term.variable].column(flow, state, term)
    if term.place == "F":
        flow.force_N = np.maximum(0.0, flow.force_N + added * (flow.deformation_mm > 0.0))
    elif term.place == "force_N":
        flow.reading_N = flow.reading_N + added
    else:
        flow.output_V = flow.output_V + added
