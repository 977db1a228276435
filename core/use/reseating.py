"""Whether one cycle already shows a sensor that was re-seated, and how far: before a second one confirms it or not.

No use moves the output at rest. So a cycle that took as long and swung as far as the known ones, and that came to rest
elsewhere, is the first of a sensor that sits elsewhere. Its level and scale may be of two seats; its rest is of one.
"""

import numpy as np

from softcal.core.recording import Array
from softcal.core.use.activity import Activity
from softcal.core.use.cycles import Cycle
from softcal.core.use.trust import movement

END = 3
"""So many of a cycle's quantiles from its unloaded end show how steady that is."""


def rest_step(cycle: Cycle, activity: Activity, drift: Array, rest_is_low: bool, bounds: tuple[float, float]) -> float:
    """Return how far the rest of a cycle is from where it was expected, 0 where that is no re-seating.

    Args:
        cycle: in scales of the calibrated use.
        activity: the use it belongs to, or came after.
        drift: (2,) shift and log gain expected.
        rest_is_low: whether the unloaded turning point is the lower one.
        bounds: least and largest step that is a re-seating.
    """
    step = cycle.rest(rest_is_low) - activity.rest - movement(drift, activity.rest)
    least = max(bounds[0], 4 * activity.rest_scatter)
    if not activity.has_rest or not least < abs(step) <= bounds[1]:
        return 0.0
    end = slice(0, END) if rest_is_low else slice(-END, None)
    unsteady = cycle.scale * float(np.ptp(cycle.shape[end]))
    usual = float(np.exp(activity.log_scale + drift[1]) * np.ptp(activity.shape[end]))
    return float(step) if unsteady <= usual + bounds[0] / 2 else 0.0


def is_like_but_for_shape(cycle: Cycle, activity: Activity, drift: Array, largest: float) -> bool:
    """Return whether a cycle took as long as those of an activity, and its log scale is within `largest` of theirs."""
    longer = np.log(cycle.duration_s) - activity.log_duration
    larger = np.log(cycle.scale) - activity.log_scale - drift[1]
    return bool(abs(longer) <= activity.tolerance[2] and abs(larger) <= largest)
