"""Calibrate a rig's lot and lots simulated on its twin, before and after the explanation."""

from collections.abc import Callable
from pathlib import Path

from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.gap.diagnose import read_twin
from softcal.core.errors import InputError
from softcal.core.gap.transfer import LotUnit, PressedLot, Transfer, transfer


def check_transfer(report: Path, lot_folder: Path, seed: int, say: Callable[[str], None]) -> Transfer:
    """Compare what the twins of a report foretell of calibration results with those on the rig.

    Args:
        report: of `softcal gap diagnose`; it holds the refitted base and the explained twin.
        lot_folder: units pressed on the rig, with audits and stage positions.

    Raises:
        InputError: the report holds no twins, or the lot lacks audits or stage positions.
    """
    base, explained = read_twin(report, "base_twin"), read_twin(report, "twin")
    folder = open_lot_folder(lot_folder)
    units = []
    for serial in folder.unit_paths:
        audit = folder.read_audit(serial)
        if audit is not None:
            units.append(LotUnit(folder.read_unit(serial), audit))
    if not units:
        raise InputError(f"{lot_folder}: no unit has a recording under audit/; the truth of at least one is needed")
    return transfer(PressedLot(folder.read_source(), tuple(units)), base, explained, seed, say)
