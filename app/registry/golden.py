"""Which golden run of the source a unit was pressed beside: kept with its recording, as known loads are.

One home for it. A station finds it when a unit is pressed, a lot folder brings it, and every later calibration of that
recording crosses the same bridge. They are rows of the audit trail.
"""

from collections.abc import Collection, Mapping
from datetime import datetime

from softcal.app.registry.stated import statements
from softcal.core.errors import InputError
from softcal.core.unit.bridge import Bridge, make_bridge
from softcal.core.unit.source_model import SourceModel
from softcal.db.registry import Registry

ENTITY = "golden_of"


def golden_of(registry: Registry, lot_id: str, serials: Collection[str]) -> Mapping[str, tuple[str, str]]:
    """Return, by the hash of a unit's recording, its serial and its golden run's hash."""
    found: dict[str, tuple[str, str]] = {}
    for facts in statements(registry, ENTITY, *((lot_id, serial) for serial in sorted(serials))):
        found |= {sha256: (facts["serial"], golden) for sha256, golden in facts["recordings"].items()}
    return found


def keep_golden_of(registry: Registry, lot_id: str, of: Mapping[str, tuple[str, str]], *, actor: str | None) -> None:
    """Keep which golden run recordings belong to, a row a unit; what is known gets no row.

    Args:
        of: hash of a unit's recording → (serial, hash of the golden run).
    """
    before = golden_of(registry, lot_id, {serial for serial, _ in of.values()})
    new = {sha256: one for sha256, one in of.items() if before.get(sha256) != one}
    if not new:
        return
    with registry.transaction():
        for sha256, (serial, golden) in new.items():
            facts = {"serial": serial, "recordings": {sha256: golden}}
            registry.trail.add("state", ENTITY, (lot_id, serial), facts, actor=actor)


def newest_golden(registry: Registry, station: str, source: str, since: datetime) -> str | None:
    """Return the hash of the newest golden run of a source on a station that passed."""
    runs = registry.stations.golden_runs(station, source, since)
    return next((run.recording_sha256 for run in reversed(runs) if run.passed and run.recording_sha256), None)


def bridge_over(registry: Registry, model: SourceModel, golden_sha256: str) -> Bridge | str:
    """Return a kept golden run as its sitting's units are compared with it, or why not."""
    try:
        return make_bridge(model, registry.recordings.get(golden_sha256))
    except InputError as error:
        return str(error)


def golden_lot(registry: Registry, serial: str) -> str | None:
    """Return a lot whose source a serial is and whose network is released."""
    lots = (lot.id for lot in registry.lots.all() if lot.source == serial)
    return next((lot for lot in lots if registry.networks.released(lot) is not None), None)
