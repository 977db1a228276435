"""Events, states and live estimates over MQTT 3.1.1 (OASIS), QoS 1: each is confirmed.

Topics below the one of the settings:
- `status`: `online`, or `offline` once this publisher is gone (retained, last will);
- `events`: every event as CloudEvents JSON;
- `lots/LOT/units/SERIAL/verdict`: the newest verdict of a unit (retained);
- `alerts/KIND/LOT/ABOUT`: an open alert (retained; empty once over), `-` where it has none;
- `stations/STATION/state`: state of a station (retained);
- `lots/LOT/units/SERIAL/estimate`: live estimates, the newest one retained.
"""

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from softcal.app.connect.events import (
    ABOUT,
    CLEARED,
    RAISED,
    VERDICT,
    RegistryEvent,
    list_current_events,
    path_part,
    unit_path,
)
from softcal.app.connect.forwarder import NotDelivered
from softcal.app.connect.settings import MqttSettings, read_secret, split_address
from softcal.app.connect.stations import stations_json
from softcal.app.connect.webhook import tls_context
from softcal.app.files.stream_file import COLUMNS, HEADER
from softcal.core.errors import InputError
from softcal.core.lot import UnitKey
from softcal.db.registry import Registry

PORTS = {"mqtts": 8883, "mqtt": 1883}
ONLINE, OFFLINE = "online", "offline"
KEEP_ALIVE_S = 20
AT_LEAST_ONCE = 1
POLL_S = 0.2
"""Between two looks at whether the connection still stands."""

RETRY_S = 2.0
"""Between two tries to reach a broker that is away."""

Message = tuple[str, str, bool]
"""Topic below the one of the settings, payload, and whether the broker keeps it."""

States = Callable[[], Sequence[Message]]


@contextmanager
def open_mqtt(
    settings: MqttSettings, states: States = tuple, current_messages: States = tuple
) -> Iterator["MqttSender"]:
    """Connect to the broker; the status is `online` inside the block, then `offline`.

    `current_messages` is published once, `states` whenever they have changed.
    `NotDelivered`: the broker cannot be reached or refuses. `InputError`: a secret or certificate cannot be read.
    """
    client = paho.Client(CallbackAPIVersion.VERSION2, reconnect_on_failure=False)
    parts = split_address("broker", settings.broker)
    if parts.username:
        password = None if settings.password_file is None else read_secret(settings.password_file)
        client.username_pw_set(parts.username, password)
    if parts.scheme == "mqtts":
        context = tls_context(settings.ca_file)
        if settings.cert_file is not None:
            try:
                context.load_cert_chain(settings.cert_file, settings.key_file)
            except OSError as error:
                raise InputError(f"certificate {settings.cert_file} cannot be read: {error}") from error
        client.tls_set_context(context)
    client.will_set(f"{settings.topic}/status", OFFLINE, AT_LEAST_ONCE, retain=True)
    sender = MqttSender(client, settings, states)
    try:
        client.connect(parts.hostname or "", parts.port or PORTS[parts.scheme], KEEP_ALIVE_S)
    except (OSError, ValueError) as error:
        raise NotDelivered(f"{settings.broker} cannot be reached: {error}") from error
    client.loop_start()
    try:
        sender.wait_until_connected()
        sender.publish([("status", ONLINE, True), *current_messages()])
        yield sender
    finally:
        # Who says goodbye has no last will; where the connection is cut, the broker says it.
        with suppress(NotDelivered):
            sender.publish([("status", OFFLINE, True)])
        client.disconnect()
        client.loop_stop()
        # In a circle with its sender it would keep its handles.
        client.on_connect = None  # noqa: V101


class MqttSender:
    """Publisher over one connection; after a loss of the connection it is unusable."""

    max_events = 200

    def __init__(self, client: paho.Client, settings: MqttSettings, states: States) -> None:
        self._client, self._settings, self._states = client, settings, states
        self._refusal = ""
        self._published: dict[str, str] = {}
        client.on_connect = self._on_connect  # noqa: V101

    def wait_until_connected(self) -> None:
        """Return once the broker has accepted the connection; raise `NotDelivered` on refusal or time-out."""
        end_s = time.monotonic() + self._settings.timeout_s
        while not self._client.is_connected():
            if self._refusal or time.monotonic() > end_s:
                raise NotDelivered(f"{self._settings.broker} refuses: {self._refusal or 'it does not answer'}")
            time.sleep(0.01)

    def send(self, events: Sequence[RegistryEvent]) -> None:
        """Publish events with the states they change, and other states that changed.

        `NotDelivered`: the broker did not confirm them all, or has ended the connection.
        """
        changed = [message for message in self._states() if self._published.get(message[0]) != message[1]]
        self.publish([*(message for event in events for message in list_event_messages(event)), *changed])
        self._published |= {topic: payload for topic, payload, _ in changed}

    def publish(self, messages: Sequence[Message]) -> None:
        """Publish messages until the broker has confirmed each; raise `NotDelivered` otherwise."""
        top = self._settings.topic
        publications = [
            self._client.publish(f"{top}/{topic}", payload.encode(), AT_LEAST_ONCE, retain=is_retained)
            for topic, payload, is_retained in messages
        ]
        end_s = time.monotonic() + self._settings.timeout_s
        for publication in publications:
            while publication.rc == paho.MQTT_ERR_SUCCESS and self._client.is_connected() and time.monotonic() < end_s:
                publication.wait_for_publish(POLL_S)
                if publication.is_published():
                    break
            else:
                raise NotDelivered(f"{self._settings.broker} has not confirmed what was published")
        if not self._client.is_connected():
            raise NotDelivered(f"{self._settings.broker} has ended the connection")

    def _on_connect(self, client: paho.Client, data: object, flags: object, code: Any, properties: object) -> None:
        if code.is_failure:
            self._refusal = str(code)


