"""Durable work items of a lot: claimed under a lease, done once, and handed out again when a worker dies.

A worker that is killed loses nothing: its lease runs out and the item goes to the next one. An item is named by its
lot, kind, serial and input hash, so that asking twice for the same work makes one item.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import and_, func, insert, or_, select, update

from softcal.db.database import Database
from softcal.db.tables import work_items

MOST_ATTEMPTS = 3
"""An item whose workers died this often is failed: it would take down the next worker, too."""


@dataclass(frozen=True)
class WorkRequest:
    """What is to be done: one kind of work on one unit from one input."""

    serial: str
    input_sha256: str
    kind: str = "calibrate"


@dataclass(frozen=True)
class WorkItem:
    """A claimed item; `attempts` counts this one."""

    id: int
    lot_id: str
    serial: str
    kind: str
    input_sha256: str
    attempts: int


class WorkQueue:
    """The work items of a registry. Every call is one short transaction."""

    def __init__(self, database: Database, clock: Callable[[], datetime]) -> None:
        self._database, self._clock = database, clock

    def enqueue(self, lot_id: str, requests: Iterable[WorkRequest]) -> int:
        """Queue what is not queued, claimed or done yet and return how many items are new.

        An item that failed before is queued again: asking for it anew is a decision to retry.
        """
        new = 0
        with self._database.writing() as connection:
            for request in requests:
                named = {"lot_id": lot_id, **vars(request)}
                where = [work_items.c[name] == value for name, value in named.items()]
                state = connection.execute(select(work_items.c.state).where(*where)).scalar_one_or_none()
                fresh = {"state": "queued", "attempts": 0, "error": None, "changed_at": self._clock()}
                if state is None:
                    connection.execute(insert(work_items).values(**named, **fresh))
                elif state == "failed":
                    connection.execute(update(work_items).where(*where).values(**fresh))
                new += state in (None, "failed")
        return new

    def claim(self, owner: str, count: int, lease_s: float, *, lot_id: str | None = None) -> list[WorkItem]:
        """Take up to `count` items that nobody works on; they are this owner's until the lease runs out.

        Claimants never wait for one another: rows another one is just taking are passed over.
        """
        now, c = self._clock(), work_items.c
        is_free = or_(c.state == "queued", and_(c.state == "claimed", c.lease_until < now))
        query = select(c.id, c.lot_id, c.serial, c.kind, c.input_sha256, c.attempts).where(is_free)
        query = query if lot_id is None else query.where(c.lot_id == lot_id)
        with self._database.writing(in_turn=False) as connection:
            rows = connection.execute(query.order_by(c.id).limit(count).with_for_update(skip_locked=True)).all()
            given_up = [row.id for row in rows if row.attempts >= MOST_ATTEMPTS]
            taken = [row for row in rows if row.attempts < MOST_ATTEMPTS]
            error = f"{MOST_ATTEMPTS} workers died on it"
            failed = {"state": "failed", "error": error, "owner": None, "lease_until": None, "changed_at": now}
            connection.execute(update(work_items).where(c.id.in_(given_up)).values(**failed))
            lease_until = now + timedelta(seconds=lease_s)
            claimed = {"state": "claimed", "owner": owner, "lease_until": lease_until, "changed_at": now}
            mine = update(work_items).where(c.id.in_([row.id for row in taken]))
            connection.execute(mine.values(**claimed, attempts=c.attempts + 1))
        return [WorkItem(**{**row._mapping, "attempts": row.attempts + 1}) for row in taken]

    def extend(self, owner: str, item_ids: Iterable[int], lease_s: float) -> int:
        """Push the lease of one's own items further out; return how many are still one's own."""
        now = self._clock()
        return self._close(owner, item_ids, {"lease_until": now + timedelta(seconds=lease_s), "changed_at": now})

    def finish(self, owner: str, item_id: int, result: str) -> bool:
        """Mark an item done. False: the lease ran out and the item is another one's by now; drop the result."""
        done = {"state": "done", "result": result, "lease_until": None, "changed_at": self._clock()}
        return self._close(owner, [item_id], done) == 1

    def fail(self, owner: str, item_id: int, error: str) -> bool:
        """Mark an item failed with its reason; it is not tried again unless it is queued anew."""
        failed = {"state": "failed", "error": error, "lease_until": None, "changed_at": self._clock()}
        return self._close(owner, [item_id], failed) == 1

    def give_back(self, owner: str) -> int:
        """Queue all items of an owner that stops in order; the attempt does not count."""
        c = work_items.c
        values = {"state": "queued", "owner": None, "lease_until": None, "changed_at": self._clock()}
        mine = update(work_items).where(c.owner == owner, c.state == "claimed")
        with self._database.writing(in_turn=False) as connection:
            return connection.execute(mine.values(**values, attempts=c.attempts - 1)).rowcount

    def counts(self, lot_id: str | None = None) -> dict[str, int]:
        """Return how many items are queued, claimed, done and failed."""
        query = select(work_items.c.state, func.count()).group_by(work_items.c.state)
        query = query if lot_id is None else query.where(work_items.c.lot_id == lot_id)
        with self._database.reading() as connection:
            found = {str(state): int(count) for state, count in connection.execute(query)}
        return {state: found.get(state, 0) for state in ("queued", "claimed", "done", "failed")}

    def _close(self, owner: str, item_ids: Iterable[int], values: Mapping[str, object]) -> int:
        c = work_items.c
        mine = update(work_items).where(c.id.in_(list(item_ids)), c.owner == owner, c.state == "claimed")
        with self._database.writing(in_turn=False) as connection:
            return connection.execute(mine.values(**values)).rowcount
