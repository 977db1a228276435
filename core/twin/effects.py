"""What an effect of the twin is: where it stands in the chain, its equation, its parameters, its step."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from softcal.core.recording import Array

ChainStage = Literal["motion", "mechanics", "transduction", "electronics", "load_cell", "acquisition"]
Scale = Literal["linear", "log", "inverse_square"]
Memory: TypeAlias = dict[str, Array]
"""What one effect remembers from chunk to chunk; empty at the start of a run."""


class Hook(IntEnum):
    """The places of the chain an effect can change, in the order of the signal."""

    MOTION = 0
    CONTACT = 1
    FORCE = 2
    CHANNEL = 3
    RESISTANCE = 4
    REFERENCE = 5
    OUTPUT = 6
    CLOCK = 7
    READING = 8


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Args:
        name: as in the catalogue, without its unit.
        unit: physical unit, empty where there is none.
        low, high: bounds within which a fit may move it; the neutral value may lie outside.
        usual: typical size on a rig.
        neutral: value that switches the effect off, None for a shape parameter.
        scale: how a fit moves it; `inverse_square` for a level whose absence is infinity.
        weight: what it counts as when flexibility is penalised; less than 1 for a nuisance of one run.
    """

    name: str
    unit: str
    low: float
    high: float
    usual: float
    neutral: float | None = None
    scale: Scale = "linear"
    weight: float = 1.0


def _not_yet() -> Array:
    return np.empty(0)


@dataclass(eq=False, slots=True)
class Flow:
    """The signals of one stretch of a run while they pass through the chain; every stage writes its own.

    Args:
        t_s: (n,) time since the start of the run.
        step_s: (n,) time since the sample before, 0 at the start of a run.
        stage_mm: (n,) recorded stage position.
        temperature_rise_K: (n,) temperature above that of the run's first sample, None where it is not recorded.
        vref_V: nominal reference.
        episodes: per effect id (m, 2), the rows of an episodic effect in this run.
        run: position of this run in its case, for effects with values of their own in every run.
    """

    t_s: Array
    step_s: Array
    stage_mm: Array
    temperature_rise_K: Array | None
    vref_V: float
    episodes: Mapping[str, Array] = field(default_factory=dict)
    run: int = 0
    pad_mm: Array = field(default_factory=_not_yet)
    contact_mm: Array | float = 0.0
    toe_mm: float = 0.0
    compliance_mm_N: float = 0.0
    deformation_mm: Array = field(default_factory=_not_yet)
    force_N: Array = field(default_factory=_not_yet)
    drive: Array = field(default_factory=_not_yet)
    """What the channel feels: the force in N, or the deformation in mm of a strain sensor."""
    resistance_ohm: Array = field(default_factory=_not_yet)
    wiring_ohm: float = 0.0
    reference_V: Array | float = 0.0
    output_V: Array = field(default_factory=_not_yet)
    reading_N: Array = field(default_factory=_not_yet)
    is_unforeseeable: NDArray[np.bool_] | None = None
    """(n,) where nobody can foretell the output: after the end of this stretch, or amid a step; None for nowhere."""


Step: TypeAlias = Callable[[Flow, Sequence[float], Memory], None]
"""Change the flow in place by an effect with these parameter values and this memory."""


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue of effects (or another realisation of the same cause).

    Args:
        id: identifier of the catalogue.
        stage: stage of the chain it belongs to.
        hook: signal it changes.
        equation: its equation on top of the base model.
        source: where the equation or its usual size comes from.
        parameters: in the order `step` takes them; the first one is the size of the effect.
        step: the equation.
        is_episodic: it happens at a few instants of one run and does not carry over to another.
    """

    id: str
    stage: ChainStage
    hook: Hook
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    step: Step
    is_episodic: bool = False

    def __post_init__(self) -> None:
        if self.parameters and self.parameters[0].neutral is None:
            raise ValueError(f"the first parameter of {self.id} is its size and needs a neutral value")

    @property
    def neutral_values(self) -> tuple[float, ...]:
        """Values at which the effect changes nothing; shape parameters at their usual value."""
        return tuple(p.usual if p.neutral is None else p.neutral for p in self.parameters)


def memory(memory: Memory, name: str, *start: float) -> Array:
    """Return the named state array of an effect, made from its start values on first use."""
    if name not in memory:
        memory[name] = np.array(start, dtype=np.float64)
    return memory[name]
