"""Isolation of units in a batch: an exception or a time-out in a unit's work is its result."""

import ctypes
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from softcal.app.batch.unit_work import Chunk, ChunkOutcome, SharedWork, UnitOutcome
from softcal.app.calibration.unit_calibration import Refusal
from softcal.core.messages.reason import plain, reason
from softcal.core.unit.verdict import Verdict

Work = Callable[[SharedWork, Chunk], ChunkOutcome]


class UnitTimeout(BaseException):
    """The work on a unit exceeded its time; no `except Exception` inside it may catch this."""


@dataclass(frozen=True)
class PassingRefusal(Refusal):
    """A refusal that a repetition may change; `trace` is for the log."""

    trace: str = ""


def isolate_units(work: Work, limit_s: float, shared: SharedWork, chunk: Chunk) -> ChunkOutcome:
    """Process the units of a chunk one by one; an error of one unit is its result."""
    start_s = time.process_time()
    units: list[UnitOutcome] = []
    for task in chunk.tasks:
        try:
            with time_limit(limit_s):
                outcomes = work(shared, Chunk((task,))).units
            units += outcomes
            continue
        except UnitTimeout:
            message, trace = f"its work was broken off after {limit_s:g} s; look at its recording", ""
        except Exception as error:
            summary = " ".join(str(error).split())[:200]
            message, trace = (
                f"its work failed: {type(error).__name__}: {summary}; the log has the details",
                traceback.format_exc(),
            )
        units.append(UnitOutcome(task.item_id, task.serial, PassingRefusal(Verdict.RETEST, plain(message), trace)))
    return ChunkOutcome(tuple(units), time.process_time() - start_s)


def failed_outcome(chunk: Chunk) -> ChunkOutcome:
    """Return the outcome of units that killed their worker each time."""
    refusal = PassingRefusal(Verdict.RETEST, reason("worker_died"))
    return ChunkOutcome(tuple(UnitOutcome(task.item_id, task.serial, refusal) for task in chunk.tasks), 0.0)


@contextmanager
def time_limit(limit_s: float) -> Iterator[None]:
    """Raise `UnitTimeout` in this thread when the block takes longer.

    The exception comes between two steps of Python: a single call into a compiled library is not broken off. An alarm
    signal would reach the main thread only, and workers of a cluster compute in others.
    """
    thread_id, lock, state = threading.get_ident(), threading.Lock(), {"is_over": False, "is_sent": False}

    def fire() -> None:
        with lock:
            if not state["is_over"]:
                state["is_sent"] = True
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread_id), ctypes.py_object(UnitTimeout))

    timer = threading.Timer(limit_s, fire)
    timer.daemon = True
    timer.start()
    try:
        yield
    except UnitTimeout:
        state["is_sent"] = False
        raise
    finally:
        with lock:
            state["is_over"] = True
            # What was sent and has not come yet must not come later, in the middle of something else. Where nothing
            # is on its way there is nothing to take back: under a profiler CPython 3.11 would hang on that for ever.
            if state["is_sent"]:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread_id), None)
        timer.cancel()