def list_event_messages(event: RegistryEvent) -> list[Message]:
    """Return the messages of an event: the event itself, and the state that it changes."""
    text = json_text(event.to_json())
    messages = [("events", text, False)]
    if event.kind == VERDICT:
        messages.append((f"{event.subject}/verdict", text, True))
    if event.kind in (RAISED, CLEARED):
        values = event.data["values"]
        about = next((str(values[name]) for name in ABOUT if values.get(name)), "")
        parts = (event.data["kind"], event.data["lot"] or "", about)
        topic = "/".join(path_part(part) or "-" for part in parts)
        messages.append((f"alerts/{topic}", text if event.kind == RAISED else "", True))
    return messages


def list_current_messages(registry: Registry, settings: MqttSettings) -> list[Message]:
    """Return the retained messages for a new destination; none once it has received its first event.

    The newest verdict of every unit, and every open alert, each as its event tells it.
    """
    delivery = registry.outbox.begin(settings.name, {})
    if delivery.delivered:
        return []
    return [
        message
        for event in list_current_events(registry, delivery.cursor, settings.events)
        for message in list_event_messages(event)
        if message[2]
    ]


def state_messages(registry: Registry) -> list[Message]:
    """Return the published messages of every station."""
    # The time of the last sign of life would be another one every second.
    stations = [{name: value for name, value in one.items() if name != "at"} for one in stations_json(registry)]
    return [(f"stations/{path_part(one['station'])}/state", json_text(one), True) for one in stations]


def json_text(value: object) -> str:
    """Return JSON text without spaces; NaN is refused."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def publish_estimates(
    lines: Iterable[str], unit: UnitKey, settings: MqttSettings, max_rate_Hz: float
) -> tuple[int, int]:
    """Publish rows of estimates; return how many were published and left out.

    A live value is worth nothing later: what comes faster than `max_rate_Hz`, or while the broker is away, is left out.
    `InputError`: these are no rows of estimates. `NotDelivered`: the broker was away from the beginning.
    """
    rows = iter(lines)
    if next(rows, "").strip() != HEADER.strip():
        raise InputError(f"rows of `softcal adapt --out -` were expected: {HEADER.strip()}")
    topic, published, skipped, next_s = f"{unit_path(unit)}/estimate", 0, 0, 0.0
    with _Live(settings) as live:
        for line in rows:
            payload, now_s = estimate_json(line, unit), time.monotonic()
            is_due = now_s >= next_s
            if is_due:
                next_s = now_s + 1 / max_rate_Hz
            if is_due and live.publish((topic, payload, True)):
                published += 1
            else:
                skipped += 1
    return published, skipped


class _Live:
    """A connection that may be lost and restored after its first success."""

    def __init__(self, settings: MqttSettings) -> None:
        self._settings, self._attempted_at_s = settings, 0.0
        self._stack = ExitStack()
        self._sender: MqttSender | None = None

    def __enter__(self) -> "_Live":
        self._attempted_at_s = time.monotonic()
        self._sender = self._stack.enter_context(open_mqtt(self._settings))
        return self

    def __exit__(self, *exception: object) -> None:
        with suppress(NotDelivered):
            self._stack.close()

    def publish(self, message: Message) -> bool:
        """Publish, or return that the broker is away."""
        try:
            if self._sender is None:
                if time.monotonic() - self._attempted_at_s < RETRY_S:
                    return False
                self.__enter__()
            if self._sender is not None:
                self._sender.publish([message])
            return True
        except NotDelivered:
            self.__exit__()
            self._sender = None
            return False


def estimate_json(line: str, unit: UnitKey) -> str:
    """Return one row as JSON, null for a missing number; raise `InputError` for an invalid row."""
    cells = line.rstrip("\r\n").split(",", len(COLUMNS) - 1)
    try:
        numbers = [float(cell) if cell else math.nan for cell in cells[:4]]
        row = dict(zip(COLUMNS, [*numbers, *cells[4:]], strict=True))
    except ValueError as error:
        raise InputError(f"{line[:80]!r}: a row of {', '.join(COLUMNS)} was expected") from error
    finite = {name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in row.items()}
    return json.dumps({"lot": unit.lot_id, "serial": unit.serial, **finite})
