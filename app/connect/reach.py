"""Tries every destination once without sending anything."""

import socket
from collections.abc import Iterator

from softcal.app.connect.settings import ConnectSettings, is_here, split_address
from softcal.core.errors import InputError


def reach(settings: ConnectSettings) -> Iterator[str]:
    """Give the name of each destination once it was reached.

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
