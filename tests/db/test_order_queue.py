"""Page and station share orders: one run at a time, STOP first, and a silent station is seen."""

from datetime import UTC, datetime, timedelta

import pytest

from softcal.core.errors import InputError
from softcal.core.orders import Condition, Heartbeat, Order, OrderKind, Progress, RunState, Signal, StationState
from softcal.db.queues.order_queue import STATION_SILENT_AFTER, TAKEOVER_AFTER, OrderQueue
from softcal.db.repositories.registry_base import RegistrySettings

NOW = datetime(2026, 5, 4, tzinfo=UTC)


@pytest.fixture
def queue(registry):
    return OrderQueue(registry.database, RegistrySettings(clock=lambda: NOW))


def press(order_id="o1", station="s1"):
    return Order(order_id, station, OrderKind.UNIT, "A1", "L1", "kim", created=NOW)


def test_an_order_comes_out_as_it_was_placed(queue):
    queue.place(press())
    assert queue.take("s2") is None and queue.take("s1") == press() and queue.take("s1") is None


def test_a_second_run_is_refused_while_one_is_not_over(queue):
    queue.place(press("o1"))
    with pytest.raises(InputError, match="A1"):
        queue.place(press("o2"))
    queue.place(press("o3", "s2"))
    queue.report(Progress("o1", RunState.DONE))
    queue.place(press("o4"))


def test_the_same_order_twice_is_one(queue):
    queue.place(press())
    queue.place(press())
    assert len(queue.runs("s1")) == 1


def test_stop_is_placed_beside_a_run_and_taken_first(queue):
    queue.place(press())
    queue.place(Order("stop", "s1", OrderKind.STOP, created=NOW + timedelta(seconds=1)))
    assert [queue.take("s1").kind, queue.take("s1").kind] == [OrderKind.STOP, OrderKind.UNIT]


def test_progress_is_read_back_with_its_signal(queue):
    queue.place(press())
    signal = Signal((0.0, 0.02), (1.0, 1.1), (0.0, 0.5), (), "ohm")
    progress = Progress("o1", RunState.RUNNING, "pressing", 0.4, 12.5, verdict="pass", signal=signal)
    queue.report(progress)
    assert queue.progress("o1") == progress and queue.active("s1") == (press(), progress)


def test_a_run_that_is_over_stays_as_it_ended(queue):
    queue.place(press())
    queue.report(Progress("o1", RunState.ERROR, code="E-NOREPLY", message="the stage does not answer"))
    queue.report(Progress("o1", RunState.DONE))
    assert queue.progress("o1").state == RunState.ERROR and queue.active("s1") is None


def test_a_station_that_starts_ends_what_it_left(queue):
    queue.place(press())
    queue.take("s1")
    queue.place(Order("stop", "s1", OrderKind.STOP, created=NOW))
    assert queue.interrupt("s1", "the station was restarted") == ["o1", "stop"]
    assert queue.progress("o1").state == RunState.ERROR and queue.take("s1") is None


def test_a_station_has_one_owner(queue):
    queue.write_heartbeat(Heartbeat("s1", StationState.READY, NOW, process="host:1"))
    for silent_for in (timedelta(0), STATION_SILENT_AFTER):  # a busy machine is late with its beat
        with pytest.raises(InputError, match="host:1"):
            at = NOW + silent_for + timedelta(seconds=1)
            queue.write_heartbeat(Heartbeat("s1", StationState.READY, at, process="host:2"))
    late = NOW + TAKEOVER_AFTER + timedelta(seconds=1)
    queue.write_heartbeat(Heartbeat("s1", StationState.STARTING, late, ("warming up",), "host:2"))
    assert queue.heartbeat("s1") == Heartbeat("s1", StationState.STARTING, late, ("warming up",), "host:2")


def test_an_owner_whose_process_is_gone_is_followed_at_once(queue):
    queue.write_heartbeat(Heartbeat("s1", StationState.READY, NOW, process="host:1"))
    queue.write_heartbeat(
        Heartbeat("s1", StationState.READY, NOW + timedelta(seconds=1), process="host:2"), timedelta(0)
    )
    assert queue.heartbeat("s1").process == "host:2"


def test_what_the_gate_looked_at_is_read_back(queue):
    gate = (Condition("warm-up", False, "wait 3 more min"), Condition("homing", True, "homed"))
    heartbeat = Heartbeat("s1", StationState.READY, NOW, gate=gate, is_overridden=True)
    queue.write_heartbeat(heartbeat)
    assert queue.heartbeat("s1") == heartbeat


def test_a_run_that_waits_is_cancelled_by_a_stop(queue):
    queue.place(press())
    queue.place(Order("stop", "s1", OrderKind.STOP, created=NOW))
    assert queue.cancel_queued("s1", "cancelled before it began") == ["o1"]
    assert queue.progress("o1").state is RunState.CANCELLED and queue.progress("stop").state is RunState.QUEUED
    queue.place(press("o2"))


def test_silence_is_seen(registry, queue):
    assert not queue.is_answering("s1")
    queue.write_heartbeat(Heartbeat("s1", StationState.READY, NOW))
    later = OrderQueue(registry.database, RegistrySettings(clock=lambda: NOW + timedelta(seconds=4)))
    assert queue.is_answering("s1") and not later.is_answering("s1")
    assert [heartbeat.station for heartbeat in queue.stations()] == ["s1"]


def test_an_unknown_order_is_named(queue):
    with pytest.raises(InputError, match="'o9'"):
        queue.progress("o9")
