"""Leased work items of a process: a thread extends the lease, and the end releases it."""

import os
import socket
import threading
import uuid

from softcal.app.bootstrap import is_alive
from softcal.core.errors import RegistryError
from softcal.db.queues.work_queue import WorkItem, WorkSet
from softcal.db.registry import Registry

LEASE_S = 60.0
"""A dead process on another machine is noticed after this time; one of this machine at once."""

EXTEND_EVERY_S = 10.0


class Claims:
    """Items of one set, claimed by this process; used as a context manager."""

    def __init__(self, registry: Registry, work: WorkSet) -> None:
        self._registry, self.work = registry, work
        self.queue = registry.work_queue
        self.owner = f"{socket.gethostname()}:{os.getpid()}:{uuid.uuid4().hex[:8]}"
        self._ended = threading.Event()
        self._lease_thread = threading.Thread(target=self._extend_leases, daemon=True)

    def __enter__(self) -> "Claims":
        # An SQLite registry in memory has one connection, which no thread can share.
        if not self._registry.database.is_in_memory:
            self._lease_thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()
        if self._lease_thread.is_alive():
            self._lease_thread.join()
        self.queue.give_back(self.owner)

    def take(self, count: int) -> list[WorkItem]:
        """Claim up to `count` items; without free items, release and claim those of dead processes."""
        items = self.queue.claim(self.owner, self.work, count, LEASE_S)
        if not items and self.take_back_from_dead():
            items = self.queue.claim(self.owner, self.work, count, LEASE_S)
        return items

    def take_back_from_dead(self) -> int:
        """Release the items of dead processes of this machine; return their number."""
        if os.name != "posix":
            return 0  # Nobody may ask there without harm: leases tell.
        owners = self.queue.owners(self.work)
        return sum(self.queue.take_back(owner) for owner in owners if is_alive(owner.rpartition(":")[0]) is False)

    def _extend_leases(self) -> None:
        while not self._ended.wait(EXTEND_EVERY_S):
            try:
                self.queue.extend(self.owner, LEASE_S)
            except RegistryError:
                # It may be back before the lease ends; whoever writes a result sees the trouble.
                continue
