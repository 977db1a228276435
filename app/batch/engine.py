"""Run one function over many items: in this process, in a pool, or on a Dask cluster.

The caller keeps what is finished; an engine only computes. A worker that dies costs the items it held, which are
given out again, and never the rest.
"""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing.connection import wait as wait_for_end
from typing import Any, Generic, TypeVar

from softcal.app.bootstrap import ONE_THREAD
from softcal.core.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = Callable[[Any, Any], Any]
"""(what all items share, one item) -> result; of a module, so that it travels to a worker."""

ENGINES = ("local", "dask")
ITEMS_AHEAD = 2
"""Items given out per worker: one it computes, one that waits, so that no worker stands still."""

WORKERS_WITHIN_S = 60.0
TRIES_ALONE = 2

_END: Any = object()
_shared: Any = None


@dataclass(frozen=True)
class EngineChoice:
    """Engine of the computation: `local` or `dask`.

    `local` has worker processes (1 computes in this process); `dask` takes the address of a scheduler, and None starts
    one for this run.
    """

    engine: str = "local"
    jobs: int = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise InputError(f"engine {self.engine!r}: one of {', '.join(ENGINES)} was expected")
        if self.jobs < 1:
            raise InputError(f"{self.jobs} jobs; at least 1 was expected")


@dataclass(frozen=True)
class WorkerFailure(Generic[Item]):
    """Result of an item that killed its worker in each attempt."""

    item: Item


class WorkerDied(Exception):
    """The worker of an item died; the item may not be the cause."""


class Pool:
    """Workers that hold what all items share: `submit` gives them one item and returns its task,
    `error_of` says what went wrong with a task that is over.
    """

    def __init__(
        self,
        submit: Callable[[Work, Any], Any],
        workers: Callable[[], int],
        error_of: Callable[[Any], BaseException | None],
    ) -> None:
        self._submit, self.workers, self._error_of = submit, workers, error_of
        self.is_broken = False
        """Whether it takes no more items."""

    def submit(self, work: Work, item: Any) -> "Future[Any]":
        """Compute one item; the future raises `WorkerDied` when its worker is gone."""
        answer: Future[Any] = Future()

        def settle(task: Any, error: BaseException | None) -> None:
            if isinstance(error, BrokenProcessPool):
                self.is_broken, error = True, WorkerDied()
            if error is None:
                answer.set_result(task.result())
            else:
                answer.set_exception(error)

        try:
            task = self._submit(work, item)
        except BrokenProcessPool as error:
            settle(None, error)
        else:
            task.add_done_callback(lambda task: settle(task, self._error_of(task)))
        return answer


def run_all(
    choice: EngineChoice,
    work: Work,
    shared: Any,
    items: Iterable[Item],
    split: Callable[[Item], Iterable[Item]] = lambda item: (item,),
) -> Iterator[Any]:
    """Yield `work(shared, item)` for every item as they finish; a few items per worker wait.

    When a worker dies, every item that was under way is split and its parts are tried again alone, so that the one
    that kills its worker is found; it comes back as `WorkerFailure` and the rest goes on. An exception that `work`
    raises is raised here.
    """
    if choice.engine == "local" and choice.jobs == 1:
        yield from (work(shared, item) for item in items)
        return
    opener = _process_pool if choice.engine == "local" else _dask_pool
    waiting = iter(items)
    while True:
        with opener(choice, shared) as pool:
            suspects = yield from _drain(pool, work, waiting)
        if not suspects:
            return
        alone = deque((part, 1) for item in suspects for part in split(item))
        while alone:
            with opener(replace(choice, jobs=1), shared) as pool:
                yield from _try_alone(pool, work, alone)


def _drain(pool: Pool, work: Work, items: Iterator[Item]) -> Generator[Any, None, list[Item]]:
    """Feed the pool until all is done or a worker dies; return the items that were under way with it."""
    running: dict[Future[Any], Item] = {}
    suspects: list[Item] = []
    while True:
        while not suspects and len(running) < ITEMS_AHEAD * pool.workers():
            item = next(items, _END)
            if item is _END:
                break
            running[pool.submit(work, item)] = item
        if not running:
            return suspects
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            item = running.pop(future)
            try:
                result = future.result()
            except WorkerDied:
                suspects.append(item)
                continue
            yield result


def _try_alone(pool: Pool, work: Work, alone: deque[tuple[Any, int]]) -> Iterator[Any]:
    """Compute one item at a time until the pool breaks; `alone` has the remaining items."""
    while alone and not pool.is_broken:
        item, attempt = alone.popleft()
        try:
            result = pool.submit(work, item).result()
        except WorkerDied:
            if attempt < TRIES_ALONE:
                alone.appendleft((item, attempt + 1))
                continue
            result = WorkerFailure(item)
        yield result


def _call(work: Work, item: Any) -> Any:
    return work(_shared, item)


def _start_worker(shared: Any) -> None:
    global _shared
    _shared = shared
    # Ctrl-C reaches the whole group; the process that gave out the work decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    # A parent that was killed closes no pipe, and its workers would wait for ever.
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_end([parent.sentinel])
        os._exit(1)


@contextmanager
def _process_pool(choice: EngineChoice, shared: Any) -> Iterator[Pool]:
    # Workers read the limits when they import libraries: two must not start four threads.
    environment = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    executor = ProcessPoolExecutor(
        choice.jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker, initargs=(shared,)
    )
    try:
        yield Pool(
            lambda work, item: executor.submit(_call, work, item),
            lambda: choice.jobs,
            lambda task: CancelledError() if task.cancelled() else task.exception(),
        )
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
        for name, value in environment.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _dask_pool(choice: EngineChoice, shared: Any) -> Iterator[Pool]:
    try:
        import dask
        from distributed import Client, LocalCluster
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise InputError("engine dask needs an extra: pip install 'softcal[cluster]'") from error

    def error_of(task: Any) -> BaseException | None:
        error: BaseException | None = FutureCancelledError(task.key, None) if task.cancelled() else task.exception()
        if isinstance(error, KilledWorker):
            return WorkerDied()
        if isinstance(error, FutureCancelledError):
            return InputError("the Dask scheduler is gone; what was finished is kept, run the same command again")
        return error

    local = None
    if choice.scheduler is None:
        # An item whose worker died comes back at once: tried again alone it tells more.
        dask.config.set({"distributed.scheduler.allowed-failures": 0})
        local = LocalCluster(n_workers=choice.jobs, threads_per_worker=1, dashboard_address=None, processes=True)
    try:
        client = Client(local if local is not None else choice.scheduler, timeout="10 s")
        client.wait_for_workers(1, timeout=WORKERS_WITHIN_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no Dask scheduler with workers answers at {choice.scheduler}: {error}") from error
    try:
        # A task and no scattered data: when all that hold it die, it is made again.
        shared_future = client.submit(_return_shared, shared, pure=False)
        yield Pool(
            lambda work, item: client.submit(work, shared_future, item, pure=False),
            lambda: max(1, int(sum(client.nthreads().values()))),
            error_of,
        )
    finally:
        client.close()
        if local is not None:
            local.close()


def _return_shared(shared: Any) -> Any:
    return shared
