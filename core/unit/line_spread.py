"""How differently a line presses and reads units that give the same output: what no unlabelled recording shows.

A load that is 5 % smaller and a sensor that is 5 % less sensitive are one output. The spread is therefore a fact of the
line: stated for it, estimated from audits and golden runs, or the default of the method. It is never zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError

MAX_SPREAD = 1.0


@dataclass(frozen=True)
class LineSpread:
    """Standard deviations, as shares of the load; None where nobody stated one.

    Args:
        load: from unit to unit: stiffness, contact and mounting on the press.
        day: from day to day: gain of press and readout.

    Raises:
        InputError: one of them is no share, or none is above zero: a line without any spread is not known yet.
    """

    load: float | None = None
    day: float | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not 0 <= value < MAX_SPREAD:
                raise InputError(
                    f"[line] {name}_spread is {value:g}; a share of the load between 0 and 1 was expected, such as 0.03"
                )
        if not self.share:
            raise InputError("[line] states no spread at all; leave out what nobody knows, and units say the default")

    @property
    def share(self) -> float:
        """All that is stated together, as a share of the load."""
        return float(np.hypot(self.load or 0.0, self.day or 0.0))


@dataclass(frozen=True)
class EstimatedGains:
    """Geometric mean, and standard deviation of the logarithm, of estimate / reference in audits or golden runs."""

    count: int
    centre: float
    spread: float


def estimate_gains(gains: Sequence[float], min_gains: int) -> EstimatedGains | None:
    """Return mean and spread of gains; None where they are fewer than `min_gains`, or one is not positive."""
    if len(gains) < min_gains or min(gains) <= 0:
        return None
    logs = np.log(gains)
    return EstimatedGains(len(gains), float(np.exp(logs.mean())), float(np.std(logs, ddof=1)))
