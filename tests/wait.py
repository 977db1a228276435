"""Waiting on what another thread or process does."""

import time
from collections.abc import Callable
from typing import TypeVar

Value = TypeVar("Value")


def wait_until(condition: Callable[[], Value], what: str | Callable[[], object] = "", within_s: float = 120.0) -> Value:
    """Return the first true value of a condition; after `within_s` the test fails and shows what it waited for."""
    deadline_s = time.monotonic() + within_s
    while not (value := condition()):
        assert time.monotonic() < deadline_s, f"not within {within_s:g} s: {what() if callable(what) else what}"
        time.sleep(0.02)
    return value
