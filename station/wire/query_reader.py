"""Readings of a device without a clock, queried one by one."""

import math
from collections.abc import Callable
from contextlib import suppress

from softcal.core.errors import NoReply
from softcal.station.interfaces import Sample
from softcal.station.wire.link import Link

LATE_ANSWER_S = 0.25
"""An answer still due when reading begins anew is awaited so long: its question is an old one."""


def next_query_s(due_s: float, now_s: float, rate_Hz: float) -> float:
    """Return when a device is asked next. On a grid: counted from each answer, every delay would lower the rate."""
    return max(due_s, now_s - 1.0 / rate_Hz) + 1.0 / rate_Hz


class QueryReader:
    """Asks at a steady rate and takes every answer for a reading from the middle between question and answer.

    One question is open at a time. An answer that never comes ends the readings. Asking again could take a late answer
    for the next one, and a monitor detects the silence. `start` begins again.

    Args:
        parse: one line, its end taken off -> one number per channel; raises `BadReply`.
        limits: of a readout: lowest and highest reading; one that stays there is saturated.
    """

    def __init__(
        self,
        name: str,
        unit: str,
        rate_Hz: float,
        link: Link,
        question: bytes,
        parse: Callable[[bytes], tuple[float, ...]],
        limits: tuple[float, float] = (-math.inf, math.inf),
    ) -> None:
        self.name, self.unit, self.rate_Hz = name, unit, rate_Hz
        self.channels, self.range = 1, limits
        self._link, self._question, self._parse = link, question, parse
        self._query_s: float | None = None
        self._next_s = 0.0

    def start(self) -> None:
        if self._query_s is not None:
            with suppress(NoReply):  # It does not come any more, or the port is gone: the next call says so.
                self._link.next_line(LATE_ANSWER_S)
        self._link.discard()
        self._query_s, self._next_s = None, self._link.clock.now_s()

    def poll(self) -> list[Sample]:
        """Return the received readings, and send the next query when due; raise `BadReply` for an invalid reading."""
        samples = []
        for line in self._link.read_lines():
            if self._query_s is None:
                continue  # Nobody asked: a line that came twice.
            query_s, self._query_s = self._query_s, None
            samples.append(Sample((query_s + line.host_s) / 2, None, self._parse(line.text)))
        now_s = self._link.clock.now_s()
        if self._query_s is None and now_s >= self._next_s:
            self._link.write(self._question)
            self._query_s, self._next_s = now_s, next_query_s(self._next_s, now_s, self.rate_Hz)
        return samples

    def close(self) -> None:
        self._link.close()
