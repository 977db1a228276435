"""The resident process of a station: takes orders from the registry, gives them to the service, writes what happens.

Pages and commands only order and read. The ports have one owner, this process; it survives any of them.
"""

import os
import socket
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime

from softcal.app.workflow.station_gate import check_golden
from softcal.core.errors import InputError, RegistryError, SoftcalError
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.station_gate import Gate
from softcal.db.registry import Registry
from softcal.station.recording import StationRecording
from softcal.station.service import Hooks, StationService

BEAT_S = 1.0
REPORT_S = 0.2
IDLE_S = 0.2
"""Between two looks for an order; one transaction each."""


class StationHost:
    """One station and its registry, joined.

    A thread of its own, the desk, writes heartbeat and progress and listens for a stop: a slow or absent registry
    never keeps the service from watching force and travel.

    Args:
        registry: where orders come from and recordings go.
        station: name of the station.
        gate: whether an order of a kind may run now.
        make_service: the service for these hooks; it is started by `run`.
    """

    def __init__(
        self,
        registry: Registry,
        station: str,
        gate: Callable[[OrderKind], Gate],
        make_service: Callable[[Hooks], StationService],
    ) -> None:
        self._registry, self._queue, self._station = registry, registry.order_queue, station
        self._process = f"{socket.gethostname()}:{os.getpid()}"
        self._active = ""
        self._newest: Progress | None = None
        self._is_stop_wanted, self._is_over = threading.Event(), threading.Event()
        self._at_desk = threading.Lock()
        self._late: list[tuple[Order, StationRecording]] = []
        self._service = make_service(Hooks(self._report, self._is_stop_wanted.is_set, gate))

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Serve until `goes_on` says no; then give the ports back.

        Raises:
            InputError: another process serves this station.
        """
        self._beat()
        self._queue.interrupt(self._station, "the station's service was started again; press the unit again")
        desk = threading.Thread(target=self._keep_desk, name="station desk", daemon=True)
        desk.start()
        try:
            self._service.start()
            while goes_on():
                self._turn()
        finally:
            self._service.close()
            self._is_over.set()
            desk.join()
            self._beat()

    def _turn(self) -> None:
        """Do one order, or wait a moment for one."""
        order = None
        try:
            self._service.settle()
            self._store_late()
            order = self._queue.take(self._station)
        except RegistryError:
            pass  # The registry is away: nothing new is started, nothing is lost.
        if order is None:
            time.sleep(IDLE_S)
        elif order.kind is OrderKind.STOP:
            self._say(Progress(order.order_id, RunState.DONE, message="nothing was running"))
        else:
            self._perform(order)

    def _perform(self, order: Order) -> None:
        self._is_stop_wanted.clear()
        self._active = order.order_id
        try:
            recording = self._service.perform(order)
            if recording is not None:
                self._late.append((order, recording))
        except RegistryError as error:
            self._report(Progress(order.order_id, RunState.ERROR, code="E-REGISTRY", message=str(error)))
        finally:
            with self._at_desk:
                self._active, self._newest = "", None

    def _store_late(self) -> None:
        """Store what was recorded; what the registry cannot take now is tried again at every turn.

        Raises:
            RegistryError: the registry is away; the recording is kept here and in its spool.
        """
        while self._late:
            order, recording = self._late[0]
            try:
                progress = self._stored(order, recording)
            except InputError as error:
                progress = Progress(order.order_id, RunState.ERROR, code="E-RECORDING", message=str(error))
            self._queue.report(progress)
            self._late.pop(0)
            if progress.recording_sha256:
                self._service.spool_path(order).unlink(missing_ok=True)

    def _stored(self, order: Order, recording: StationRecording) -> Progress:
        sha256, message = "", "recorded"
        if order.lot_id:
            kind, value = _kind_and_value(order, recording)
            sha256 = self._registry.add_recording(order.lot_id, value, kind, actor=order.actor or None)
        if order.kind is OrderKind.GOLDEN:
            run = check_golden(self._registry, self._station, recording.labelled_recording(), order.actor)
            message = "golden unit within its limits" if run.passed else "; ".join(run.reasons)
        return Progress(order.order_id, RunState.DONE, "done", 1.0, message=message, recording_sha256=sha256)

    def _report(self, progress: Progress) -> None:
        """Take progress from the service; the end of a run is written at once, all else by the desk."""
        if progress.state.is_active:
            self._newest = progress
            return
        with self._at_desk:
            # From here on a new order may come: it is not for the desk.
            self._active, self._newest = "", None
        self._say(progress)

    def _say(self, progress: Progress) -> None:
        try:
            self._queue.report(progress)
        except RegistryError:
            pass  # A run goes on without its screen.

    def _keep_desk(self) -> None:
        beaten_s = time.monotonic()
        while not self._is_over.wait(REPORT_S):
            try:
                with self._at_desk:
                    self._attend()
                if time.monotonic() - beaten_s >= BEAT_S:
                    beaten_s = time.monotonic()
                    self._beat()
            except SoftcalError:
                continue  # Away for a moment: the next turn tries again.

    def _attend(self) -> None:
        if self._newest is not None:
            self._queue.report(self._newest)
        if self._active:
            self._listen()

    def _listen(self) -> None:
        """Take what a person says during a run: a stop, or an acknowledgement that comes too early."""
        order = self._queue.take(self._station)
        if order is None:
            return
        is_stop = order.kind is OrderKind.STOP
        message = "the run is being stopped" if is_stop else "a run is in progress; nothing to acknowledge"
        if is_stop:
            self._is_stop_wanted.set()
        self._queue.report(Progress(order.order_id, RunState.DONE, message=message))

    def _beat(self) -> None:
        service = self._service
        self._queue.beat(
            Heartbeat(self._station, service.state, datetime.now(UTC), service.reasons, self._process, self._active)
        )


def _kind_and_value(order: Order, recording: StationRecording) -> tuple[str, OutputRecording | LabelledRecording]:
    if recording.force_N is None:
        return "unit", recording.output_recording()
    return "source" if order.kind is OrderKind.SOURCE else "audit", recording.labelled_recording()
