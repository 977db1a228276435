"""Events, states and live estimates over MQTT (OASIS MQTT 3.1.1), quality of service 1: each is confirmed.

Topics below the one of the settings:
- `status`: `online`, or `offline` once this publisher is gone (retained, last will);
- `events`: every event as CloudEvents JSON;
- `lots/LOT/units/SERIAL/verdict`: the newest verdict of a unit (retained);
- `alerts/KIND/LOT/ABOUT`: an open alert (retained; empty once it is over), `-` where it has no lot or no such part;
- `stations/STATION/state`: what a station says of itself (retained);
- `units/SERIAL/estimate`: live estimates, the newest one retained.
"""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from softcal.app.connect.events import CLEARED, RAISED, VERDICT, RegistryEvent, path_part
from softcal.app.connect.forwarder import NotDelivered
from softcal.app.connect.settings import MqttSettings, read_secret, split_address
from softcal.app.connect.stations import station_json
from softcal.app.connect.webhook import tls_context
from softcal.core.errors import InputError
from softcal.db.registry import Registry

PORTS = {"mqtts": 8883, "mqtt": 1883}
ONLINE, OFFLINE = "online", "offline"
KEEP_ALIVE_S = 20
AT_LEAST_ONCE = 1
LOOK_S = 0.2
"""Between two looks at whether the connection still stands."""


Message = tuple[str, str, bool]
"""Topic below the one of the settings, payload, and whether the broker keeps it for who comes later."""

States = Callable[[], Sequence[Message]]


@contextmanager
def open_mqtt(settings: MqttSettings, states: States = tuple) -> Iterator["MqttSender"]:
    """Connect to the broker; the status is `online` inside the block and `offline` after it, however it ends.

    Args:
        states: gives the states that are published whenever they have changed.

    Raises:
        NotDelivered: the broker cannot be reached or refuses.
        InputError: a secret or certificate cannot be read.
    """
    client, parts = _client(settings), split_address("broker", settings.broker)
    status = f"{settings.topic}/status"
    client.will_set(status, OFFLINE, AT_LEAST_ONCE, retain=True)
    sender = MqttSender(client, settings, states)
    try:
        client.connect(parts.hostname or "", parts.port or PORTS[parts.scheme], KEEP_ALIVE_S)
    except (OSError, ValueError) as error:
        raise NotDelivered(f"{settings.broker} cannot be reached: {error}") from error
    client.loop_start()
    try:
        sender.wait_until_connected()
        sender.publish([("status", ONLINE, True)])
        yield sender
    finally:
        # Who says goodbye has no last will; where the connection is cut, the broker says it.
        with suppress(NotDelivered):
            sender.publish([("status", OFFLINE, True)])
        client.disconnect()
        client.loop_stop()


def _client(settings: MqttSettings) -> paho.Client:
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
    return client


class MqttSender:
    """Publishes over one connection; once it is cut this sender is of no more use."""

    most = 200

    def __init__(self, client: paho.Client, settings: MqttSettings, states: States) -> None:
        self._client, self._settings, self._states = client, settings, states
        self._refusal = ""
        self._shown: dict[str, str] = {}
        client.on_connect = self._on_connect

    def wait_until_connected(self) -> None:
        """Return once the broker has taken the connection.

        Raises:
            NotDelivered: it refuses, or does not answer in time.
        """
        end_s = time.monotonic() + self._settings.timeout_s
        while not self._client.is_connected():
            if self._refusal or time.monotonic() > end_s:
                raise NotDelivered(f"{self._settings.broker} refuses: {self._refusal or 'it does not answer'}")
            time.sleep(0.01)

    def send(self, events: Sequence[RegistryEvent]) -> None:
        """Publish events with the states they change, and the states that have changed by themselves.

        Raises:
            NotDelivered: the broker did not confirm them all, or has ended the connection.
        """
        changed = [message for message in self._states() if self._shown.get(message[0]) != message[1]]
        self.publish([*(message for event in events for message in messages_of(event)), *changed])
        self._shown |= {topic: payload for topic, payload, _ in changed}

    def publish(self, messages: Sequence[Message]) -> None:
        """Publish messages and wait until the broker has confirmed each (`NotDelivered`: it did not)."""
        sent = []
        for topic, payload, is_kept in messages:
            full = f"{self._settings.topic}/{topic}"
            sent.append(self._client.publish(full, payload.encode(), AT_LEAST_ONCE, retain=is_kept))
        end_s = time.monotonic() + self._settings.timeout_s
        for waiting in sent:
            while waiting.rc == paho.MQTT_ERR_SUCCESS and self._client.is_connected() and time.monotonic() < end_s:
                waiting.wait_for_publish(LOOK_S)
                if waiting.is_published():
                    break
            else:
                raise NotDelivered(f"{self._settings.broker} has not confirmed what was published")
        if not self._client.is_connected():
            raise NotDelivered(f"{self._settings.broker} has ended the connection")

    def _on_connect(self, client: paho.Client, data: object, flags: object, code: Any, properties: object) -> None:
        if code.is_failure:
            self._refusal = str(code)


def messages_of(event: RegistryEvent) -> list[Message]:
    """Return what is published of an event: itself, and the state it changes."""
    text = json_text(event.to_json())
    messages = [("events", text, False)]
    if event.kind == VERDICT:
        messages.append((f"{event.subject}/verdict", text, True))
    if event.kind in (RAISED, CLEARED):
        parts = (event.data["kind"], event.data["lot"] or "", alert_about(event.data))
        topic = "/".join(path_part(part) or "-" for part in parts)
        messages.append((f"alerts/{topic}", text if event.kind == RAISED else "", True))
    return messages


def alert_about(data: Any) -> str:
    """Return the station or load cell an alert is about; "" without one."""
    return str(data["values"].get("station") or data["values"].get("cell") or "")


def state_messages(registry: Registry) -> list[Message]:
    """Return what is published of every station; whoever watches needs no program of the line for it."""
    found = [station_json(registry, beat) for beat in registry.order_queue.stations()]
    # The time of the last sign of life would be another one every second.
    told = [{name: value for name, value in station.items() if name != "at"} for station in found]
    return [(f"stations/{path_part(one['station'])}/state", json_text(one), True) for one in told]


def json_text(value: object) -> str:
    """Return JSON text without spaces; NaN is refused."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
