"""Simulated time: it advances only while the host waits, so runs are fast and repeatable.

Every far end is stepped from one event to the next inside `sleep_s`. Bytes still cross a real pty: the kernel hands
them over before a read returns, so no wall clock decides what the host sees.
"""

import math
import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from heapq import heappop, heappush
from itertools import count

from softcal.station.simulated.far_end import FarEnd

LARGEST_LAG_S = 0.1

BACKGROUND_STEP_S, LARGEST_STEP_S = 0.002, 0.01
"""Real time between two steps in the background, and the largest step of simulated time."""

HOST_SPEED = 10.0
"""A host on the world's clock is faster by this factor than the computer: other work on it does not delay the host."""


class World:
    """The clock of a simulated rig and all devices in it; a `station.interfaces.Clock`.

    Args:
        time_factor: simulated seconds per real second at most; None runs as fast as the computer can.
    """

    def __init__(self, time_factor: float | None = None) -> None:
        self._now_s = 0.0
        self._time_factor = time_factor
        self._started_s = time.monotonic()
        self._far_ends: list[FarEnd] = []
        self._poller = select.poll() if hasattr(select, "poll") else None
        self._planned: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._lock = threading.Condition(threading.RLock())
        self._is_in_background = False
        self._host_wakes_s: float | None = None

    def add(self, far_end: FarEnd) -> None:
        self._far_ends.append(far_end)
        descriptor = far_end.wire.descriptor
        if descriptor is None:
            self._poller = None  # A line that the system cannot say this of is asked at every step, and so are all.
        elif self._poller is not None:
            self._poller.register(descriptor, select.POLLIN)

    def at(self, time_s: float, happening: Callable[[], None]) -> None:
        """Schedule a callback at a simulated time, such as a fault; any thread may call this."""
        with self._lock:
            heappush(self._planned, (time_s, next(self._order), happening))

    def now_s(self) -> float:
        return self._now_s

    def sleep_s(self, seconds: float) -> None:
        with self._lock:
            wakes_s = self._now_s + max(0.0, seconds)
            if self._is_in_background:
                self._host_wakes_s = wakes_s
                self._lock.wait_for(lambda: self._now_s >= wakes_s or not self._is_in_background)
                return
            self._pass(wakes_s)
        if self._time_factor is not None:
            ahead_s = self._now_s / self._time_factor - (time.monotonic() - self._started_s)
            if ahead_s > 0:
                time.sleep(ahead_s)
            elif ahead_s < -LARGEST_LAG_S:
                # Nobody waited for a while: time lost is not made up for by running faster.
                self._started_s -= ahead_s

    def wait(self, event: threading.Event, seconds: float) -> None:
        with self._lock:
            wakes_s = self._now_s + seconds
            while self._now_s < wakes_s and not event.is_set():
                self._lock.wait(LARGEST_STEP_S)

    @contextmanager
    def in_background(self, host_speed: float = 1.0) -> Iterator[None]:
        """Advance simulated time at the real rate at most, for devices that wait in real time.

        Args:
            host_speed: while the host does not wait on this clock, time passes slower by this factor. 1 for a program
                that has its own clock.
        """
        stop = threading.Event()

        def run() -> None:
            try:
                before_s = time.monotonic()
                while not stop.wait(BACKGROUND_STEP_S):
                    now_s = time.monotonic()
                    self._step(now_s - before_s, host_speed)
                    before_s = now_s
            finally:
                with self._lock:
                    self._is_in_background = False
                    self._lock.notify_all()

        self._is_in_background = True
        thread = threading.Thread(target=run, name="simulated world", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def _step(self, real_s: float, host_speed: float) -> None:
        with self._lock:
            if self._host_wakes_s is None:
                self._pass(self._now_s + (real_s if host_speed == 1.0 else min(real_s, LARGEST_STEP_S) / host_speed))
            else:
                self._pass(min(self._now_s + min(real_s, LARGEST_STEP_S), self._host_wakes_s))
                if self._now_s >= self._host_wakes_s:
                    self._host_wakes_s = None
            self._lock.notify_all()

    def _pass(self, until_s: float) -> None:
        # One question for all lines: at nearly every step the host has written nothing.
        if self._poller is None or self._poller.poll(0):
            for far_end in self._far_ends:
                far_end.receive(self._now_s)
        due_s = [far_end.next_event_s() for far_end in self._far_ends]
        while True:
            next_s = min(due_s, default=math.inf)
            if self._planned and self._planned[0][0] <= min(next_s, until_s):
                time_s, _, happening = heappop(self._planned)
                self._now_s = max(self._now_s, time_s)
                for far_end in self._far_ends:
                    far_end.advance(self._now_s)
                happening()
                due_s = [far_end.next_event_s() for far_end in self._far_ends]
                continue
            if next_s > until_s:
                break
            self._now_s = max(self._now_s, next_s)
            for k, far_end in enumerate(self._far_ends):
                if due_s[k] <= self._now_s:
                    far_end.advance(self._now_s)
                    due_s[k] = far_end.next_event_s()
        self._now_s = until_s
