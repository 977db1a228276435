"""The resident process of a station: takes orders from the registry, writes what happens.

Pages and commands only order and read. The ports have one owner: this process.
"""

import os
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Protocol

from softcal.app.bootstrap import is_alive
from softcal.core.errors import InputError, RegistryError, SoftcalError
from softcal.core.messages.reason import Reason, reason
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.known_loads import ordered_load
from softcal.db.queues.order_queue import TAKEOVER_AFTER, OrderQueue
from softcal.db.schema.deadline import is_silent
from softcal.station.record.recording import StationRecording
from softcal.station.tasks.at_rest import RestReading
from softcal.station.tasks.service import StationService

if TYPE_CHECKING:
    from softcal.app.line.pressed_run import RunStore

HEARTBEAT_S = 1.0
REPORT_S = 0.2
IDLE_S = 0.2
"""Between two looks for an order; one transaction each."""

STOP_POLL_S = 0.03
"""Between two looks for a stop in a run. A look only reads: it waits for nobody who writes."""

MAX_MISSED_HEARTBEATS = 3
"""An owner whose heartbeat stands still for so many beats is gone, whatever its clock says."""

LISTEN_S = 0.01
"""How long the devices are listened to at every such look."""

INTERRUPTED = Reason("run.interrupted")


class Fixture(Protocol):
    """Holder of the unit: a person on a real station, a program on the simulated one. The default is the person."""

    def mount(self, serial: str) -> None:
        """Put the unit of this serial into the fixture."""
        return None

    def put_on(self, load: float) -> None:
        """Put a known load on the unit, in its lot's reference unit; 0 removes all loads."""
        return None

    def follow(self, phase: str) -> None:
        """Receive the phase of a run."""
        return None

    def inject(self, name: str) -> Reason:
        """Inject a fault, and return a description of it."""
        ...


class ManualFixture(Fixture):
    """A person puts the unit in and the loads on; nothing breaks on demand."""

    def inject(self, name: str) -> Reason:
        """Refuse: a real station breaks by itself."""
        raise InputError(Reason("fault.real"))


