"""All lots of a registry, one row each. No Streamlit."""

from dataclasses import dataclass
from datetime import date, datetime
from itertools import count

from softcal.app.registry.limit import limit_or_none
from softcal.core.quality.yields import Share
from softcal.db.registry import Registry


@dataclass(frozen=True)
class LotRow:
    """One lot of the list.

    Args:
        state: the text `lots.state.STATE`.
        decided: units with a result that waits for no evidence, of `units` target units.
        good: decided units that pass, the yield; None while none is decided.
        audited: units whose error was measured with the load cell, as on the lot's page.
        released: units that pass.
        changed_at: when its newest recording was added, or its newest decision made; None before both.
    """

    lot_id: str
    sensor_model: str
    state: str
    units: int
    decided: int
    good: Share | None
    audited: int
    released: int
    changed_at: datetime | None


def lot_list(registry: Registry) -> list[LotRow]:
    """Return every lot, the one that changed last first."""
    rows = [_row(registry, lot_id) for lot_id in registry.lots.ids()]
    undated = [row for row in rows if row.changed_at is None]
    dated = [row for row in rows if row.changed_at is not None]
    return sorted(dated, key=lambda row: str(row.changed_at), reverse=True) + undated


def proposed_lot_id(registry: Registry, today: date) -> str:
    """Return the name of a new lot where nobody gives one: year and week (ISO 8601), counted on where it is taken."""
    week, stored = f"{today:%G-%V}", set(registry.lots.ids())
    names = (week if number == 1 else f"{week}-{number}" for number in count(1))
    return next(name for name in names if name not in stored)


def _row(registry: Registry, lot_id: str) -> LotRow:
    counts, recordings = registry.pages.verdict_counts(lot_id), registry.recordings.of_lot(lot_id)
    units, released = sum(counts.values()), counts["pass"]
    decided, decision = units - counts["none"] - counts["conditional"], registry.decisions.in_force(lot_id)
    instants = [entry.added_at for entry in recordings] + ([decision.made_at] if decision else [])
    kinds = {entry.kind for entry in recordings}
    limit = limit_or_none(registry, lot_id)
    if "source" not in kinds and registry.networks.released(lot_id) is None:
        state = "source"
    elif counts["none"] == units:
        state = "units"
    elif limit is None or not limit.is_stated:
        state = "limit"
    elif counts["conditional"] or counts["retest"]:
        state = "waiting"
    else:
        state = "decided"
    return LotRow(
        lot_id,
        registry.lots.get(lot_id).sensor_model,
        state,
        units,
        decided,
        Share(released, decided) if decided else None,
        registry.pages.audited_count(lot_id),
        released,
        max(instants, default=None),
    )
