"""Forwarder of every event to every destination at least once: an unconfirmed event stays."""

import os
import secrets
import socket
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Protocol

from softcal.app.connect.events import RegistryEvent, events_after
from softcal.app.connect.settings import DestinationSettings
from softcal.core.errors import SoftcalError
from softcal.db.queues.outbox import Cursor, Delivery
from softcal.db.registry import Registry
from softcal.db.schema.deadline import has_passed

FIRST_DELAY_S, MAX_DELAY_S = 1.0, 900.0
"""A failed try is repeated after 1 s, then twice as long each time, up to a quarter of an hour."""

MAX_DELAY = timedelta(seconds=MAX_DELAY_S)

LEASE_S = 30.0
"""A destination is held for so long after each look; one whose process was killed is free then.
Clocks of machines that share a registry agree better than that."""


class NotDelivered(SoftcalError):
    """A destination confirmed only the first `delivered` events; the others stay where they are."""

    def __init__(self, message: str, delivered: int = 0) -> None:
        super().__init__(message)
        self.delivered = delivered


class Sender(Protocol):
    """Brings events to one destination."""

    max_events: int
    """Events it takes at once."""

    def send(self, events: Sequence[RegistryEvent]) -> None:
        """Send events in order until the destination has confirmed all; raise `NotDelivered` otherwise."""


@dataclass(frozen=True)
class Destination:
    """A destination with a function that opens its sender; a sender that failed is closed and opened again."""

    settings: DestinationSettings
    open_sender: Callable[[], AbstractContextManager[Sender]]


class Forwarder:
    """Brings events to one destination; its cursor is in the registry, for a restart.

    A destination is served by one forwarder at a time; another one waits.
    """

    def __init__(self, registry: Registry, destination: Destination, clock: Callable[[], datetime]) -> None:
        self._registry, self._destination, self._clock = registry, destination, clock
        self._opened = ExitStack()
        self._sender: Sender | None = None
        self.holder = f"{socket.gethostname()[:90]}:{os.getpid()}:{secrets.token_hex(4)}"

    def __enter__(self) -> "Forwarder":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
        # The registry may be away; what is held is free after the lease then.
        with suppress(SoftcalError):
            self._registry.outbox.release(self.holder)

    def close(self) -> None:
        self._sender = None
        self._opened.close()

    def step(self) -> bool:
        """Send the next events, unless a delay is active; return whether more may wait."""
        outbox, settings = self._registry.outbox, self._destination.settings
        delivery = outbox.begin(settings.name, outbox.end() if settings.begin == "now" else {})
        now, lease = self._clock(), timedelta(seconds=LEASE_S)
        # While half of the lease is left a look need not write.
        until = delivery.held_until if delivery.holder == self.holder else None
        has_lease = until is not None and lease / 2 < until - now <= lease
        lease_row = delivery if has_lease else outbox.hold(settings.name, self.holder, now, now + lease)
        if lease_row is None:
            self.close()
            return False
        if not has_passed(lease_row.not_before, now, MAX_DELAY):
            return False
        try:
            self._sender = sender = self._sender or self._opened.enter_context(self._destination.open_sender())
            page = events_after(self._registry, lease_row.cursor, sender.max_events, settings.events)
            sender.send(page.events)
        except NotDelivered as error:
            if error.delivered:
                outbox.moved(settings.name, page.events[error.delivered - 1].after, error.delivered, self.holder)
            failures = 0 if error.delivered else lease_row.failures
            wait = timedelta(seconds=min(MAX_DELAY_S, FIRST_DELAY_S * 2.0 ** min(failures, 30)))
            outbox.failed(settings.name, str(error), self._clock() + wait, self.holder)
            self.close()
            return False
        if page.cursor != lease_row.cursor or lease_row.failures:
            outbox.moved(settings.name, page.cursor, len(page.events), self.holder)
        return not page.is_end


def status_json(registry: Registry, now: datetime) -> list[dict[str, Any]]:
    """Return the state of every destination; `waits` counts all changes behind its cursor.

    What a clock wrote that was ahead is over: nobody serves it since, no try waits for it, and `error` says so.
    """
    end = registry.outbox.end()
    return [_status(delivery, end, now) for delivery in registry.outbox.deliveries()]


def _status(delivery: Delivery, end: Cursor, now: datetime) -> dict[str, Any]:
    is_free = has_passed(delivery.held_until, now, timedelta(seconds=LEASE_S))
    is_due = has_passed(delivery.not_before, now, MAX_DELAY)
    over = [at for at, is_past in ((delivery.held_until, is_free), (delivery.not_before, is_due)) if at and is_past]
    ahead = [f"the clock was set back; what waited until {at.isoformat()} waits no longer" for at in over if at > now]
    return {
        "destination": delivery.destination,
        "sent": delivery.delivered,
        "waits": sum(seq - delivery.cursor.get(origin, 0) for origin, seq in end.items()),
        "failures": delivery.failures,
        "next_try": None if is_due or delivery.not_before is None else delivery.not_before.isoformat(),
        "error": "; ".join([*ahead[:1], delivery.error]).removesuffix("; ") or None,
        "served_by": None if is_free else delivery.holder,
    }
