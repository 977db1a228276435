"""Live estimates over MQTT: the rows that `softcal adapt --out -` writes, published as they come."""

import json
import math
import time
from collections.abc import Iterable
from contextlib import ExitStack, suppress

from softcal.app.connect.events import path_part
from softcal.app.connect.forwarder import NotDelivered
from softcal.app.connect.mqtt import Message, MqttSender, open_mqtt
from softcal.app.connect.settings import MqttSettings
from softcal.app.use.sink import HEADER
from softcal.core.errors import InputError

RETRY_S = 2.0
"""Between two tries to reach a broker that is away."""

COLUMNS = tuple(HEADER.strip().split(","))


def publish_estimates(lines: Iterable[str], serial: str, settings: MqttSettings, most_per_s: float) -> tuple[int, int]:
    """Publish rows of estimates until they end; return how many were published and how many were left out.

    A live value is worth nothing later: what comes faster than `most_per_s`, and what comes while the broker is away,
    is left out. The rows themselves are whole in the output of `softcal adapt`.

    Raises:
        InputError: these are no rows of estimates.
        NotDelivered: the broker was away from the beginning.
    """
    rows = iter(lines)
    if next(rows, "").strip() != HEADER.strip():
        raise InputError(f"rows of `softcal adapt --out -` were expected: {HEADER.strip()}")
    topic, published, left_out, next_s = f"units/{path_part(serial)}/estimate", 0, 0, 0.0
    with _Live(settings) as live:
        for line in rows:
            payload, now_s = estimate_json(line, serial), time.monotonic()
            is_due = now_s >= next_s
            if is_due:
                next_s = now_s + 1 / most_per_s
            if is_due and live.publish((topic, payload, True)):
                published += 1
            else:
                left_out += 1
    return published, left_out


class _Live:
    """A connection that may come and go after it stood once."""

    def __init__(self, settings: MqttSettings) -> None:
        self._settings, self._tried_s = settings, 0.0
        self._stack = ExitStack()
        self._sender: MqttSender | None = None

    def __enter__(self) -> "_Live":
        self._open()
        return self

    def __exit__(self, *exception: object) -> None:
        with suppress(NotDelivered):
            self._stack.close()

    def publish(self, message: Message) -> bool:
        """Publish, or return that the broker is away."""
        try:
            if self._sender is None:
                if time.monotonic() - self._tried_s < RETRY_S:
                    return False
                self._open()
            if self._sender is not None:
                self._sender.publish([message])
            return True
        except NotDelivered:
            self.__exit__()
            self._stack, self._sender = ExitStack(), None
            return False

    def _open(self) -> None:
        self._tried_s = time.monotonic()
        self._sender = self._stack.enter_context(open_mqtt(self._settings))


def estimate_json(line: str, serial: str) -> str:
    """Return one row as JSON; what is not a number is null (`InputError`: it is no row of estimates)."""
    cells = line.rstrip("\r\n").split(",", len(COLUMNS) - 1)
    try:
        numbers = [float(cell) if cell else None for cell in cells[:4]]
    except ValueError as error:
        raise InputError(f"{line[:80]!r}: a row of {', '.join(COLUMNS)} was expected") from error
    if len(cells) != len(COLUMNS):
        raise InputError(f"{line[:80]!r}: a row of {', '.join(COLUMNS)} was expected")
    finite = [None if value is None or not math.isfinite(value) else value for value in numbers]
    return json.dumps({"serial": serial, **dict(zip(COLUMNS, [*finite, cells[4]], strict=True))})
