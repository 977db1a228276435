"""Profiles a station presses with: their course, and whether they keep its bounds. No Streamlit."""

from dataclasses import dataclass

import numpy as np

from softcal.core.profiles import Profile
from softcal.core.recording import Array

SHOWN_HZ = 20.0


@dataclass(frozen=True)
class Bound:
    """One bound a profile is held against.

    Args:
        name: depth or speed.
        value, largest: in `unit`.
    """

    name: str
    value: float
    largest: float
    unit: str

    @property
    def is_kept(self) -> bool:
        """Whether the profile stays within it."""
        return self.value <= self.largest


def course(profile: Profile) -> tuple[Array, Array, Array]:
    """Return t_s, stage_mm and speed_mm_s, (n,) each, of a profile for a chart."""
    t_s, stage_mm = profile.sample(SHOWN_HZ)
    return t_s, stage_mm, np.gradient(stage_mm, t_s)


def bounds(profile: Profile, deepest_mm: float, fastest_mm_s: float, start_mm: float = 0.0) -> tuple[Bound, ...]:
    """Return the bounds of a station beside what a profile asks of it.

    Args:
        start_mm: stage position at which the profile begins: the surface of the unit, less the clearance.
    """
    return (
        Bound("depth", start_mm + profile.deepest_mm, deepest_mm, "mm"),
        Bound("speed", profile.fastest_mm_s, fastest_mm_s, "mm/s"),
    )
