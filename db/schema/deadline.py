"""Deadlines and signs of life that are stored: one rule for all, whatever the clock does.

A clock may be set back by a day. What was stored before then lies in the future, and whoever waited for it would wait
for that day. So no deadline counts that is further away than the longest wait of its kind: a clock wrote it that was
ahead, or nobody did.
"""

from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import ColumnElement, or_

MAX_CLOCK_ERROR = timedelta(seconds=30)
"""Clocks of machines that share a registry agree better than that."""


def has_passed(until: datetime | None, now: datetime, longest: timedelta) -> bool:
    """Return whether a deadline is over: past, never set, or further away than the longest possible wait."""
    return until is None or until <= now or until > now + longest + MAX_CLOCK_ERROR


def passed_condition(until: ColumnElement[Any], now: datetime, longest: timedelta) -> ColumnElement[bool]:
    """Return the condition of `has_passed` for a column."""
    return or_(until.is_(None), until <= now, until > now + longest + MAX_CLOCK_ERROR)


def is_silent(last: datetime, now: datetime, max_silence: timedelta) -> bool:
    """Whether a sign of life is older than `max_silence`, or was given by a clock that was ahead."""
    return not -MAX_CLOCK_ERROR <= now - last <= max_silence
