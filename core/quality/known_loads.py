"""Known loads at the line: what a lot asks for, how a reading at rest is judged, and which load is read next.

Nothing moves for a known load: a person puts a weight on the unit that was pressed last, and the sensor is read.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.settings import setting
from softcal.core.words.reason import Reason, reason

MOST_LOADS = 2
"""Gain and level are two numbers; a third load would fix nothing more."""

WANTED, READ, FROM_START = "load.wanted", "load.read", "load.contradict"
"""Codes of what a run said: loads are to be read, one was read, all are to be read again from the first."""

REPEATED = ("load.unsteady", "load.unloaded", "load.same")
"""Codes after which the same load is read again."""


@dataclass(frozen=True)
class KnownLoad:
    """One weight, in the reference unit of the lot.

    Args:
        value: the load, 0 for the unit with nothing on it.
        expanded: its expanded uncertainty U (k = 2).
    """

    value: float
    expanded: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and self.value >= 0):
            raise InputError(reason("load.negative", value=self.value))
        if not (math.isfinite(self.expanded) and self.expanded >= 0):
            raise InputError(reason("load.bad_uncertainty", value=self.expanded))


@dataclass(frozen=True)
class ReadingConfig:
    """How a sensor is read at rest. It decides whether a reading is taken; what a map makes of it is in the method.

    Args:
        settle_s: after the key, before the reading begins: a hand leaves the weight.
        reading_s: length of the reading; its mean is the level.
        drift: change from the first to the second half of the reading, as a share of the unit's output range.
        restless: standard deviation of the samples, as a share of that range.
        change: a load must change the output by this share of that range.
    """

    settle_s: float = setting(2.0)
    reading_s: float = setting(3.0)
    drift: float = setting(0.01)
    restless: float = setting(0.03)
    change: float = setting(0.02)


def loads_text(loads: Sequence[KnownLoad]) -> str:
    """Return loads as one text, which a run's message carries, so that what was asked for cannot change meanwhile."""
    return ";".join(f"{load.value!r}+-{load.expanded!r}" for load in loads)


def loads_of(text: str) -> tuple[KnownLoad, ...]:
    """Return the loads of `loads_text`."""
    pairs = (part.split("+-") for part in text.split(";") if part)
    return tuple(KnownLoad(float(value), float(expanded)) for value, expanded in pairs)


def next_step(message: Sequence[Reason]) -> int:
    """Return the number, from 1, of the load that is read next after a run that said this; 0 for none."""
    said = message[0] if message else None
    step = int(str(said.values.get("step", 0))) if said is not None else 0
    if said is None or said.code not in (WANTED, READ, FROM_START, *REPEATED):
        return 0
    return step + 1 if said.code in (WANTED, READ) else 1 if said.code == FROM_START else step


def load_order(step: int, load: KnownLoad) -> str:
    """Return what the order of a reading says, besides its unit."""
    return f"{step}: {load.value!r}"


def ordered_load(told: str) -> tuple[int, float]:
    """Return step and load of `load_order`.

    Raises:
        InputError: an order that names none.
    """
    step, _, value = told.partition(": ")
    try:
        return int(step), float(value)
    except ValueError as error:
        raise InputError(reason("load.no_step", told=told[:40] or "–")) from error


def asked_loads(message: Sequence[Reason]) -> tuple[KnownLoad, ...]:
    """Return the loads that a run asked for."""
    return loads_of(str(message[0].values.get("loads", ""))) if message else ()


def level_at_rest(
    output: Array, recorded: Array, load: KnownLoad, before: Sequence[float], config: ReadingConfig
) -> float:
    """Return the output at rest under a load.

    Args:
        output: (n,) the reading.
        recorded: (m,) output of the unit's run; it begins with nothing on the unit.
        load: what lies on the unit, as far as it was asked for.
        before: levels under the loads read before.

    Raises:
        InputError: the output does not stand still, or is the same as without this load.
    """
    span = float(np.ptp(recorded))
    first, second = np.array_split(output, 2)
    drift, spread = abs(float(np.mean(second) - np.mean(first))), float(np.std(output))
    if drift > config.drift * span or spread > config.restless * span:
        raise InputError(reason("load.unsteady", drift=drift / span, spread=spread / span))
    level, least = float(np.mean(output)), config.change * span
    if load.value > 0 and abs(level - float(np.median(recorded[: max(1, len(recorded) // 100)]))) < least:
        raise InputError(reason("load.unloaded", level=level))
    if any(abs(level - other) < least for other in before):
        raise InputError(reason("load.same", level=level))
    return level
