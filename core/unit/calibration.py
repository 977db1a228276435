"""What an estimate f∘γ of one unit is computed with."""

from dataclasses import dataclass

from softcal.core.maps.interface import UnitMap
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.method import Method
from softcal.core.unit.uncertainty import Interval


@dataclass(frozen=True, eq=False)
class Calibration:
    """The map γ of one unit with its 90 % interval, as `UnitState.calibration` gives it.

    Args:
        method: every number it was made with.
        predicted_rmse: forecast of the error against a reference, in the reference unit.
    """

    serial: str
    network_id: str
    unit_map: UnitMap
    interval: Interval
    output_limits: OutputLimits
    method: Method
    predicted_rmse: float
