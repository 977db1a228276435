"""How a sensor is read at rest under a known load, and whether a reading is taken.

Apart from `known_loads`: who only lists units or rules needs no arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.messages.reason import reason
from softcal.core.quality.known_loads import KnownLoad
from softcal.core.recording import Array
from softcal.core.settings import setting


@dataclass(frozen=True)
class ReadingConfig:
    """How a sensor is read at rest. It decides whether a reading is taken; what a map makes of it is in the method.

    Args:
        settle_s: after the key, before the reading begins: a hand leaves the weight.
        reading_s: length of the reading; its mean is the level.
        drift: change from the first to the second half of the reading, as a share of the unit's output range. A load
            must change the output by twice as much.
        restless: standard deviation of the samples, as a share of that range.
    """

    settle_s: float = setting(2.0)
    reading_s: float = setting(3.0)
    drift: float = setting(0.01)
    restless: float = setting(0.03)


def level_at_rest(
    output: Array, recorded: Array, load: KnownLoad, before: Sequence[float], config: ReadingConfig
) -> float:
    """Return the output at rest under a load.

    Args:
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
    level, min_change = float(np.mean(output)), 2 * config.drift * span
    if load.value > 0 and abs(level - float(np.median(recorded[: max(1, len(recorded) // 100)]))) < min_change:
        raise InputError(reason("load.unloaded", level=level))
    if any(abs(level - other) < min_change for other in before):
        raise InputError(reason("load.same", level=level))
    return level