class StationHost:
    """A station joined with its registry.

    A thread of its own, the desk, writes heartbeat and progress and answers. A slow or absent
    registry never keeps the service from watching force and travel. Another one, the ear, only
    reads whether somebody said stop: a desk that waits for its turn to write does not keep a stop
    waiting.

    Args:
        override: takes an engineer's decision to open the gate: who and why.
        make_service: the service for its two hooks, progress and stop; `run` starts it.
    """

    def __init__(
        self,
        queue: OrderQueue,
        station: str,
        run_store: "RunStore",
        override: Callable[[str, str], None],
        make_service: Callable[[Callable[[Progress], None], Callable[[], bool]], StationService],
        fixture: Fixture | None = None,
        log: Callable[[str, dict[str, object]], None] | None = None,
    ) -> None:
        self._queue, self._station, self._run_store, self._override = queue, station, run_store, override
        self._fixture = fixture or ManualFixture()
        self._log = log or (lambda event, details: None)
        self._process = f"{socket.gethostname()}:{os.getpid()}"
        self._active = ""
        self._newest: Progress | None = None
        self._is_stop_requested, self._is_over = threading.Event(), threading.Event()
        self._takeover_reason: Reason | None = None
        self._report_lock = threading.Lock()
        self._unstored: list[tuple[Order, StationRecording | RestReading]] = []
        self._pending_reports: list[Progress] = []
        self._service = make_service(self._report, self._is_stop_requested.is_set)

    def run(self, should_run: Callable[[], bool]) -> None:
        """Serve until `should_run` returns False; then stop the run and release the ports.

        Raises:
            InputError: another process serves this station.
        """
        self._send_heartbeat(self._takeover_timeout())
        self._queue.interrupt(self._station, INTERRUPTED)
        threads = (
            threading.Thread(target=self._report_progress, name="station desk", daemon=True),
            threading.Thread(target=self._poll_stop, args=(should_run,), name="station ear", daemon=True),
        )
        for thread in threads:
            thread.start()
        try:
            self._service.start()
            while should_run() and not self._takeover_reason:
                order = None
                try:
                    self._service.poll_idle(LISTEN_S)
                    self._service.settle()
                    self._store_recordings()
                    order = self._queue.take(self._station)
                except RegistryError:
                    pass  # The registry is away: nothing new is started, nothing is lost.
                if order is None:
                    time.sleep(IDLE_S)
                elif order.kind is OrderKind.ACKNOWLEDGE or order.kind.is_run:
                    self._perform(order)
                else:
                    self._answer(order)
        finally:
            self._service.close()
            self._is_over.set()
            for thread in threads:
                thread.join()
        if self._takeover_reason:
            raise InputError(self._takeover_reason)
        self._send_heartbeat()

    def _takeover_timeout(self) -> timedelta:
        """Return the time for which another owner must have been silent: none if its process is gone.

        An owner that seems silent may be busy, or have another clock: while its heartbeat changes, it is alive.
        """
        before = self._queue.heartbeat(self._station)
        if before is None or before.state is StationState.OFF or before.process == self._process:
            return TAKEOVER_AFTER
        if is_alive(before.process) is False:
            return timedelta(0)
        if not is_silent(before.at, datetime.now(UTC), TAKEOVER_AFTER):
            raise InputError(reason("station.served", station=repr(self._station), process=before.process))
        end_s = time.monotonic() + MAX_MISSED_HEARTBEATS * HEARTBEAT_S
        while time.monotonic() < end_s:
            now = self._queue.heartbeat(self._station)
            if now is not None and now.at != before.at and now.process == before.process:
                raise InputError(reason("station.served", station=repr(self._station), process=now.process))
            time.sleep(IDLE_S)
        return TAKEOVER_AFTER

    def _perform(self, order: Order) -> None:
        self._is_stop_requested.clear()
        self._active = order.order_id
        try:
            self._run_store.check(order)
            if order.kind is OrderKind.LOAD:
                self._fixture.put_on(ordered_load(order.reason)[1])
            else:
                self._fixture.mount(order.serial)
            recording = self._service.perform(order)
            if recording is not None:
                self._unstored.append((order, recording))
                self._store_recordings()
        except InputError as error:
            self._report(Progress(order.order_id, RunState.ERROR, "", 1.0, code="E-ORDER", message=(error.reason,)))
        except RegistryError as error:
            if not self._unstored:
                self._report(Progress(order.order_id, RunState.ERROR, code="E-REGISTRY", message=(error.reason,)))
        except Exception as error:  # The line must go on: a defect ends this run alone.
            self._report(self._defect(order, error))
        finally:
            with self._report_lock:
                self._active, self._newest = "", None

    def _defect(self, order: Order, error: Exception) -> Progress:
        self._log("defect", {"order": order.order_id, "error": repr(error), "exc_info": error})
        message = reason("run.defect", kind=type(error).__name__)
        return Progress(order.order_id, RunState.ERROR, "", 1.0, code="E-INTERNAL", message=(message,))

    def _store_recordings(self) -> None:
        """Store a recording; a recording that the registry cannot take is stored later."""
        while self._unstored:
            order, recording = self._unstored[0]
            try:
                progress = self._run_store.store(order, recording, self._report)
            except InputError as error:
                progress = Progress(order.order_id, RunState.ERROR, code="E-RECORDING", message=(error.reason,))
            except RegistryError:
                raise
            except Exception as error:
                progress = self._defect(order, error)
            self._unstored.pop(0)
            if progress.recording_sha256:
                self._service.spool_path(order).unlink(missing_ok=True)
            self._pending_reports.append(progress)
        self._send_reports()

    def _report(self, progress: Progress) -> None:
        """Write the progress of the service; the end of a run is written at once."""
        if progress.state.is_active:
            self._fixture.follow(progress.phase)
            before = self._newest
            fraction = before.fraction if before is not None and before.order_id == progress.order_id else 0.0
            # Training and calibrating follow the run: what is done stays done.
            self._newest = replace(progress, fraction=max(fraction, progress.fraction))
            return
        self._pending_reports.append(progress)
        try:
            self._send_reports()
        except RegistryError:
            pass  # Said again at every turn: until then the order occupies its station.

    def _send_reports(self) -> None:
        with self._report_lock:
            # From here on a new order may come: it is not for the desk.
            self._active, self._newest = "", None
        if self._pending_reports:
            # First that the station stands still, then why: nobody may press a key too early.
            self._send_heartbeat_or_stop()
        while self._pending_reports:
            progress = self._pending_reports[0]
            self._queue.report(progress)
            self._pending_reports.pop(0)
            self._log("order", {"order": progress.order_id, "state": progress.state, "message": progress.text})

    def _poll_stop(self, should_run: Callable[[], bool]) -> None:
        while not self._is_over.wait(STOP_POLL_S):
            if not should_run():
                self._is_stop_requested.set()
            try:
                if self._active and self._queue.has_stop(self._station):
                    # The stage is told first.
                    self._is_stop_requested.set()
                    if order := self._queue.take(self._station, only=OrderKind.STOP):
                        self._answer_order(order, RunState.DONE, Reason("run.stopping"))
            except SoftcalError:
                continue  # Away for a moment: the next look tries again.

    def _report_progress(self) -> None:
        sent_s = 0.0
        while not self._is_over.wait(REPORT_S):
            try:
                with self._report_lock:
                    if self._newest is not None:
                        self._queue.report(self._newest)
                    if self._active:
                        self._listen()
                if time.monotonic() - sent_s >= HEARTBEAT_S:
                    sent_s = time.monotonic()
                    self._send_heartbeat_or_stop()
            except SoftcalError:
                continue  # Away for a moment: the next turn tries again.
            if self._takeover_reason:
                return

    def _listen(self) -> None:
        order = self._queue.take(self._station)
        if order is None:
            return
        if order.kind is OrderKind.ACKNOWLEDGE:
            self._answer_order(order, RunState.DONE, Reason("run.in_progress"))
        elif order.kind is OrderKind.STOP:
            self._is_stop_requested.set()
            self._answer_order(order, RunState.DONE, Reason("run.stopping"))
        else:
            self._answer(order)

    def _answer(self, order: Order) -> None:
        try:
            match order.kind:
                case OrderKind.STOP:
                    cancelled = self._queue.cancel_queued(self._station, Reason("run.cancelled"))
                    self._answer_order(
                        order, RunState.DONE, Reason("run.cancelled") if cancelled else Reason("run.none")
                    )
                case OrderKind.OVERRIDE:
                    self._override(order.actor, order.reason)
                    self._answer_order(order, RunState.DONE, Reason("run.opened"))
                case OrderKind.FAULT:
                    self._answer_order(order, RunState.DONE, self._fixture.inject(order.reason))
        except InputError as error:
            self._answer_order(order, RunState.ERROR, error.reason)

    def _answer_order(self, order: Order, state: RunState, message: Reason) -> None:
        code = "" if state is RunState.DONE else "E-ORDER"
        self._queue.report(Progress(order.order_id, state, "", 1.0, code=code, message=(message,)))

    def _send_heartbeat_or_stop(self) -> None:
        """Write a heartbeat; of two owners of a station, the one that was silent too long ends."""
        try:
            self._send_heartbeat()
        except InputError as error:
            self._takeover_reason = reason("station.lost", why=error.reason)
            self._is_stop_requested.set()

    def _send_heartbeat(self, after: timedelta = TAKEOVER_AFTER) -> None:
        service = self._service
        is_off = service.state is StationState.OFF
        self._queue.write_heartbeat(
            Heartbeat(
                self._station,
                service.state,
                datetime.now(UTC),
                () if is_off else service.reasons,
                self._process,
                self._active,
                () if is_off else service.gate.conditions,
                not is_off and service.gate.is_overridden,
            ),
            after,
        )
