"""Service and registry joined: orders become recordings, a second owner is refused, old orders move nothing."""

import os
import socket
import subprocess
import threading
import time
from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.cli import station_service
from softcal.app.line.host import StationHost
from softcal.app.line.pressed_run import TRAINING, RunStore
from softcal.core.errors import InputError, RegistryError
from softcal.core.lot import Lot
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.profiles import ramps
from softcal.core.quality.gate import Gate
from softcal.db.connection import open_registry
from softcal.db.queues.order_queue import OrderQueue
from softcal.db.repositories.recordings import RecordingTables
from softcal.station.bench.bench import Bench, open_simulated_bench
from softcal.station.tasks.service import Hooks, StationService
from tests.wait import wait_until

QUICK = ramps([2.0], 4.0, rest_s=0.3, name="quick")


@pytest.fixture
def registry(tmp_path):
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        registry.lots.add(Lot("L1", "A0", 50.0))
        yield registry


class Opened:
    """The simulated bench as the service opens it."""

    def __enter__(self) -> Bench:
        self._context = open_simulated_bench(seed=1)
        return self._context.__enter__()[0]

    def __exit__(self, *exception: object) -> None:
        self._context.__exit__(None, None, None)


def make_host(registry, folder, profile=QUICK):
    def service(report, is_stop_requested) -> StationService:
        hooks = Hooks(report, is_stop_requested, lambda kind, rig: Gate())
        return StationService(Opened, {OrderKind.SOURCE: profile, OrderKind.UNIT: profile}, folder, hooks)

    store = RunStore(registry, "s1")
    return StationHost(registry.order_queue, "s1", store, lambda actor, reason: None, service)


def serve_until(host, is_done, limit_s=400.0):
    end_s = time.monotonic() + limit_s
    host.run(lambda: not is_done() and time.monotonic() < end_s)


def state_of(registry, order_id):
    return registry.order_queue.progress(order_id).state


def place_order_once(registry, lot):
    """Return a look that places one order the first time, and tells whether it has ended."""
    queue = registry.order_queue

    def is_done():
        if not queue.runs("s1"):
            queue.place(Order("o1", "s1", OrderKind.UNIT, "A1", lot))
        return not state_of(registry, "o1").is_active

    return is_done


def test_an_order_becomes_a_recording_in_the_registry(registry, tmp_path):
    queue = registry.order_queue
    serve_until(make_host(registry, tmp_path), place_order_once(registry, "L1"))
    progress = queue.progress("o1")
    assert progress.state is RunState.DONE, progress.text
    recording = registry.recordings.get(progress.recording_sha256)
    assert recording.serial == "A1"
    assert recording.stage_mm.max() == pytest.approx(2.0, abs=0.02)
    assert queue.heartbeat("s1").state is StationState.OFF


def test_what_is_reported_of_an_order_never_runs_back_when_its_network_is_trained(registry, tmp_path):
    host, reports = make_host(registry, tmp_path), []
    for order, phase, fraction in (
        ("o1", "pressing", 0.4), ("o1", "pressing", 1.0), ("o1", TRAINING, 0.0), ("o1", TRAINING, 0.5), ("o2", "", 0.1),
    ):  # fmt: skip
        host._report(Progress(order, RunState.RUNNING, phase, fraction))
        reports.append(host._newest)
    assert [(one.order_id, one.fraction) for one in reports] == [("o1", 0.4), *[("o1", 1.0)] * 3, ("o2", 0.1)]
    assert [one.phase for one in reports][1:4] == ["pressing", TRAINING, TRAINING]


def test_what_was_ordered_before_the_service_started_moves_nothing(registry, tmp_path):
    registry.order_queue.place(Order("old", "s1", OrderKind.UNIT, "A1", "L1"))
    serve_until(make_host(registry, tmp_path), lambda: True)
    assert state_of(registry, "old") is RunState.CANCELLED


def refused(registry, folder, process):
    with pytest.raises(InputError) as error:
        make_host(registry, folder).run(lambda: False)
    assert (error.value.reason.code, error.value.reason.values["process"]) == ("station.served", process)


@pytest.mark.parametrize("age_s", [0.0, 4.0, 10.0])
def test_a_second_owner_is_refused(registry, tmp_path, age_s):
    # An owner on a busy machine is late, and keeps its station.
    for process in ("other:1", f"{socket.gethostname()}:{os.getppid()}"):
        late = datetime.now(UTC) - timedelta(seconds=age_s)
        registry.order_queue.write_heartbeat(Heartbeat("s1", StationState.RUNNING, late, process=process), timedelta(0))
        refused(registry, tmp_path, process)


def test_an_owner_whose_process_is_gone_is_followed_at_once(registry, tmp_path):
    ended_process = subprocess.Popen(["true"])
    ended_process.wait()
    process = f"{socket.gethostname()}:{ended_process.pid}"
    registry.order_queue.write_heartbeat(Heartbeat("s1", StationState.RUNNING, datetime.now(UTC), process=process))
    make_host(registry, tmp_path).run(lambda: False)
    assert registry.order_queue.heartbeat("s1").process == f"{socket.gethostname()}:{os.getpid()}"


