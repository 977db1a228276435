"""Known loads at the line: what a lot asks for, and which load is read next.

Nothing moves for a known load: a person puts a weight on the unit that was pressed last, and the sensor is read.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason

MAX_LOADS = 2
"""Gain and level are two numbers; a third load would fix nothing more."""

REQUESTED, READ, FROM_START = "load.wanted", "load.read", "load.contradict"
"""Codes of what a run said: loads are to be read, one was read, all are to be read again from the first."""

REPEATED = ("load.unsteady", "load.unloaded", "load.same")
"""Codes after which the same load is read again."""


@dataclass(frozen=True)
class KnownLoad:
    """One weight with its expanded uncertainty U (k = 2), in the lot's reference unit; None where nobody stated U."""

    value: float
    expanded: float | None = None

    def __str__(self) -> str:
        """Return load and U; the load alone where nobody stated U."""
        return f"{self.value:.5g} ± {self.expanded:.2g}" if self.expanded else f"{self.value:.5g}"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and self.value >= 0):
            raise InputError(reason("load.negative", value=self.value))
        if self.expanded is not None and not (math.isfinite(self.expanded) and self.expanded >= 0):
            raise InputError(reason("load.bad_uncertainty", value=self.expanded))


def loads_text(loads: Sequence[KnownLoad]) -> str:
    """Return loads as one text, which a run's message carries, so that what was asked for cannot change meanwhile."""
    return ";".join(
        f"{load.value!r}" if load.expanded is None else f"{load.value!r}+-{load.expanded!r}" for load in loads
    )


def parse_loads(text: str) -> tuple[KnownLoad, ...]:
    """Return the loads of `loads_text`."""
    pairs = (part.partition("+-") for part in text.split(";") if part)
    return tuple(KnownLoad(float(value), float(expanded) if expanded else None) for value, _, expanded in pairs)


def next_step(message: Sequence[Reason]) -> int:
    """Return the number, from 1, of the load that is read next after a run that said this; 0 for none."""
    newest = message[0] if message else None
    step = int(str(newest.values.get("step", 0))) if newest is not None else 0
    if newest is None or newest.code not in (REQUESTED, READ, FROM_START, *REPEATED):
        return 0
    return step + 1 if newest.code in (REQUESTED, READ) else 1 if newest.code == FROM_START else step


def load_order(step: int, load: KnownLoad) -> str:
    """Return what the order of a reading says, besides its unit."""
    return f"{step}: {load.value!r}"


def ordered_load(text: str) -> tuple[int, float]:
    """Return step and load of `load_order`.

    Raises:
        InputError: an order that names none.
    """
    step, _, value = text.partition(": ")
    try:
        return int(step), float(value)
    except ValueError as error:
        raise InputError(reason("load.no_step", told=text[:40] or "–")) from error


def requested_loads(message: Sequence[Reason]) -> tuple[KnownLoad, ...]:
    """Return the loads that a run asked for."""
    return parse_loads(str(message[0].values.get("loads", ""))) if message else ()
