"""Excitation range of recordings, and starting points of the search for an effect."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

TAU_s = (0.05, 0.2, 0.6, 2.0, 6.0, 20.0, 60.0)
"""Time constants tried for an effect with a memory, as far as the longest run reaches."""

Measure = Literal[
    "one",
    "depth_mm",
    "force_N",
    "series_ohm",
    "duration_s",
    "period_s",
    "softness_mm_N",
    "rate_per_s",
    "force_rate_N_s",
    "period_per_duration",
    "per_force2",
]


@dataclass(frozen=True)
class ExcitationRange:
    """Excitation range of a case, with its longest run, sample period and series resistor."""

    depth_mm: float
    force_N: float
    lowest_V: float
    highest_V: float
    duration_s: float
    period_s: float
    series_ohm: float = 10.0

    def measure(self, name: Measure) -> float:
        derived = {
            "one": 1.0,
            "softness_mm_N": self.depth_mm / self.force_N,
            "per_force2": 1.0 / self.force_N**2,
            "rate_per_s": 1.0 / self.duration_s,
            "force_rate_N_s": self.force_N / self.duration_s,
            "period_per_duration": self.period_s / self.duration_s,
        }
        return derived[name] if name in derived else float(getattr(self, name))


Probes: TypeAlias = Callable[[ExcitationRange], Sequence[tuple[float, ...]]]
"""Parameter values at which an effect is tried on a case, the size first."""


@dataclass(frozen=True)
class Sizes:
    """Sizes of an effect without a shape, as multiples of a natural unit of the case."""

    multiples: tuple[float, ...]
    unit: Measure = "one"

    def __call__(self, at: ExcitationRange) -> list[tuple[float, ...]]:
        return [(multiple * at.measure(self.unit),) for multiple in self.multiples]


@dataclass(frozen=True)
class Shapes:
    """Starting points: one small size and several shapes, each as multiples of a natural unit of the case."""

    size: float
    multiples: tuple[float, ...]
    unit: Measure = "one"
    size_unit: Measure = "one"

    def __call__(self, at: ExcitationRange) -> list[tuple[float, ...]]:
        return [
            (self.size * at.measure(self.size_unit), multiple * at.measure(self.unit)) for multiple in self.multiples
        ]


@dataclass(frozen=True)
class TimeConstants:
    """Starting points: one small size and every time constant that a run excites, without the shortest ones."""

    size: float
    without: int = 0

    def __call__(self, at: ExcitationRange) -> list[tuple[float, ...]]:
        return [(self.size, tau_s) for tau_s in [t for t in TAU_s if t < at.duration_s][self.without :]]
