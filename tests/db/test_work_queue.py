"""Work items are done once: claimed by one worker, handed on when it dies, kept when it is done."""

import threading
from datetime import UTC, datetime, timedelta

import pytest

from softcal.db.queues.work_queue import MAX_ATTEMPTS, WorkQueue, WorkSet
from softcal.db.repositories.registry_base import RegistrySettings

WORK = WorkSet("L1", "a" * 64)


class FakeClock:
    def __init__(self) -> None:
        self.now = datetime(2026, 5, 4, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def queue(registry, clock):
    return WorkQueue(registry.database, RegistrySettings(clock=clock))


def requests(count):
    return {f"A{k}": f"{k:064x}" for k in range(count)}


def test_asking_twice_makes_one_item(queue):
    assert (queue.enqueue(WORK, requests(3)), queue.enqueue(WORK, requests(4))) == (3, 1)
    assert queue.counts("L1") == {"queued": 4, "claimed": 0, "failed": 0}


def test_a_claimed_item_is_nobody_else_s(queue):
    queue.enqueue(WORK, requests(3))
    mine, yours = queue.claim("me", WORK, 2, 60), queue.claim("you", WORK, 2, 60)
    assert [item.serial for item in mine] == ["A0", "A1"] and [item.serial for item in yours] == ["A2"]
    assert not queue.finish("you", [mine[0].id]) and queue.finish("me", [mine[0].id])


def test_an_expired_lease_goes_to_the_next_worker_and_the_late_result_is_dropped(queue, clock):
    queue.enqueue(WORK, requests(1))
    (item,) = queue.claim("dead", WORK, 1, 60)
    clock.now += timedelta(seconds=61)
    (again,) = queue.claim("alive", WORK, 1, 60)
    assert (again.id, again.attempts) == (item.id, 2)
    assert not queue.finish("dead", [item.id]) and queue.finish("alive", [item.id])


def test_an_extended_lease_stays(queue, clock):
    queue.enqueue(WORK, requests(1))
    (item,) = queue.claim("slow", WORK, 1, 60)
    clock.now += timedelta(seconds=50)
    assert queue.extend("slow", 60) == 1
    clock.now += timedelta(seconds=50)
    assert queue.claim("other", WORK, 1, 60) == []


def test_an_item_that_kills_its_workers_is_given_up(queue, clock):
    queue.enqueue(WORK, requests(1))
    for _ in range(MAX_ATTEMPTS):
        assert len(queue.claim("worker", WORK, 1, 1)) == 1
        clock.now += timedelta(seconds=2)
    assert queue.claim("worker", WORK, 1, 1) == [] and queue.counts()["failed"] == 1
    assert queue.enqueue(WORK, requests(1)) == 1, "asking anew is a decision to retry"


def test_stopping_in_order_gives_everything_back(queue):
    queue.enqueue(WORK, requests(3))
    queue.claim("me", WORK, 2, 60)
    assert queue.give_back("me") == 2
    assert [item.attempts for item in queue.claim("you", WORK, 3, 60)] == [1, 1, 1]


def test_what_is_done_is_gone_and_may_be_asked_for_again(queue):
    queue.enqueue(WORK, requests(1))
    (item,) = queue.claim("me", WORK, 1, 60)
    assert queue.finish("me", [item.id]) and set(queue.counts().values()) == {0}
    assert queue.enqueue(WORK, requests(1)) == 1, "whether it was done is told by the registry, not by the queue"


def test_a_lease_that_no_clock_could_have_written_is_none(queue, clock):
    queue.enqueue(WORK, requests(1))
    clock.now += timedelta(days=30)
    queue.claim("clock ahead", WORK, 1, 60)
    clock.now -= timedelta(days=30)
    assert [item.serial for item in queue.claim("me", WORK, 1, 60)] == ["A0"]


def test_many_workers_at_once_do_every_item_exactly_once(queue):
    queue.enqueue(WORK, requests(60))
    items_taken: list[int] = []

    def work(owner: str) -> None:
        while items := queue.claim(owner, WORK, 3, 60):
            items_taken.extend(item.id for item in items if queue.finish(owner, [item.id]))

    threads = [threading.Thread(target=work, args=(f"w{k}",)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    # On PostgreSQL a worker may see nothing free while others hold the rows; what it left is still queued.
    work("last")
    assert len(items_taken) == len(set(items_taken)) == 60 and set(queue.counts().values()) == {0}
