"""How wrong the estimates of a unit in use may be: for its interval, its predicted error and its state.

All numbers are standard deviations or their squares in scales of the calibrated use, and independent: squares add up.
What may be use as well as drift is no alarm: nothing of it is applied, and the state of the rows says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.method import DoubtConfig

UNCOMPARED = "much of the use could not be compared with any that is known"
MISSED = "the use moved while it was learnt: sensor or use"
STRAY = "a new use rests where none that is known does: sensor or use"
OPEN = "a drift is seen that is not followed, for a change of use would look the same"
JUMP = "a sudden change is not explained"
QUEUE = "a queue was mapped far from the calibration: a drift, or another use"
"""Why estimates may be wrong."""

COMPARE = "compare a known load"
"""What to do: one known load tells use from drift."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a drift when its doubt is asked for.

    Args:
        drift, applied: (2,) shift and log gain, estimated and applied.
        chance: variance of the estimated drift.
        walked: variance that may have come since the last cycle.
        moved: how far the rest has gone in all.
        use_doubt: expected square of the error of a gain that may have been use, and of a shift, a preload.
        unseen: drift that may have come in use that could not be compared.
        is_learning: whether that is the unit's first use, which is still being learnt.
        unresolved: size of an unexplained jump.
        missed: how far level or scale moved while the first use was learnt.
        stray: how far the rest of a new use lies from all that are known.
        lag: how far the filter is behind, beyond chance.
        away: how far the latest use that is not known rests from all that are.
    """

    drift: Array
    applied: Array
    chance: float
    walked: float
    moved: float
    use_doubt: float
    unseen: float
    is_learning: bool
    unresolved: float
    missed: float
    stray: float
    lag: float
    away: float = 0.0

    @property
    def left(self) -> float:
        """Square of the drift that is estimated and not applied."""
        return float(np.sum((self.drift - self.applied) ** 2))

    @property
    def size(self) -> float:
        """Square of the correction."""
        return float(self.applied @ self.applied)


@dataclass(frozen=True)
class Doubt:
    """How wrong the corrected output may be, for its interval and for the predicted error (`growth`).

    The squares of what may be use as well as drift, by why, hold the map.
    """

    widening: float
    growth: float
    of_use: Mapping[str, float]


def due(why: str) -> str:
    """Return why, and what to do."""
    return f"{why}; {COMPARE}"


def doubt(seen: Evidence, config: DoubtConfig) -> Doubt:
    """Add up what is in doubt.

    Interval and predicted error hold three things: the error of the applied correction, what may have come since the
    last cycle or in use that was not compared, and what was not explained. The error of the correction is its variance,
    a share of its size, how far it is behind, a share of the whole way of the rest, and that its gain may have been
    use. The interval adds all of the estimated drift that was not applied. Of a use that is not known it adds how far
    that rests from those that are, and a gain as large. Of the drift the predicted error adds only what exceeds chance,
    and of that the part that is as likely drift as use. It leaves out use that was not compared while the first use is
    still being learnt.
    """
    # What was not applied cannot be wrong by chance: the variance counts as far as the correction goes.
    share = min(1.0, seen.size / max(float(seen.drift @ seen.drift), 1e-24))
    known = share * (seen.chance + seen.lag**2) + config.correction**2 * (seen.size + seen.moved**2)
    known += seen.use_doubt + seen.walked
    open_ends = seen.unresolved**2 + seen.missed**2 + seen.stray**2
    unseen = seen.unseen**2
    counted = 0.0 if seen.is_learning else unseen
    beyond = max(0.0, seen.left - seen.chance)
    return Doubt(
        widening=float(np.sqrt(known + unseen + open_ends + seen.left + 2 * seen.away**2)),
        growth=float(np.sqrt(known + counted + open_ends + 0.5 * beyond)),
        of_use={
            UNCOMPARED: counted,
            MISSED: seen.missed**2,
            STRAY: seen.stray**2,
            JUMP: seen.unresolved**2,
            OPEN: max(0.0, seen.left - config.certain * seen.chance) + (1 - share) * seen.lag**2,
        },
    )
