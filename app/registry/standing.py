"""How a unit stands: a refusal may be newer than the calibration in use, and then the unit has no map to give out.

Whoever gives out files, warns at use or shows a verdict asks here, so that all of them say the same word.
"""

from softcal.core.words.reason import plain
from softcal.db.entries import UNDECIDED, StoredCalibration, UnitStanding
from softcal.db.registry import Registry


def standing_of(registry: Registry, stored: StoredCalibration) -> UnitStanding:
    """Return how the unit of a calibration stands now; without `made`, its newest result is no calibration.

    Args:
        stored: any calibration of the unit.
    """
    found = registry.pages.standings(stored.lot_id, [stored.serial]).get(stored.serial)
    nothing = UnitStanding(stored.serial, UNDECIDED, (plain("none of its calibrations is in use"),), stored.made_at)
    return nothing if found is None else found
