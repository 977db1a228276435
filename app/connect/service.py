"""`softcal connect`: every destination in its own thread until the end, or a check of each."""

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from functools import partial

from softcal.app.connect.alert_monitor import AlertMonitor
from softcal.app.connect.forwarder import Destination, Forwarder
from softcal.app.connect.mail import MailSender, open_mail
from softcal.app.connect.mqtt import MqttSender, list_current_messages, open_mqtt, state_messages
from softcal.app.connect.opcua import serve_opcua
from softcal.app.connect.settings import ConnectSettings, MqttSettings, is_local, split_address
from softcal.app.connect.webhook import open_webhook
from softcal.core.errors import InputError, SoftcalError
from softcal.db.registry import Registry

EVERY_S = 0.5
"""Between two looks for new events."""

Trouble = Callable[[str], None]


def run_connect(
    registry: Registry, settings: ConnectSettings, stop: threading.Event, on_trouble: Trouble = lambda _: None
) -> None:
    """Serve all destinations until `stop` is set.

    `InputError`: nothing to do, an unreadable secret or certificate, or a taken port.
    """
    destinations = [
        *(Destination(one, partial(open_webhook, one)) for one in settings.webhooks),
        *(Destination(one, partial(open_mail, one)) for one in settings.mails),
        *(Destination(one, _open_mqtt(registry, one)) for one in settings.mqtts),
    ]
    tasks: list[Callable[[], None]] = [partial(_forward, registry, one, stop, on_trouble) for one in destinations]
    if (opcua := settings.opcua) is not None:
        tasks.append(lambda: asyncio.run(serve_opcua(registry, opcua, stop.is_set, on_trouble)))
    if not tasks:
        raise InputError("the file names no destination; docs/connect.md shows how")
    if settings.alerts_every_s:
        tasks.append(partial(_monitor_alerts, registry, settings.alerts_every_s, stop, on_trouble))
    with ThreadPoolExecutor(len(tasks), thread_name_prefix="connect") as threads:
        running = [threads.submit(work) for work in tasks]
        try:
            done, _ = wait(running, return_when=FIRST_EXCEPTION)
        finally:
            stop.set()
        for finished in done:
            finished.result()


def _open_mqtt(registry: Registry, one: MqttSettings) -> Callable[[], AbstractContextManager[MqttSender]]:
    return partial(open_mqtt, one, partial(state_messages, registry), partial(list_current_messages, registry, one))


def check_destinations(settings: ConnectSettings) -> Iterator[str]:
    """Try every destination once, sending nothing; name each once reached (`InputError`: why one was not)."""
    for webhook in settings.webhooks:
        with open_webhook(webhook):
            parts = split_address("url", webhook.url)
            host, port = parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80)
            try:
                socket.create_connection((host, port), timeout=5).close()
            except OSError as error:
                cause = error.strerror or error
                raise InputError(f"{webhook.name}: {host}:{port} cannot be reached: {cause}") from error
        yield webhook.name
    for mail in settings.mails:
        MailSender(mail).check()
        yield mail.name
    for mqtt in settings.mqtts:
        with open_mqtt(mqtt):
            pass
        yield mqtt.name
    if settings.opcua is not None:
        parts = split_address("endpoint", settings.opcua.endpoint)
        with socket.socket() as probe:
            try:
                probe.bind((parts.hostname if is_local(parts.hostname or "") else "0.0.0.0", parts.port or 0))
            except OSError as error:
                raise InputError(f"{settings.opcua.endpoint}: nobody can listen there: {error.strerror}") from error
        yield "opcua"


def _forward(registry: Registry, destination: Destination, stop: threading.Event, on_trouble: Trouble) -> None:
    with Forwarder(registry, destination, partial(datetime.now, UTC)) as forwarder:
        _repeat(forwarder.step, destination.settings.name, EVERY_S, stop, on_trouble)


def _monitor_alerts(registry: Registry, every_s: float, stop: threading.Event, on_trouble: Trouble) -> None:
    monitor = AlertMonitor(registry)

    def update() -> bool:
        monitor.update(datetime.now(UTC))
        return False

    _repeat(update, "alerts", every_s, stop, on_trouble)


def _repeat(step: Callable[[], bool], name: str, every_s: float, stop: threading.Event, on_trouble: Trouble) -> None:
    """Repeat steps until `stop` is set, at once if more is to do; retry an unreachable registry."""
    while not stop.is_set():
        try:
            has_more = step()
        except SoftcalError as error:
            on_trouble(f"{name}: {error}")
            has_more = False
        if not has_more:
            stop.wait(every_s)
