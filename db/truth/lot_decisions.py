"""Decisions on a lot as a whole, numbered; the newest is in force."""

from collections.abc import Mapping

from sqlalchemy import func, select

from softcal.db.entries import LotDecisionEntry
from softcal.db.schema.tables import lot_decisions
from softcal.db.truth.registry_base import RegistryBase, of_row


class LotDecisionTable(RegistryBase):
    """What was decided on lots: corrections, and statements on units that nobody measured."""

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
            self._store(lot_decisions, values | {"decision": dict(decision)}, action, actor, reason)
            return (number or 0) + 1

    def in_force(self, lot_id: str) -> LotDecisionEntry | None:
        """Return the newest decision on a lot; None before the first."""
        d = lot_decisions.c
        query = select(lot_decisions).where(d.lot_id == lot_id)
        row = self.database.row(query.order_by(d.made_at.desc(), d.number.desc(), d.origin.desc()).limit(1))
        if row is None:
            return None
        self._check_row(lot_decisions, row)
        return of_row(LotDecisionEntry, row)

    def of_lot(self, lot_id: str) -> list[LotDecisionEntry]:
        """Return every decision on a lot, oldest first; two registries may have made one of the same number."""
        d = lot_decisions.c
        query = select(lot_decisions).where(d.lot_id == lot_id).order_by(d.made_at, d.number, d.origin)
        return [of_row(LotDecisionEntry, row) for row in self.database.rows(query)]
