"""Known loads of a lot's units, read at rest and stored with their recording.

One home for all of them: the line reads them, a file or a page brings them, and every calibration of that recording
takes them from here, so that none is put into use without them.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from softcal.core.maps.interface import Anchors
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class UnitLoads:
    """Known loads of one recording.

    Args:
        where: `line`, `file` or `page`.
    """

    serial: str
    recording_sha256: str
    loads: Anchors
    at: datetime
    actor: str
    where: str


def known_loads(registry: Registry, lot_id: str, serials: Collection[str] | None = None) -> Mapping[str, UnitLoads]:
    """Return the newest known loads by the hash of their recording.

    Args:
        serials: of these units of the lot; None is all that have a recording.
    """
    if serials is None:
        serials = {entry.serial for entry in registry.recordings.of_lot(lot_id, kind="unit")}
    by_recording: dict[str, UnitLoads] = {}
    for row in registry.declarations.in_force("known_loads", lot_id, serials):
        readings = [(one["output"], one["reference"]) for one in row["listed"]]
        loads = Anchors(*np.array(readings, np.float64).reshape(-1, 2).T)
        origin = (row["made_at"], row["actor"], row["brought_by"])
        by_recording[row["recording_sha256"]] = UnitLoads(row["serial"], row["recording_sha256"], loads, *origin)
    return by_recording


def store_loads(
    registry: Registry, lot_id: str, loads: Mapping[str, tuple[str, Anchors]], where: str, *, actor: str | None = None
) -> int:
    """Store new known loads, all or none; return the number of their recordings.

    Args:
        loads: hash of a recording → (serial, loads).
    """
    stored = known_loads(registry, lot_id, {serial for serial, _ in loads.values()})
    rows = [
        {"lot_id": lot_id, "serial": serial, "recording_sha256": sha256, "brought_by": where} | _listed(anchors)
        for sha256, (serial, anchors) in loads.items()
        if sha256 not in stored or values(stored[sha256].loads) != values(anchors)
    ]
    return registry.declarations.declare("known_loads", *rows, actor=actor)


def _listed(loads: Anchors) -> dict[str, object]:
    readings = zip(loads.output.tolist(), loads.reference.tolist(), strict=True)
    return {"listed": [{"position": k, "output": V, "reference": load} for k, (V, load) in enumerate(readings)]}


def values(loads: Anchors) -> dict[str, list[float]]:
    """Return loads as JSON values."""
    return {"output": loads.output.tolist(), "reference": loads.reference.tolist()}
