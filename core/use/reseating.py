"""Whether one cycle already shows a sensor that was re-seated, and how far, before a second cycle confirms it.

No use moves the output at rest. A cycle that took as long and swung as far as usual, but came to rest at another level,
is therefore the first one of a re-seated sensor. If the sensor moved in mid-cycle, mean and standard deviation of that
cycle mix both positions; its rest belongs to one of them and can be used.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.activity import Activity
from softcal.core.use.cycles import Cycle
from softcal.core.use.method import JumpConfig
from softcal.core.use.trust import movement


def rest_step(cycle: Cycle, activity: Activity, drift: Array, rest_is_low: bool, config: JumpConfig) -> float:
    """Return how far the rest of a cycle is from where it was expected, 0 where that is no re-seating.

    Args:
        cycle: in scales of the calibrated use.
        activity: the use it belongs to, or came after.
        drift: (2,) shift and log gain expected.
        rest_is_low: whether the unloaded turning point is the lower one.
        config: least and largest step that is a re-seating.
    """
    step = cycle.rest(rest_is_low) - activity.rest - movement(drift, activity.rest)
    floor = config.floor[0]
    least = max(floor, config.rest_sigmas * activity.rest_scatter)
    # The rest of a use that has none, or that moves as far as ever, shows nothing.
    if not activity.has_rest or not least < abs(step) <= config.largest[0]:
        return 0.0
    end = slice(0, config.end_quantiles) if rest_is_low else slice(-config.end_quantiles, None)
    # A rest of two levels, one before and one after the move, is spread more than a usual rest.
    unsteady = cycle.scale * float(np.ptp(cycle.shape[end]))
    usual = float(np.exp(activity.log_scale + drift[1]) * np.ptp(activity.shape[end]))
    return float(step) if unsteady <= usual + floor / 2 else 0.0


def is_like_but_for_shape(cycle: Cycle, activity: Activity, drift: Array, config: JumpConfig) -> bool:
    """Return whether a cycle took as long as those of an activity and swung about as far, whatever its shape."""
    longer = np.log(cycle.duration_s) - activity.log_duration
    larger = np.log(cycle.scale) - activity.log_scale - drift[1]
    return bool(abs(longer) <= activity.tolerance[2] and abs(larger) <= config.largest[1])


@dataclass(frozen=True)
class RestBeyond:
    """Where the rest of several cycles lies against known levels, in scales of the calibrated use.

    Args:
        away: beyond the nearest one, positive on the loaded side; 0 between them.
        sd: standard deviation of the mean rest.
        turning: how far the unloaded ends of the cycles spread; a use that turns without resting stays off zero by it.
    """

    away: float
    sd: float
    turning: float


def rest_beyond(cycles: Sequence[Cycle], levels: Array, rest_is_low: bool, config: JumpConfig) -> RestBeyond:
    """Return how far cycles rest beyond (n,) known levels; arguments otherwise as of `rest_step`."""
    rests = np.array([cycle.rest(rest_is_low) for cycle in cycles])
    beyond = min(float(rests.mean() - levels.min()), 0.0) + max(float(rests.mean() - levels.max()), 0.0)
    end = slice(0, config.end_quantiles) if rest_is_low else slice(-config.end_quantiles, None)
    turning = float(np.mean([cycle.scale * np.ptp(cycle.shape[end]) for cycle in cycles]))
    return RestBeyond(beyond if rest_is_low else -beyond, float(rests.std()) / len(rests) ** 0.5, turning)
