"""Engines: the same results from each, and a worker that dies costs its item nothing but time."""

import operator
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from softcal.app.batch.engine import EngineChoice, WorkerFailure, run_all
from softcal.core.errors import InputError


def _add(shared: int, item: int) -> int:
    return shared + item


def _die_once(folder: str, item: int) -> int:
    mark = Path(folder) / str(item)
    if item == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), 9)
    return item


def _always_die(shared: None, item: int) -> int:
    if item == 3:
        os.kill(os.getpid(), 9)
    return item


def _refuse(shared: None, item: int) -> int:
    raise InputError(f"item {item}")


@pytest.mark.parametrize("choice", [EngineChoice(), EngineChoice(jobs=2)], ids=["one process", "two processes"])
def test_every_item_is_computed_once(choice: EngineChoice) -> None:
    assert sorted(run_all(choice, _add, 100, iter(range(20)))) == list(range(100, 120))


@pytest.mark.filterwarnings("ignore")  # the cluster's own event loops warn while they close
def test_dask_gives_the_same(require) -> None:
    assert sorted(run_all(EngineChoice("dask", 1), _add, 100, range(5))) == list(range(100, 105))


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_of_a_cluster_loses_nothing(tmp_path: Path) -> None:
    assert sorted(run_all(EngineChoice("dask", 1), _die_once, str(tmp_path), range(2, 5))) == [2, 3, 4]


@pytest.fixture
def cluster_elsewhere() -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The address of a Dask scheduler in a process of its own, and its one worker."""
    dask = [sys.executable, "-m", "dask"]
    plain = ["--no-dashboard", "--host", "127.0.0.1"]
    with subprocess.Popen([*dask, "scheduler", "--port", "0", *plain], stderr=subprocess.PIPE, text=True) as scheduler:
        assert scheduler.stderr is not None
        address = next(match[0] for line in scheduler.stderr if (match := re.search(r"tcp://[0-9.]+:[0-9]+", line)))
        worker = subprocess.Popen(
            [*dask, "worker", address, "--nworkers", "1", "--nthreads", "1", *plain],
            stderr=subprocess.DEVNULL,
            text=True,
        )
        yield address, worker
        for process in (worker, scheduler):
            process.terminate()
            process.wait()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_runs_elsewhere_is_used_and_left_running(cluster_elsewhere) -> None:
    address, worker = cluster_elsewhere
    choice = EngineChoice("dask", scheduler=address)
    for shared in (100, 200):
        assert sorted(run_all(choice, operator.add, shared, range(5))) == list(range(shared, shared + 5))
    assert worker.poll() is None


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_that_does_not_answer_is_named() -> None:
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:1"):
        list(run_all(EngineChoice("dask", scheduler="tcp://127.0.0.1:1"), operator.add, 1, range(2)))


def test_a_killed_worker_loses_nothing(tmp_path: Path) -> None:
    assert sorted(run_all(EngineChoice(jobs=2), _die_once, str(tmp_path), range(8))) == list(range(8))


def test_an_item_that_always_kills_its_worker_is_given_up_alone() -> None:
    results = list(run_all(EngineChoice(jobs=2), _always_die, None, range(6)))
    assert [r.item for r in results if isinstance(r, WorkerFailure)] == [3]
    assert sorted(r for r in results if not isinstance(r, WorkerFailure)) == [0, 1, 2, 4, 5]


def test_an_error_of_the_work_reaches_the_caller() -> None:
    with pytest.raises(InputError, match=r"item \d"):
        list(run_all(EngineChoice(jobs=2), _refuse, None, range(3)))


def test_an_engine_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InputError, match="ray"):
        EngineChoice("ray")
