"""Durable work items of a lot: claimed under a lease, gone when they are done, handed out again when a worker dies.

A queue and no record: what became of the work stands elsewhere, and nothing here is believed to be
a result. A worker that is killed loses nothing: its lease runs out and the item goes to the next
one. An item is named by its lot, kind, serial and input hash, so that asking twice for the same
work makes one item. Items that are asked for together, under the same settings, are one set; a
claimant takes items of its own set only.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from sqlalchemy import Select, and_, delete, func, select, text, update

from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.database import equality_conditions, parts
from softcal.db.schema.deadline import passed_condition
from softcal.db.schema.tables import work_items

MAX_ATTEMPTS = 3
"""An item whose workers died this often is failed: it would take down the next worker, too."""

MAX_LEASE = timedelta(hours=1)
STATES = ("queued", "claimed", "failed")
COUNTED = {"preserve_rowcount": True}
FREE = {"state": "queued", "owner": None, "lease_until": None}


@dataclass(frozen=True)
class WorkSet:
    """Items that are asked for together (`name`: hash of the settings that all of them share)."""

    lot_id: str
    name: str
    kind: str = "calibrate"


@dataclass(frozen=True)
class WorkItem:
    """An item of a set; `attempts` counts its claims."""

    id: int
    serial: str
    input_sha256: str
    attempts: int


class WorkQueue(RegistryBase):
    """The durable work items of a registry. Every call is one short transaction, or part of one."""

    def enqueue(self, work: WorkSet, inputs: Mapping[str, str]) -> int:
        """Queue the items that are not queued or claimed yet, and return how many are new.

        An item that failed before is queued again with its attempts reset: a new request is a decision to retry.
        Sets of the lot without a worker are deleted. Each few hundred items are a transaction of their
        own, so that other writers wait for milliseconds only.
        """
        now, c = self.settings.clock(), work_items.c
        identity = {"lot_id": work.lot_id, "kind": work.kind, "work_set": work.name}
        fresh = {**identity, **FREE, "attempts": 0, "changed_at": now}
        rows = [{**fresh, "serial": serial, "input_sha256": sha256} for serial, sha256 in inputs.items()]
        others = (c.lot_id == work.lot_id, c.kind == work.kind, c.work_set != work.name)
        alive = select(c.work_set).where(
            *others, c.state == "claimed", ~passed_condition(c.lease_until, now, MAX_LEASE)
        )
        with self.database.writing():
            self.database.change(delete(work_items).where(*others, c.work_set.not_in(alive)))
        # A dialect takes a tenth of a second to load: who only reads needs neither.
        if self.database.is_sqlite:
            from sqlalchemy.dialects.sqlite import insert
        else:
            from sqlalchemy.dialects.postgresql import insert  # type: ignore[assignment]

        insert_new, new = insert(work_items).on_conflict_do_nothing(), 0
        for part in parts(rows):
            with self.database.writing() as connection:
                new += connection.execute(insert_new, part, execution_options=COUNTED).rowcount
                serials = c.serial.in_([row["serial"] for row in part])
                failed = update(work_items).where(*_of(work), c.state == "failed", serials)
                new += self.database.change(failed.values(**FREE, attempts=0, changed_at=now))
                queued = update(work_items).where(*_of(work), c.state == "queued", c.attempts > 0, serials)
                self.database.change(queued.values(attempts=0))
        return new

    def claim(self, owner: str, work: WorkSet, count: int, lease_s: float) -> list[WorkItem]:
        """Claim up to `count` free items for this owner until the lease ends.

        Claimants never wait for one another: rows another one is just taking are passed over.
        """
        now, c = self.settings.clock(), work_items.c
        with self.database.writing(in_turn=False):
            if not self.database.is_sqlite:
                # The default is a spinning disk's: it would read the items of all lots.
                self.database.change(text("SET LOCAL random_page_cost = 1.1"))
            items = self._free(work, count, c.state == "queued")
            if len(items) < count:
                expired = and_(c.state == "claimed", passed_condition(c.lease_until, now, MAX_LEASE))
                items += self._free(work, count - len(items), expired)
            exhausted = [item.id for item in items if item.attempts >= MAX_ATTEMPTS]
            claimed = [item for item in items if item.attempts < MAX_ATTEMPTS]
            if exhausted:
                failed = {**FREE, "state": "failed"}
                self.database.change(update(work_items).where(c.id.in_(exhausted)).values(**failed, changed_at=now))
            if claimed:
                lease = {"state": "claimed", "owner": owner, "lease_until": now + timedelta(seconds=lease_s)}
                rows = update(work_items).where(c.id.in_([item.id for item in claimed]))
                self.database.change(rows.values(**lease, changed_at=now, attempts=c.attempts + 1))
        return [WorkItem(item.id, item.serial, item.input_sha256, item.attempts + 1) for item in claimed]

    def extend(self, owner: str, lease_s: float) -> int:
        """Extend the lease of all items of an owner; return how many the owner still has."""
        now, c = self.settings.clock(), work_items.c
        query = select(c.id).where(c.owner == owner, c.state == "claimed").with_for_update(skip_locked=True)
        with self.database.writing(in_turn=False):
            ids = self.database.values(query)
            for part in parts(ids):
                rows = update(work_items).where(c.id.in_(part))
                self.database.change(rows.values(lease_until=now + timedelta(seconds=lease_s), changed_at=now))
        return len(ids)

    def lock_leased(self, owner: str, item_ids: Iterable[int]) -> set[int]:
        """Return the items of an owner, which no other process can take before the transaction ends."""
        c = work_items.c
        query = select(c.id).where(c.id.in_(list(item_ids)), c.owner == owner, c.state == "claimed")
        with self.database.writing(in_turn=False):
            return set(self.database.values(query.order_by(c.id).with_for_update()))

    def finish(self, owner: str, item_ids: Sequence[int]) -> bool:
        """Remove finished items; return False if a lease ended or another owner has an item: drop its result."""
        c = work_items.c
        statement = delete(work_items).where(c.id.in_(item_ids), c.owner == owner, c.state == "claimed")
        return self.database.change(statement) == len(item_ids)

    def give_back(self, owner: str) -> int:
        """Queue all items of an owner that stops in order; the attempt does not count."""
        return self._free_again(owner, attempts=work_items.c.attempts - 1)

    def take_back(self, owner: str) -> int:
        """Queue all items of a dead owner again, without waiting for the end of its lease."""
        return self._free_again(owner)

    def owners(self, work: WorkSet) -> list[str]:
        """Return the owners of items of a work."""
        owner = work_items.c.owner
        query = select(owner).where(*_of(work), work_items.c.state == "claimed").distinct().order_by(owner)
        return self.database.values(query)

    def exhausted_items(self, work: WorkSet) -> list[WorkItem]:
        """Return the items of a set whose workers died too often."""
        c = work_items.c
        query = select(c.id, c.serial, c.input_sha256, c.attempts).where(*_of(work), c.state == "failed")
        return [WorkItem(*row.values()) for row in self.database.rows(query.order_by(c.id))]

    def counts(self, lot_id: str | None = None, work: WorkSet | None = None) -> dict[str, int]:
        """Return how many items are queued, claimed and failed: of a work, of a lot, or of all."""
        c = work_items.c
        query: Select[Any] = select(c.state, func.count().label("items")).group_by(c.state)
        query = query.where(*equality_conditions((c.lot_id, lot_id)), *(() if work is None else _of(work)))
        return dict.fromkeys(STATES, 0) | {row["state"]: row["items"] for row in self.database.rows(query)}

    def _free(self, work: WorkSet, count: int, condition: Any) -> list[WorkItem]:
        c = work_items.c
        query = select(c.id, c.serial, c.input_sha256, c.attempts).where(*_of(work), condition)
        free = query.order_by(c.id).limit(count).with_for_update(skip_locked=True)
        return [WorkItem(*row) for row in self.database.tuples(free)]

    def _free_again(self, owner: str, **more: Any) -> int:
        c = work_items.c
        statement = update(work_items).where(c.owner == owner, c.state == "claimed")
        return self.database.change(statement.values(**FREE, **more, changed_at=self.settings.clock()))


def _of(work: WorkSet) -> tuple[Any, ...]:
    c = work_items.c
    return c.lot_id == work.lot_id, c.kind == work.kind, c.work_set == work.name
