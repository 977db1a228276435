"""Exported files of units: their folders, and files that are no longer valid."""

import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from softcal.core.errors import RegistryReadOnly
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason, plain
from softcal.core.unit.verdict import VERDICTS
from softcal.db.entries import UNDECIDED, UnitResult
from softcal.db.registry import Registry


@dataclass(frozen=True)
class Recall:
    """A unit whose files no longer hold; `revision` is on its device.

    Args:
        host, place: computer, and folder or way by which the files went.
        verdict, why: of the unit now.
    """

    lot: str
    serial: str
    revision: int
    host: str
    place: str
    verdict: str
    why: Reason

    def to_json(self) -> dict[str, object]:
        return vars(self) | {"why": str(self.why)}


def record_exported_files(registry: Registry, units: Mapping[UnitKey, Mapping[str, object]], place: str) -> None:
    """Store the export of files of units with these revisions, maps and verdicts; each goes to one folder once."""
    rows = [{**vars(key), "host": socket.gethostname(), "place": place, **values} for key, values in units.items()]
    try:
        with registry.transaction():
            for lot_id in sorted({key.lot_id for key in units}):
                of_lot = [row for row in rows if row["lot_id"] == lot_id]
                registry.declarations.declare("exports", *of_lot, action="give_out")
    except RegistryReadOnly:
        # Who may only read can still export; nothing of it is recalled.
        return


def list_recalls(registry: Registry, lot_ids: Sequence[str]) -> list[Recall]:
    """Return exported files of lots that are no longer valid, the newest files of each unit and folder.

    A unit's verdict is worse than it was, or another map is in use.
    """
    recalls = []
    for lot_id in lot_ids:
        rows = registry.declarations.in_force("exports", lot_id)
        unit_statuses = registry.pages.unit_statuses(lot_id, sorted({row["serial"] for row in rows}), has_stale=True)
        for row in rows:
            status = unit_statuses.get(row["serial"])
            if (reason := _recall_reason(row, status)) is not None:
                details = (row["serial"], row["revision"], row["host"], row["place"])
                recalls.append(Recall(lot_id, *details, UNDECIDED if status is None else status.verdict, reason))
    return recalls


def _recall_reason(row: Mapping[str, object], status: UnitResult | None) -> Reason | None:
    """Return why files no longer hold; None where they do."""
    if status is None:
        return plain("none of its calibrations is in use")
    if VERDICTS.index(status.verdict) > VERDICTS.index(str(row["verdict"])):
        return status.reasons[0]
    if status.calibration is not None and status.calibration.map_sha256 == row["map_sha256"]:
        return None
    return plain(
        "another map is in use" + ("" if status.calibration is None else f", of revision {status.calibration.revision}")
    )
