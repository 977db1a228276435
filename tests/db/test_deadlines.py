"""A clock that is set back by a day stops nothing: no lease, wait, lock or sign of life outlives its own length."""

from datetime import UTC, datetime, timedelta

import pytest

from softcal.core.errors import InputError
from softcal.core.orders import Heartbeat, RunState, StationState
from softcal.db.connection import open_registry
from softcal.db.queues.work_queue import WorkSet
from softcal.db.repositories.registry_base import RegistrySettings

DAY = timedelta(days=1)


class Clock:
    """A wall clock that a test may set."""

    def __init__(self):
        self.now = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def timed(registry_url, clock):
    with open_registry(registry_url, RegistrySettings(clock=clock)) as opened:
        yield opened


@pytest.mark.parametrize("jump", [-DAY, DAY])
def test_a_destination_of_a_dead_process_is_free(timed, clock, jump):
    lease = timedelta(seconds=30)
    timed.outbox.begin("mes", {})
    assert timed.outbox.hold("mes", "one", clock.now, clock.now + lease)
    assert timed.outbox.hold("mes", "two", clock.now, clock.now + lease) is None
    clock.now += jump
    assert timed.outbox.hold("mes", "two", clock.now, clock.now + lease)


@pytest.mark.parametrize("jump", [-DAY, DAY])
def test_an_account_is_locked_for_its_pause_and_no_longer(timed, clock, jump):
    timed.people.set("kim", "operator", "2580", actor="admin")
    for _ in range(40):
        with pytest.raises(InputError):
            timed.people.sign_in("kim", "0000")
    with pytest.raises(InputError):
        timed.people.sign_in("kim", "2580")
    clock.now += jump
    assert timed.people.sign_in("kim", "2580").name == "kim"


@pytest.mark.parametrize("jump", [-DAY, DAY])
@pytest.mark.parametrize("is_taken", [False, True])
def test_a_job_whose_process_died_is_lost(timed, clock, jump, is_taken):
    job = timed.job_board.place("train", {}, "Erin")
    if is_taken:
        timed.job_board.take(job)
    assert not timed.job_board.job(job).is_lost(clock.now)
    clock.now += jump
    assert timed.job_board.job(job).is_lost(clock.now)
    timed.job_board.cancel(job)
    assert timed.job_board.job(job).state is RunState.CANCELLED


@pytest.mark.parametrize("jump", [-DAY, DAY])
def test_a_station_whose_process_died_is_silent_and_may_be_taken_over(timed, clock, jump):
    def make_heartbeat(process: str) -> Heartbeat:
        return Heartbeat("line-1", StationState.READY, clock.now, process=process)

    timed.order_queue.write_heartbeat(make_heartbeat("here:1"))
    assert timed.order_queue.is_answering("line-1")
    with pytest.raises(InputError):
        timed.order_queue.write_heartbeat(make_heartbeat("here:2"))
    clock.now += jump
    assert not timed.order_queue.is_answering("line-1")
    timed.order_queue.write_heartbeat(make_heartbeat("here:2"))
    assert timed.order_queue.is_answering("line-1")


@pytest.mark.parametrize("jump", [-DAY, DAY])
def test_work_of_a_dead_worker_is_handed_out_again(timed, clock, jump):
    work = WorkSet("L1", "set")
    timed.work_queue.enqueue(work, {"A1": "a" * 64})
    assert timed.work_queue.claim("one", work, 1, 60.0)
    assert not timed.work_queue.claim("two", work, 1, 60.0)
    clock.now += jump
    # Neither is a set that nobody works at kept alive by a lease that no clock will reach.
    timed.work_queue.enqueue(WorkSet("L1", "other"), {"A1": "a" * 64})
    assert not timed.work_queue.counts(work=work)["claimed"]


def test_a_clock_that_is_a_little_ahead_changes_nothing(timed, clock):
    timed.order_queue.write_heartbeat(
        Heartbeat("line-1", StationState.READY, clock.now + timedelta(seconds=20), process="far:1")
    )
    assert timed.order_queue.is_answering("line-1")
