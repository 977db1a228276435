"""Mistakes of the people who record: what a run says instead of what was measured."""

from collections.abc import Callable, Mapping
from typing import TypeAlias

from softcal.core.challenge.rig import Measured

Mistake: TypeAlias = Callable[[Measured, int], Measured]
"""Change what was measured in a run, given its place among the runs of the case, −1 for one asked for later."""

MISTAKES: Mapping[str, Mistake] = {}
"""By name. A line `mistake` is drawn as soon as there is one; `judge` then expects the verdict `data`."""


def written_down(measured: Measured, mistake: str, place: int) -> Measured:
    """Return a run as it was written down, unchanged where nothing went wrong."""
    return MISTAKES[mistake](measured, place) if mistake else measured
