"""What a unit's fit keeps of the fit of its lot."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class LotFitPart:
    """The part of a unit in the fit of its lot. Uncertainties are standard ones, in the reference unit.

    Args:
        number: 1, 2, 3 ... of the fits of this lot.
        sitting: content hash of the recordings that were pressed by one load at once.
        units: how many these are.
        common_rmse: uncertainty of the load that all of them share: one error for every unit of the sitting.
        unit_rmse: uncertainty of the unit's own part.
    """

    number: int
    sitting: str
    units: int
    common_rmse: float
    unit_rmse: float