@pytest.mark.parametrize(
    ("is_ours", "age_s", "state", "is_there"),
    [
        (True, 8.0, StationState.RUNNING, True),
        (True, 8.0, StationState.OFF, False),
        (True, 60.0, StationState.READY, False),
        (False, 2.0, StationState.READY, True),
        (False, 8.0, StationState.READY, False),
    ],
)
def test_an_order_goes_to_a_service_that_is_late_on_a_busy_machine(registry, is_ours, age_s, state, is_there):
    process = f"{socket.gethostname()}:{os.getpid()}" if is_ours else "other:1"
    late = datetime.now(UTC) - timedelta(seconds=age_s)
    registry.order_queue.write_heartbeat(Heartbeat("s1", state, late, process=process))
    assert station_service._is_serving(registry.order_queue, "s1") is is_there


def test_a_running_owner_is_not_taken_over_by_a_clock_that_is_ahead(registry, tmp_path):
    is_over = threading.Event()

    def write_heartbeat():
        now = datetime.now(UTC) - timedelta(minutes=1)  # What the other machine's clock says, seen from here.
        registry.order_queue.write_heartbeat(Heartbeat("s1", StationState.READY, now, process="other:1"))

    def owner():
        while not is_over.wait(0.3):
            write_heartbeat()

    write_heartbeat()
    other = threading.Thread(target=owner)
    other.start()
    try:
        refused(registry, tmp_path, "other:1")
    finally:
        is_over.set()
        other.join()


def test_a_stop_order_reaches_a_run_and_the_station_stands_before_its_end_is_reported(registry, tmp_path, monkeypatch):
    queue = registry.order_queue
    report, is_standing = OrderQueue.report, []

    def report_and_look(self, progress):
        if progress.order_id == "o1" and not progress.state.is_active:
            is_standing.append(self.heartbeat("s1").state)
        report(self, progress)

    monkeypatch.setattr(OrderQueue, "report", report_and_look)
    # Presses for minutes of station time: they can only end by the stop.
    host = make_host(registry, tmp_path, ramps([2.0] * 400, 1.0, name="long"))

    def person():
        wait_until(lambda: (active := queue.active("s1")) and active[1].phase == "pressing")
        queue.place(Order("stop", "s1", OrderKind.STOP))

    threading.Thread(target=person, daemon=True).start()
    serve_until(host, place_order_once(registry, "L1"))
    assert state_of(registry, "o1") is RunState.CANCELLED
    assert state_of(registry, "stop") is RunState.DONE
    assert is_standing == [StationState.STOPPED]


def away_for(monkeypatch, owner, name, times, is_hit=lambda *_: True):
    """Let a method of the registry fail some times; return the times that are left."""
    failures, method = [None] * times, getattr(owner, name)

    def sometimes(self, *positional, **keywords):
        if failures and is_hit(*positional):
            failures.pop()
            raise RegistryError("the registry is away")
        return method(self, *positional, **keywords)

    monkeypatch.setattr(owner, name, sometimes)
    return failures


def test_a_recording_waits_for_a_registry_that_is_away(registry, tmp_path, monkeypatch):
    failures = away_for(monkeypatch, RecordingTables, "add", 3)
    serve_until(make_host(registry, tmp_path), place_order_once(registry, "L1"))
    assert (state_of(registry, "o1"), failures) == (RunState.DONE, [])


def test_the_end_of_an_order_is_reported_once_the_registry_is_back(registry, tmp_path, monkeypatch):
    failures = away_for(monkeypatch, OrderQueue, "report", 4, lambda progress: not progress.state.is_active)
    serve_until(make_host(registry, tmp_path), place_order_once(registry, "no such lot"))
    assert (state_of(registry, "o1"), failures) == (RunState.ERROR, [])


def test_a_defect_ends_its_run_alone(registry, tmp_path, monkeypatch):
    monkeypatch.setattr(RunStore, "store", lambda *_: 1 / 0)
    serve_until(make_host(registry, tmp_path), place_order_once(registry, "L1"))
    progress = registry.order_queue.progress("o1")
    assert (progress.state, progress.code) == (RunState.ERROR, "E-INTERNAL")
    assert "ZeroDivisionError" in progress.text
    assert list(tmp_path.glob("*A1*"))  # What was pressed is kept.


def test_a_stop_waits_for_nobody_who_writes_into_the_registry(registry, tmp_path):
    queue, locked = registry.order_queue, threading.Event()
    host = make_host(registry, tmp_path)
    is_stop_requested = host._is_stop_requested

    def order_stop_and_hold_registry():
        wait_until(lambda: any(progress.phase for _, progress in queue.runs("s1")))
        queue.place(Order("stop", "s1", OrderKind.STOP))
        with registry.database.writing():
            locked.set()
            assert is_stop_requested.wait(3.0)

    errors = []

    def run():
        try:
            order_stop_and_hold_registry()
        except AssertionError as error:
            errors.append(error)

    person = threading.Thread(target=run)
    person.start()
    serve_until(host, place_order_once(registry, "L1"))
    person.join()
    assert locked.is_set() and errors == []
