"""`softcal connect`: every destination in its own thread until the end, or tried once."""

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from datetime import UTC, datetime
from functools import partial

from softcal.app.connect.alert_watch import AlertWatch
from softcal.app.connect.forwarder import Destination, forward
from softcal.app.connect.settings import ConnectSettings, OpcUaSettings, is_here, split_address
from softcal.core.errors import InputError, SoftcalError
from softcal.db.registry import Registry

EVERY_S = 0.5
"""Between two looks for new events."""

Trouble = Callable[[str], None]


def destinations(registry: Registry, settings: ConnectSettings) -> list[Destination]:
    """Return the destinations of a file; each imports only what it needs."""
    found: list[Destination] = []
    if settings.webhooks:
        from softcal.app.connect.webhook import open_webhook

        found += [Destination(one, partial(open_webhook, one)) for one in settings.webhooks]
    if settings.mails:
        from softcal.app.connect.mail import open_mail

        found += [Destination(one, partial(open_mail, one)) for one in settings.mails]
    if settings.mqtts:
        from softcal.app.connect.mqtt import open_mqtt, state_messages

        states = partial(state_messages, registry)
        found += [Destination(one, partial(open_mqtt, one, states)) for one in settings.mqtts]
    return found


def run_connect(
    registry: Registry, settings: ConnectSettings, over: threading.Event, on_trouble: Trouble = lambda _: None
) -> None:
    """Serve all destinations until `over` is set.

    Raises:
        InputError: nothing to do, an unreadable secret or certificate, or a taken port.
    """
    works: list[Callable[[], None]] = [
        partial(forward, registry, one, _now, over, EVERY_S, on_trouble) for one in destinations(registry, settings)
    ]
    if settings.opcua is not None:
        works.append(partial(_serve_opcua, registry, settings.opcua, over, on_trouble))
    if not works:
        raise InputError("the file names no destination; docs/connect.md shows how")
    if settings.alerts_every_s:
        works.append(partial(watch_alerts, registry, settings.alerts_every_s, over, on_trouble))
    with ThreadPoolExecutor(len(works), thread_name_prefix="connect") as threads:
        running = [threads.submit(work) for work in works]
        try:
            done, _ = wait(running, return_when=FIRST_EXCEPTION)
        finally:
            over.set()
        for finished in done:
            finished.result()


def reach(settings: ConnectSettings) -> Iterator[str]:
    """Try every destination once, sending nothing; give the name of each once reached.

    Raises:
        InputError: one was not; the line says which, and why.
    """
    for webhook in settings.webhooks:
        from softcal.app.connect.webhook import open_webhook

        with open_webhook(webhook):
            parts = split_address("url", webhook.url)
            _connect(webhook.name, parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80))
        yield webhook.name
    for mail in settings.mails:
        from softcal.app.connect.mail import MailSender

        MailSender(mail).check()
        yield mail.name
    for mqtt in settings.mqtts:
        from softcal.app.connect.mqtt import open_mqtt

        with open_mqtt(mqtt):
            pass
        yield mqtt.name
    if settings.opcua is not None:
        parts = split_address("endpoint", settings.opcua.endpoint)
        with socket.socket() as probe:
            try:
                probe.bind((parts.hostname if is_here(parts.hostname or "") else "0.0.0.0", parts.port or 0))
            except OSError as error:
                raise InputError(f"{settings.opcua.endpoint}: nobody can listen there: {error.strerror}") from error
        yield "opcua"


def _connect(name: str, host: str, port: int) -> None:
    try:
        socket.create_connection((host, port), timeout=5).close()
    except OSError as error:
        raise InputError(f"{name}: {host}:{port} cannot be reached: {error.strerror or error}") from error


def watch_alerts(registry: Registry, every_s: float, over: threading.Event, on_trouble: Trouble) -> None:
    """Look for alerts until `over` is set; a registry that is away for a moment is asked again."""
    watch = AlertWatch(registry)
    while not over.is_set():
        try:
            watch.look(_now())
        except SoftcalError as error:
            on_trouble(f"alerts: {error}")
        over.wait(every_s)


def _serve_opcua(registry: Registry, settings: OpcUaSettings, over: threading.Event, on_trouble: Trouble) -> None:
    from softcal.app.connect.opcua import serve_opcua

    asyncio.run(serve_opcua(registry, settings, over.is_set, on_trouble))


def _now() -> datetime:
    return datetime.now(UTC)
