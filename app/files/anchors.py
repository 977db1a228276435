"""Known loads of target units from a table: `serial, output, reference` rows."""

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from softcal.app.files.recording_file import write_columns
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.read import read_table
from softcal.core.errors import InputError
from softcal.core.maps.interface import Anchors


def read_anchors(path: Path, serials: Collection[str], options: TableOptions = DETECT) -> Mapping[str, Anchors]:
    """Read the anchors of a lot by serial.

    Raises:
        InputError: no such table, a unit outside the lot, or loads without a unit.
    """
    table = read_table(path, options, is_requested={"serial", "output", "reference"}.__contains__)
    output, reference = table.finite_numbers("output"), table.finite_numbers("reference")
    if "serial" not in table.names:
        if len(serials) != 1:
            raise InputError(
                f"{path}: no column 'serial', and the lot has {len(serials)} units; say whose anchors they are"
            )
        return {next(iter(serials)): Anchors(output, reference)}
    owners = np.array(table.texts("serial"))
    foreign_units = sorted(set(owners) - set(serials))
    if foreign_units:
        row = int(np.flatnonzero(owners == foreign_units[0])[0])
        raise InputError(f"{path}: line {table.lines[row]}: the lot has no unit {foreign_units[0]!r}")
    return {serial: Anchors(output[owners == serial], reference[owners == serial]) for serial in sorted(set(owners))}


def write_anchors(path: Path, loads: Mapping[str, Anchors]) -> None:
    """Write the known loads of units in the format of `read_anchors`."""
    serials = [serial for serial, one in loads.items() for _ in one.output]
    output, reference = (
        np.concatenate([np.asarray(getattr(one, name), np.float64) for one in loads.values()])
        for name in ("output", "reference")
    )
    write_columns(path, [("serial", serials), ("output", output), ("reference", reference)])
