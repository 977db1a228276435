"""Decisions on a lot as a whole, numbered; the newest is in force."""

from collections.abc import Mapping

import sqlalchemy as sa
from sqlalchemy import func, select

from softcal.db.entries import LotDecisionEntry
from softcal.db.provenance import software_now
from softcal.db.repositories.registry_base import RegistryBase, entry_from_row
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database
from softcal.db.schema.tables import lot_decisions


class LotDecisionTable(RegistryBase):
    """Repository of decisions on lots: corrections, and statements about unmeasured units."""

    def add(
        self, lot_id: str, decision: Mapping[str, object], *, action: str, actor: str | None = None, reason: str = ""
    ) -> int:
        """Store the next decision on a lot and return its number."""
        d = lot_decisions.c
        with self.database.writing():
            self._lot_row(lot_id)
            newest = select(func.max(d.number), func.max(d.made_at)).where(d.lot_id == lot_id)
            ((number, made_at),) = self.database.tuples(newest)
            values = {"lot_id": lot_id, "number": (number or 0) + 1, "origin": self.origin}
            values |= {"made_at": self._after(made_at), "actor": self._actor(actor), "reason": reason}
            values |= {**software_now(), "decision": dict(decision)}
            self._store(lot_decisions, values, action, actor, reason)
            return (number or 0) + 1

    def in_force(self, lot_id: str) -> LotDecisionEntry | None:
        """Return the newest decision on a lot; None before the first."""
        d = lot_decisions.c
        query = select(lot_decisions).where(d.lot_id == lot_id)
        row = self.database.row(query.order_by(d.made_at.desc(), d.number.desc(), d.origin.desc()).limit(1))
        if row is None:
            return None
        self._check_row(lot_decisions, row)
        return entry_from_row(LotDecisionEntry, row)

    def of_lot(self, lot_id: str) -> list[LotDecisionEntry]:
        """Return every decision on a lot, oldest first; two registries may have one of the same number."""
        d = lot_decisions.c
        query = select(lot_decisions).where(d.lot_id == lot_id).order_by(d.made_at, d.number, d.origin)
        return [entry_from_row(LotDecisionEntry, row) for row in self.database.rows(query)]


def decision_conflicts(database: Database) -> list[str]:
    """Return a line for each lot whose two registries have different decisions of the same, newest number.

    The one that was made last is in force, units that either released stay; a person makes the next one.
    """
    d = lot_decisions.c
    newest = select(d.lot_id, func.max(d.number).label("number")).group_by(d.lot_id).subquery()
    is_newest = sa.and_(newest.c.lot_id == d.lot_id, newest.c.number == d.number)
    query = select(d.lot_id, d.number, d.origin, d.made_at, d.decision).join(newest, is_newest)
    decisions: dict[tuple[str, int], list[sa.RowMapping]] = {}
    for row in database.rows(query.order_by(d.lot_id, d.made_at)):
        decisions.setdefault((row["lot_id"], row["number"]), []).append(row)
    return [
        f"lot {lot_id}: decision {number} was made by the registries "
        + ", ".join(f"{row['origin']} ({row['made_at']:%Y-%m-%d %H:%M:%S} UTC)" for row in rows)
        + "; the last one is in force; decide by `softcal lot release` or a batch"
        for (lot_id, number), rows in decisions.items()
        # Who made it, and when, is no part of what it says.
        if len({canonical_json(dict(row["decision"]) | {"provenance": None}) for row in rows}) > 1
    ]
