"""Cursor of each destination in the audit trail: all rows up to the cursor were sent.

The trail is the outbox: an event in the transaction of its change is never lost.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from heapq import merge
from itertools import islice

from sqlalchemy import insert, or_, select, update

from softcal.core.errors import InputError
from softcal.db.entries import AuditRow
from softcal.db.repositories import history
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.deadline import passed_condition
from softcal.db.schema.tables import deliveries

Cursor = Mapping[str, int]
"""Number of the last row taken of each chain of the audit trail, by the registry that wrote it."""


@dataclass(frozen=True)
class Delivery:
    """State of one destination.

    Args:
        cursor: the last rows it has.
        delivered: number of events delivered to it.
        failures: tries in a row that failed.
        not_before: the next try waits until then; None does not wait.
        error: why the last try failed; "" after one that did not.
        holder: the process that serves it; None where none does.
        held_until: from then on another process may take it.
    """

    destination: str
    cursor: Cursor
    delivered: int
    failures: int
    not_before: datetime | None
    error: str
    changed_at: datetime
    holder: str | None
    held_until: datetime | None


class Outbox(RegistryBase):
    """The destinations of a registry's events. Every call is one short transaction."""

    def end(self) -> dict[str, int]:
        """Return the cursor behind everything there is."""
        with self.database.reading():
            return {origin: seq for origin, (seq, _) in history.heads(self.database).items()}

    def after(self, cursor: Cursor, count: int) -> list[AuditRow]:
        """Return the next rows behind a cursor: in the order of each chain, else of time."""
        with self.database.reading():
            names = history.origins(self.database)
            chains = [list(history.rows(self.database, name, cursor.get(name, 0), count)) for name in names]
        # A clock that was set back must not put a row before the one it follows.
        return list(islice(merge(*chains, key=lambda row: row.at), count))

    def begin(self, destination: str, cursor: Cursor) -> Delivery:
        """Return the state of a destination; a new destination begins behind `cursor`."""
        fresh = {"delivered": 0, "failures": 0, "not_before": None, "error": "", "changed_at": self.settings.clock()}
        with self.database.writing(in_turn=False):
            query = select(deliveries).where(deliveries.c.destination == destination)
            if self.database.row(query) is None:
                self.database.change(insert(deliveries).values(destination=destination, cursor=dict(cursor), **fresh))
            return Delivery(**self.database.rows(query)[0])

    def hold(self, destination: str, holder: str, now: datetime, until: datetime) -> Delivery | None:
        """Lease a destination to one process, or extend the lease; return None if another process has it.

        `holder` names the process and no other one. A hold that ended before `now` is free.
        """
        c = deliveries.c
        is_free = or_(c.holder.is_(None), c.holder == holder, passed_condition(c.held_until, now, until - now))
        is_destination = c.destination == destination
        take = update(deliveries).where(is_destination, is_free).values(holder=holder, held_until=until)
        with self.database.writing(in_turn=False):
            row = self.database.row(select(deliveries).where(is_destination)) if self.database.change(take) else None
            return None if row is None else Delivery(**row)

    def release(self, holder: str) -> None:
        """Release every destination that a process has leased."""
        self.database.change(
            update(deliveries).where(deliveries.c.holder == holder).values(holder=None, held_until=None)
        )

    def moved(self, destination: str, cursor: Cursor, delivered: int, holder: str | None = None) -> None:
        """Advance the cursor of a destination after the delivery of `delivered` events.

        Nothing is written where a given `holder` no longer holds it: the cursor of who does may be further.
        """
        values = {"cursor": dict(cursor), "delivered": deliveries.c.delivered + delivered}
        self._change(destination, values | {"failures": 0, "not_before": None, "error": ""}, holder)

    def failed(self, destination: str, error: str, not_before: datetime, holder: str | None = None) -> None:
        """Write that a try failed, and when the next one is due; `holder` as in `moved`."""
        values = {"failures": deliveries.c.failures + 1, "error": error, "not_before": not_before}
        self._change(destination, values, holder)

    def deliveries(self) -> list[Delivery]:
        return [Delivery(**row) for row in self.database.rows(select(deliveries).order_by(deliveries.c.destination))]

    def _change(self, destination: str, values: Mapping[str, object], holder: str | None) -> None:
        statement = update(deliveries).where(deliveries.c.destination == destination)
        if holder is not None:
            statement = statement.where(deliveries.c.holder == holder)
        self.database.change(statement.values(**values, changed_at=self.settings.clock()))


def cursor_text(cursor: Cursor) -> str:
    """Return a cursor as text for programs: `ORIGIN:SEQ` with dots between."""
    return ".".join(f"{origin}:{seq}" for origin, seq in sorted(cursor.items()))


def cursor_of(text: str) -> dict[str, int]:
    """Return the cursor of its text; "" is the beginning (`InputError`: softcal gave none such)."""
    pairs = [part.partition(":") for part in text.split(".")] if text else []
    if not all(origin.isalnum() and seq.isascii() and seq.isdigit() and len(seq) < 10 for origin, _, seq in pairs):
        raise InputError(f"cursor {text[:60]!r}: give what the last answer named `next`, or nothing for the beginning")
    return {origin: int(seq) for origin, _, seq in pairs}
