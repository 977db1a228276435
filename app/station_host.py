"""The resident process of a station: takes orders from the registry, gives them to the service, writes what happens.

Pages and commands only order and read. The ports have one owner, this process; it survives any of them.
"""

import os
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
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
REPORT_S = 0.25
IDLE_S = 0.2
"""Between two looks for an order; one transaction each."""


@dataclass
class StationHost:
    """One station and its registry, joined.

    Args:
        registry: where orders come from and recordings go.
        station: name of the station.
        gate: whether an order of a kind may run now.
        make_service: the service for these hooks; it is started here.
    """

    registry: Registry
    station: str
    gate: Callable[[OrderKind], Gate]
    make_service: Callable[[Hooks], StationService]

    def __post_init__(self) -> None:
        self._process = f"{socket.gethostname()}:{os.getpid()}"
        self._beaten_s = self._reported_s = self._asked_s = float("-inf")
        self._active = self._last_phase = ""
        self._late: list[tuple[Order, StationRecording]] = []
        self._service = self.make_service(Hooks(self._report, self._is_stop_wanted, self.gate))

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Serve until `goes_on` says no; then give the ports back.

        Raises:
            InputError: another process serves this station.
        """
        queue = self.registry.order_queue
        self._beat(at_once=True)
        queue.interrupt(self.station, "the station's service was started again; press the unit again")
        try:
            self._service.start()
            while goes_on():
                self._turn()
        finally:
            self._service.close()
            self._beat(at_once=True)

    def _turn(self) -> None:
        """Do one order, or wait a moment for one."""
        self._service.settle()
        try:
            self._beat()
            self._store_late()
            order = self.registry.order_queue.take(self.station)
        except RegistryError:
            order = None  # The registry is away: nothing new is started, nothing is lost.
        if order is None:
            time.sleep(IDLE_S)
        elif order.kind is OrderKind.STOP:
            self._say(Progress(order.order_id, RunState.DONE, message="nothing was running"))
        else:
            self._perform(order)

    def _perform(self, order: Order) -> None:
        self._active = order.order_id
        try:
            recording = self._service.perform(order)
            if recording is not None:
                self._late.append((order, recording))
        except RegistryError:
            pass  # The run itself reported this; its samples are in the spool.
        except SoftcalError as error:
            self._say(Progress(order.order_id, RunState.ERROR, code="E-RECORDING", message=str(error)))
        finally:
            self._active = ""

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
            self.registry.order_queue.report(progress)
            self._late.pop(0)

    def _stored(self, order: Order, recording: StationRecording) -> Progress:
        sha256, message = "", "recorded"
        if order.lot_id:
            kind, value = _kind_and_value(order, recording)
            sha256 = self.registry.add_recording(order.lot_id, value, kind, actor=order.actor or None)
        if order.kind is OrderKind.GOLDEN:
            run = check_golden(self.registry, self.station, recording.labelled_recording(), order.actor)
            message = "golden unit within its limits" if run.passed else "; ".join(run.reasons)
        return Progress(order.order_id, RunState.DONE, "done", 1.0, message=message, recording_sha256=sha256)

    def _report(self, progress: Progress) -> None:
        """Write progress at most a few times a second; the end of a run and a new phase at once."""
        now_s = time.monotonic()
        is_new = progress.phase != self._last_phase or not progress.state.is_active
        if not is_new and now_s - self._reported_s < REPORT_S:
            return
        self._reported_s, self._last_phase = now_s, progress.phase
        self._say(progress)

    def _say(self, progress: Progress) -> None:
        try:
            self.registry.order_queue.report(progress)
            self._beat()
        except RegistryError:
            pass  # A run goes on without its screen.

    def _is_stop_wanted(self) -> bool:
        if time.monotonic() - self._asked_s < REPORT_S:
            return False
        self._asked_s = time.monotonic()
        try:
            order = self.registry.order_queue.take(self.station)
        except RegistryError:
            return False
        if order is None:
            return False
        is_stop = order.kind is OrderKind.STOP
        message = "the run is being stopped" if is_stop else "a run is in progress; nothing to acknowledge"
        self._say(Progress(order.order_id, RunState.DONE, message=message))
        return is_stop

    def _beat(self, at_once: bool = False) -> None:
        if not at_once and time.monotonic() - self._beaten_s < BEAT_S:
            return
        self._beaten_s = time.monotonic()
        service = self._service
        self.registry.order_queue.beat(
            Heartbeat(self.station, service.state, datetime.now(UTC), service.reasons, self._process, self._active)
        )


def _kind_and_value(order: Order, recording: StationRecording) -> tuple[str, OutputRecording | LabelledRecording]:
    if recording.force_N is None:
        return "unit", recording.output_recording()
    return "source" if order.kind is OrderKind.SOURCE else "audit", recording.labelled_recording()
