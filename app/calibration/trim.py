"""Trim a registered unit by known loads at its place of use: a new revision, or nothing. No other unit changes."""

from pathlib import Path

from softcal.app.files.anchors import read_anchors
from softcal.app.registry.trimmed import is_trimmed_by, store_trim
from softcal.app.tables.options import DETECT, TableOptions
from softcal.core.unit.adjustments import Trim
from softcal.db.registry import Registry


def trim_unit(
    registry: Registry, serial: str, loads_file: Path, lot_id: str | None, table: TableOptions = DETECT
) -> tuple[Trim, int]:
    """Re-anchor a unit's map by loads of a file; return the trim and the new revision.

    Args:
        loads_file: table with the columns output, reference; a row a load; a column serial names this unit.

    Raises:
        InputError: the loads cannot be of this unit, or the unit is not in the registry; nothing was changed.
    """
    stored = registry.calibrations.get(serial, lot_id=lot_id)
    result = store_trim(registry, stored, read_anchors(loads_file, [serial], table)[serial])
    return result, registry.calibrations.get(serial, lot_id=stored.lot_id).revision


def trimmed_by(
    registry: Registry, serial: str, loads_file: Path, lot_id: str | None, table: TableOptions = DETECT
) -> int:
    """Return the revision that known loads made, trimming only where they have not yet.

    A stream that is followed again from its start is then followed from the same map.
    """
    stored = registry.calibrations.get(serial, lot_id=lot_id)
    if is_trimmed_by(stored.state, read_anchors(loads_file, [serial], table)[serial]):
        return stored.revision
    return trim_unit(registry, serial, loads_file, lot_id, table)[1]
