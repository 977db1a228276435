"""Run the same function over many items: in this process, in a pool of processes, or on a Dask cluster.

The caller keeps what is finished; an engine only computes. A worker that dies costs the items it held, which are
given out again, and never the rest.
"""

import multiprocessing
import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from softcal.core.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = Callable[[Any, Any], Any]
"""(what all items share, one item) -> result; a module-level function, so that it travels to a worker."""

ENGINES = ("local", "dask")
TRIES_ALONE = 2
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

_END: Any = object()
_shared: Any = None


@dataclass(frozen=True)
class EngineChoice:
    """Which engine computes.

    Args:
        engine: `local` or `dask`.
        jobs: worker processes; 1 computes in this process.
        scheduler: address of a running Dask scheduler; None starts one for this run.
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
class WorkerLost(Generic[Item]):
    """Stands for the result of an item that killed its worker each time it was tried."""

    item: Item


def run_all(choice: EngineChoice, work: Work, shared: Any, items: Iterable[Item]) -> Iterator[Any]:
    """Yield `work(shared, item)` for every item, in the order they finish; at most a few items per worker wait.

    When a worker dies, every item that was under way is tried again alone, so that the one that kills its worker is
    found; it comes back as `WorkerLost` and the rest goes on. An exception that `work` raises is raised here.
    """
    if choice.engine == "local" and choice.jobs == 1:
        yield from (work(shared, item) for item in items)
        return
    opener = _process_pool if choice.engine == "local" else _dask_pool
    waiting = iter(items)
    suspects: list[Item] = []
    while True:
        with opener(choice, shared) as pool:
            suspects = yield from _drain(pool, work, waiting, 2 * choice.jobs)
        if not suspects:
            return
        for item in suspects:
            yield _try_alone(work, shared, item)


def _drain(pool: Executor, work: Work, items: Iterator[Item], depth: int) -> Generator[Any, None, list[Item]]:
    """Feed the pool until all is done or it breaks; return what was under way when it broke."""
    running: dict[Future[Any], Item] = {}
    suspects: list[Item] = []
    while True:
        while not suspects and len(running) < depth:
            item = next(items, _END)
            if item is _END:
                break
            running[pool.submit(_call, work, item)] = item
        if not running:
            return suspects
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            item = running.pop(future)
            try:
                result = future.result()
            except BrokenProcessPool:
                suspects.append(item)
                continue
            yield result


def _try_alone(work: Work, shared: Any, item: Item) -> Any:
    for _ in range(TRIES_ALONE):
        with _process_pool(EngineChoice(jobs=1), shared) as pool:
            try:
                return pool.submit(_call, work, item).result()
            except BrokenProcessPool:
                continue
    return WorkerLost(item)


def _call(work: Work, item: Any) -> Any:
    return work(_shared, item)


def _start_worker(shared: Any) -> None:
    global _shared
    _shared = shared


@contextmanager
def _process_pool(choice: EngineChoice, shared: Any) -> Iterator[Executor]:
    # Workers read the thread limits when they import their libraries: two workers must not start four threads.
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    pool = ProcessPoolExecutor(
        choice.jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker, initargs=(shared,)
    )
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _dask_pool(choice: EngineChoice, shared: Any) -> Iterator[Executor]:
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError("engine dask needs an extra: pip install 'softcal[cluster]'") from error
    local = None
    if choice.scheduler is None:
        local = LocalCluster(n_workers=choice.jobs, threads_per_worker=1, dashboard_address=None, processes=True)
    try:
        client = Client(local if local is not None else choice.scheduler, timeout="10 s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at {choice.scheduler}: {error}") from error
    try:
        yield _DaskPool(client, shared)
    finally:
        client.close()
        if local is not None:
            local.close()


class _DaskPool(Executor):
    """`submit` on a Dask client; what all items share is sent to each worker once."""

    def __init__(self, client: Any, shared: Any) -> None:
        self._client = client
        self._shared = client.scatter(shared, broadcast=True, hash=False)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **keywords: Any) -> Future[Any]:
        work, item = arguments
        answer: Future[Any] = Future()
        self._client.submit(work, self._shared, item, pure=False).add_done_callback(
            lambda task: _pass_on(task, item, answer)
        )
        return answer


def _pass_on(task: Any, item: Any, answer: Future[Any]) -> None:
    from distributed.scheduler import KilledWorker

    error = task.exception()
    if error is None:
        answer.set_result(task.result())
    elif isinstance(error, KilledWorker):
        # The cluster has already tried the item on several workers.
        answer.set_result(WorkerLost(item))
    else:
        answer.set_exception(error)
