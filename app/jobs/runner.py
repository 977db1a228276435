"""Jobs of programs: a few processes at once, the others wait in their order.

The queue is the job board; this holds only what this server was asked to start.
"""

import threading
from collections import deque
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial

from softcal.app.jobs import launch
from softcal.core.errors import SoftcalError
from softcal.core.orders import RunState
from softcal.db.queues.job_board import MAX_WAITING, START_WITHIN
from softcal.db.registry import Registry

MAX_RUNNING = 2
"""Processes of one server at once; the station at this machine comes first."""


class JobRunner:
    """Starts jobs in their order, `MAX_RUNNING` at once; safe to be called from any thread."""

    def __init__(self, registry: Registry) -> None:
        self._board = registry.job_board
        self._waiting: deque[str] = deque()
        self._running: set[str] = set()
        self._timer: threading.Timer | None = None
        # A process may end before its start has returned.
        self._lock = threading.RLock()

    def submit(self, job_id: str) -> None:
        """Start a job now, or after others have ended; a job that was taken already is unchanged."""
        with self._lock:
            if job_id in self._running or job_id in self._waiting:
                return
            job = self._board.job(job_id)
            if job.state is RunState.QUEUED:
                self._waiting.append(job_id)
                self._start()

    def adopt(self) -> None:
        """Take over the jobs of an ended server, the oldest first."""
        now = datetime.now(UTC)
        for job in reversed(self._board.jobs("calibrate", count=2 * MAX_WAITING)):
            if job.state is RunState.QUEUED and job.is_lost(now):
                self.submit(job.job_id)

    def _start(self) -> None:
        try:
            while self._waiting and len(self._running) < MAX_RUNNING:
                is_open = self._board.job(self._waiting[0]).state is RunState.QUEUED
                job_id = self._waiting.popleft()
                if is_open:
                    self._running.add(job_id)
                    launch.launch(job_id, partial(self._end, job_id))
        finally:
            if self._waiting and self._timer is None:
                self._timer = threading.Timer(START_WITHIN.total_seconds() / 3, self._send_heartbeats)
                self._timer.daemon = True
                self._timer.start()

    def _end(self, job_id: str) -> None:
        # Where the registry is away for a moment, the next beat goes on.
        with self._lock, suppress(SoftcalError):
            self._running.discard(job_id)
            if self._board.job(job_id).state is RunState.QUEUED:
                self._board.end(job_id, RunState.ERROR, "its process ended before it began; jobs.log says why")
            self._start()

    def _send_heartbeats(self) -> None:
        """Write a heartbeat for waiting jobs, so that they do not count as lost."""
        with self._lock, suppress(SoftcalError):
            self._timer = None
            try:
                for job_id in self._waiting:
                    self._board.write_heartbeat(job_id)
            finally:
                self._start()
