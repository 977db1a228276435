"""Brings every event to every destination at least once: what is not confirmed stays."""

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
from softcal.db.registry import Registry

FIRST_DELAY_S, LONGEST_DELAY_S = 1.0, 900.0
"""A failed try is repeated after 1 s, then twice as long each time, up to a quarter of an hour."""

LEASE_S = 30.0
"""A destination is held for so long after each look; one whose process was killed is free then.
Clocks of machines that share a registry agree better than that."""


class NotDelivered(SoftcalError):
    """A destination confirmed only the first `delivered` events; the others stay where they are."""

    def __init__(self, said: str, delivered: int = 0) -> None:
        super().__init__(said)
        self.delivered = delivered


class Sender(Protocol):
    """Brings events to one destination."""

    most: int
    """Events it takes at once."""

    def send(self, events: Sequence[RegistryEvent]) -> None:
        """Bring events in their order until the destination has confirmed all (`NotDelivered`: it has not)."""


@dataclass(frozen=True)
class Destination:
    """A destination with what opens its sender; a sender that failed is closed and opened anew."""

    settings: DestinationSettings
    open_sender: Callable[[], AbstractContextManager[Sender]]


class Forwarder:
    """Brings events to one destination; its place is in the registry, for a restart.

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
        """Bring the next events, unless a delay holds; return whether more may wait."""
        outbox, settings = self._registry.outbox, self._destination.settings
        known = outbox.begin(settings.name, outbox.end() if settings.begin == "now" else {})
        now, lease = self._clock(), timedelta(seconds=LEASE_S)
        # While half of the lease is left a look need not write.
        is_held = known.holder == self.holder and known.held_until is not None and known.held_until - now > lease / 2
        place = known if is_held else outbox.hold(settings.name, self.holder, now, now + lease)
        if place is None:
            self.close()
            return False
        if place.not_before is not None and now < place.not_before:
            return False
        try:
            self._sender = sender = self._sender or self._opened.enter_context(self._destination.open_sender())
            page = events_after(self._registry, place.cursor, sender.most, settings.events)
            sender.send(page.events)
        except NotDelivered as error:
            if error.delivered:
                outbox.moved(settings.name, page.events[error.delivered - 1].after, error.delivered, self.holder)
            before = 0 if error.delivered else place.failures
            wait = timedelta(seconds=min(LONGEST_DELAY_S, FIRST_DELAY_S * 2.0 ** min(before, 30)))
            outbox.failed(settings.name, str(error), self._clock() + wait, self.holder)
            self.close()
            return False
        if page.cursor != place.cursor or place.failures:
            outbox.moved(settings.name, page.cursor, len(page.events), self.holder)
        return not page.is_end


def status_json(registry: Registry) -> list[dict[str, Any]]:
    """Return where every destination stands; `waits` counts all changes behind its cursor."""
    end = registry.outbox.end()
    return [
        {
            "destination": delivery.destination,
            "sent": delivery.delivered,
            "waits": sum(seq - delivery.cursor.get(origin, 0) for origin, seq in end.items()),
            "failures": delivery.failures,
            "next_try": delivery.not_before and delivery.not_before.isoformat(),
            "error": delivery.error or None,
            "served_by": delivery.holder,
        }
        for delivery in registry.outbox.deliveries()
    ]
