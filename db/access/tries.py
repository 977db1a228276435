"""Waiting time after wrong PINs: equal for an account, an unknown name, and the code of the first account."""

import math
from datetime import datetime, timedelta

MAX_FAILURES = 5
LOCKED_FOR, MAX_PAUSE = timedelta(minutes=5), timedelta(days=1)
"""A four-digit PIN would fall to 10,000 guesses: after the fifth wrong one there is a pause, then one twice as long."""

MAX_NAMES = 10_000
"""So many names are remembered; whoever invents more does not fill the memory."""


def pause_after(failures: int) -> timedelta:
    """Return how long the next try waits after so many wrong ones in a row."""
    if failures < MAX_FAILURES:
        return timedelta(0)
    doublings = min(failures - MAX_FAILURES, 20)
    return min(LOCKED_FOR * (1 << doublings), MAX_PAUSE)


def minutes_until(until: datetime | None, now: datetime) -> int:
    """Return the minutes that are left of a pause, rounded up."""
    return 1 if until is None else max(1, math.ceil((until - now).total_seconds() / 60))


class Tries:
    """Wrong tries that this process alone counts."""

    def __init__(self) -> None:
        self._failures: dict[str, tuple[int, datetime | None]] = {}

    def read(self, key: str) -> tuple[int, datetime | None]:
        """Return how many tries were wrong, and until when the next one waits."""
        return self._failures.get(key, (0, None))

    def note(self, key: str, is_right: bool, now: datetime) -> None:
        """Count a wrong try, or forget them all after a right one."""
        failures = self._failures.pop(key, (0, None))[0] + 1
        if is_right:
            return
        if len(self._failures) >= MAX_NAMES:
            del self._failures[next(iter(self._failures))]
        pause = pause_after(failures)
        self._failures[key] = failures, now + pause if pause else None
