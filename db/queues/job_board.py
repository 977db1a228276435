"""Jobs: long computations that a page requests and another process performs, one row each.

Page and process need not know, nor outlive, each other.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

from sqlalchemy import RowMapping, Select, func, insert, select, update

from softcal.core.errors import InputError, NoSuchJob
from softcal.core.orders import ACTIVE, RunState
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.arrays import get_arrays, put_arrays
from softcal.db.schema.database import equality_conditions
from softcal.db.schema.deadline import MAX_CLOCK_ERROR, is_silent
from softcal.db.schema.tables import jobs

if TYPE_CHECKING:
    from softcal.db.schema.arrays import Arrays

JOB_SILENT_AFTER = timedelta(seconds=15)
"""A running job whose process gave no sign of life for longer is dead."""

START_WITHIN = timedelta(seconds=90)
"""A process that has not taken its job by then never will; imports take seconds when busy."""

MAX_WAITING = 16
"""Jobs of programs that wait at most: who asks for more is told to ask later."""

BRIEF = [jobs.c[name] for name in ("job_id", "kind", "request", "actor", "created", "state", "fraction", "message",
                                   "is_cancel_wanted", "beaten_at")]  # fmt: skip


class QueueFull(InputError):
    """So many jobs wait that no other one is taken."""


@dataclass(frozen=True)
class Job:
    """One job.

    Args:
        kind: what is computed, a name the worker knows.
        request: JSON values it is computed from.
        actor, created: who asked, and when (UTC).
        fraction: 0 ... 1.
        message: what happens now; on an error one line that says what to do.
        beaten_at: last sign of life of its process, UTC.
        trace: live values for a chart, by name; empty in lists.
        result: JSON values; empty until it is done, and in lists.
        blob_sha256: its arrays, where it made some.
    """

    job_id: str
    kind: str
    request: Mapping[str, Any]
    actor: str
    created: datetime
    state: RunState
    fraction: float
    message: str
    is_cancel_wanted: bool
    beaten_at: datetime
    trace: Mapping[str, Any]
    result: Mapping[str, Any]
    blob_sha256: str | None = None

    def is_lost(self, now: datetime) -> bool:
        """Whether its process has died, or was never there."""
        timeout = START_WITHIN if self.state is RunState.QUEUED else JOB_SILENT_AFTER
        return self.state.is_active and is_silent(self.beaten_at, now, timeout)


class JobBoard(RegistryBase):
    """Repository of jobs; every call is one short transaction."""

    def place(self, kind: str, request: Mapping[str, Any], actor: str, job_id: str | None = None) -> str:
        """Request a computation and return its id (32 characters); a given id makes a repeated request one job."""
        now, job_id = self.settings.clock(), job_id or uuid.uuid4().hex
        values = {"job_id": job_id, "kind": kind, "request": dict(request), "actor": actor, "created": now}
        fresh = {"state": RunState.QUEUED, "fraction": 0.0, "message": "", "trace": {}, "result": {}}
        with self.database.writing(in_turn=False):
            if self.database.row(select(jobs.c.job_id).where(jobs.c.job_id == job_id)) is None:
                self.database.change(insert(jobs).values(**values, **fresh, is_cancel_wanted=False, beaten_at=now))
        return job_id

    def place_bounded(self, kind: str, request: Mapping[str, Any], actor: str, job_id: str | None = None) -> str:
        """Ask as `place` does (`QueueFull`: `MAX_WAITING` jobs wait already)."""
        now = self.settings.clock()
        in_time = jobs.c.beaten_at.between(now - START_WITHIN, now + MAX_CLOCK_ERROR)
        waiting = select(func.count()).where(jobs.c.state == RunState.QUEUED, in_time)
        with self.database.writing():
            if (count := self.database.value(waiting)) >= MAX_WAITING:
                raise QueueFull(f"{count} jobs wait, {MAX_WAITING} may; ask again later; nothing was done")
            return self.place(kind, request, actor, job_id)

    def take(self, job_id: str) -> Job:
        """Mark a queued job running and return it; raise `InputError` if no job waits under this id."""
        queued = update(jobs).where(jobs.c.job_id == job_id, jobs.c.state == RunState.QUEUED)
        if not self.database.change(queued.values(state=RunState.RUNNING, beaten_at=self.settings.clock())):
            raise InputError(f"job {job_id!r} is not waiting to be done")
        return self.job(job_id)

    def report(self, job_id: str, fraction: float, message: str, trace: Mapping[str, Any] | None = None) -> None:
        """Write the progress of a job; a finished job stays as it ended."""
        values = {"fraction": fraction, "message": message} | ({} if trace is None else {"trace": dict(trace)})
        self._change(job_id, values)

    def write_heartbeat(self, job_id: str) -> bool:
        """Write a heartbeat, and return whether a stop was requested."""
        self._change(job_id, {})
        return bool(self.database.value(select(jobs.c.is_cancel_wanted).where(jobs.c.job_id == job_id)))

    def end(
        self,
        job_id: str,
        state: RunState,
        message: str,
        result: Mapping[str, Any] | None = None,
        arrays: Arrays | None = None,
    ) -> None:
        """Write how a job ended, once."""
        with self.database.writing(in_turn=False):
            blob = None if arrays is None else put_arrays(self.database, arrays)
            values = {"state": state, "message": message, "result": dict(result or {}), "blob_sha256": blob}
            self._change(job_id, values | ({"fraction": 1.0} if state is RunState.DONE else {}))

    def cancel(self, job_id: str) -> None:
        """Request a stop; a job that no process has taken, or whose process has died, ends at once."""
        job = self.job(job_id)
        if job.state is RunState.QUEUED or job.is_lost(self.settings.clock()):
            self.end(job_id, RunState.CANCELLED, "cancelled")
        else:
            self._change(job_id, {"is_cancel_wanted": True}, with_heartbeat=False)

    def job(self, job_id: str) -> Job:
        """Return one job with its trace and result; raise `InputError` for an unknown id."""
        job = self.find(job_id)
        if job is None:
            raise NoSuchJob(f"job {job_id!r} is not in the registry")
        return job

    def find(self, job_id: str) -> Job | None:
        """Return one job with its trace and result, or None for an unknown id."""
        row = self.database.row(select(jobs).where(jobs.c.job_id == job_id))
        return None if row is None else _job(row)

    def jobs(self, kind: str | None = None, count: int = 20, before: int = 0) -> list[Job]:
        """Return `count` jobs behind the newest `before`, newest first, without traces and results."""
        query: Select[Any] = select(*BRIEF).where(*equality_conditions((jobs.c.kind, kind)))
        newest = query.order_by(jobs.c.created.desc(), jobs.c.job_id).limit(count).offset(before)
        return [_job(row) for row in self.database.rows(newest)]

    def arrays(self, job: Job) -> Arrays:
        """Return the arrays of a job; none without arrays."""
        if job.blob_sha256 is None:
            return {}
        with self.database.reading():
            return get_arrays(self.database, job.blob_sha256)

    def _change(self, job_id: str, values: Mapping[str, Any], *, with_heartbeat: bool = True) -> None:
        heartbeat = {"beaten_at": self.settings.clock()} if with_heartbeat else {}
        open_job = update(jobs).where(jobs.c.job_id == job_id, jobs.c.state.in_(ACTIVE))
        self.database.change(open_job.values(**values, **heartbeat))


def _job(row: RowMapping) -> Job:
    values = {"trace": {}, "result": {}} | dict(row)
    return Job(**values | {"state": RunState(row["state"])})
