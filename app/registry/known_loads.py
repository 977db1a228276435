"""Known loads of a lot's units: read at rest, kept with the recording they belong to.

One home for all of them: the line reads them, a file or a page brings them, and every calibration of that recording
takes them from here, so that none is put into use without them. They are rows of the audit trail.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from softcal.core.maps.interface import Anchors
from softcal.db.registry import Registry

ENTITY = "known_loads"


@dataclass(frozen=True, eq=False)
class UnitLoads:
    """The known loads that belong to one recording.

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
    """Return known loads by the hash of the recording they belong to; the newest of each.

    Args:
        serials: of these units of the lot; None is all that have a recording.
    """
    if serials is None:
        serials = {entry.serial for entry in registry.recordings.of_lot(lot_id, kind="unit")}
    found: dict[str, UnitLoads] = {}
    for row in registry.trail.of_several(ENTITY, [(lot_id, serial) for serial in sorted(serials)]):
        content: dict[str, Any] = json.loads(row.after or "{}")
        for sha256, one in content["recordings"].items():
            if one["serial"] not in serials:
                continue
            found[sha256] = UnitLoads(one["serial"], sha256, loads_of(one), row.at, row.actor, content["where"])
    return found


def keep_loads(
    registry: Registry, lot_id: str, loads: Mapping[str, tuple[str, Anchors]], where: str, *, actor: str | None = None
) -> int:
    """Keep known loads that are new, a row a unit, all or none; return of how many recordings.

    Args:
        loads: hash of a recording → (serial, loads).
    """
    before = known_loads(registry, lot_id, {serial for serial, _ in loads.values()})
    new = {sha: one for sha, one in loads.items() if sha not in before or values(before[sha].loads) != values(one[1])}
    by_unit: dict[str, dict[str, object]] = {}
    for sha, (serial, anchors) in new.items():
        by_unit.setdefault(serial, {})[sha] = {"serial": serial, **values(anchors)}
    if not by_unit:
        return 0
    with registry.transaction():
        for serial, facts in by_unit.items():
            content = {"where": where, "recordings": facts}
            registry.trail.add("state", ENTITY, (lot_id, serial), content, actor=actor)
    return len(new)


def values(loads: Anchors) -> dict[str, list[float]]:
    """Return loads as JSON values."""
    return {"output": loads.output.tolist(), "reference": loads.reference.tolist()}


def loads_of(kept: Mapping[str, Any]) -> Anchors:
    """Return loads from the JSON values that `values` made."""
    return Anchors(np.array(kept["output"], np.float64), np.array(kept["reference"], np.float64))
