"""A page asks, another process computes: a job is taken once, ends once, can be stopped, and a dead one is seen."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.orders import RunState
from softcal.db.queues.job_board import JOB_SILENT_AFTER, START_WITHIN, JobBoard
from softcal.db.repositories.registry_base import RegistrySettings

NOW = datetime(2026, 5, 4, tzinfo=UTC)


@pytest.fixture
def board(registry):
    return JobBoard(registry.database, RegistrySettings(clock=lambda: NOW))


def test_a_job_is_taken_once_and_tells_how_far_it_is(board):
    job_id = board.place("train", {"lot": "L1"}, "kim")
    assert board.take(job_id).request == {"lot": "L1"}
    board.report(job_id, 0.5, "epoch 3", {"epoch": [1, 2, 3]})
    assert (board.job(job_id).fraction, board.job(job_id).trace) == (0.5, {"epoch": [1, 2, 3]})
    with pytest.raises(InputError, match=job_id):
        board.take(job_id)


def test_a_job_ends_once(board):
    job_id = board.place("train", {}, "kim")
    board.take(job_id)
    board.end(job_id, RunState.DONE, "trained", {"network": "a"}, {"x": np.arange(3.0)})
    board.end(job_id, RunState.ERROR, "too late")
    board.report(job_id, 0.1, "too late")
    job = board.job(job_id)
    assert (job.state, job.fraction, job.message, job.result) == (RunState.DONE, 1.0, "trained", {"network": "a"})
    np.testing.assert_array_equal(board.arrays(job)["x"], [0.0, 1.0, 2.0])


def test_a_waiting_job_is_cancelled_at_once_a_running_one_is_asked(board):
    waiting, running = board.place("train", {}, "kim"), board.place("train", {}, "kim")
    board.take(running)
    assert not board.write_heartbeat(running)
    board.cancel(waiting)
    board.cancel(running)
    assert board.job(waiting).state is RunState.CANCELLED
    assert board.job(running).state is RunState.RUNNING and board.write_heartbeat(running)


def test_a_job_whose_process_died_is_seen_and_can_be_ended(registry, board):
    waiting, running = board.place("train", {}, "kim"), board.place("train", {}, "kim")
    board.take(running)
    assert not board.job(running).is_lost(NOW + JOB_SILENT_AFTER)
    later = NOW + START_WITHIN + timedelta(seconds=1)
    assert board.job(running).is_lost(later) and board.job(waiting).is_lost(later)
    JobBoard(registry.database, RegistrySettings(clock=lambda: later)).cancel(running)
    assert board.job(running).state is RunState.CANCELLED


def test_jobs_are_listed_newest_first_by_kind(registry):
    times = iter(NOW + timedelta(seconds=k) for k in range(9))
    board = JobBoard(registry.database, RegistrySettings(clock=lambda: next(times)))
    first, other, last = board.place("train", {}, "a"), board.place("diagnose", {}, "a"), board.place("train", {}, "a")
    assert [job.job_id for job in board.jobs("train")] == [last, first]
    assert {job.job_id for job in board.jobs()} == {first, other, last}


def test_a_job_nobody_knows_is_named(board):
    with pytest.raises(InputError, match="'nothing'"):
        board.job("nothing")
