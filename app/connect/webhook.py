"""Events as signed HTTP POSTs: CloudEvents, signed by standardwebhooks.com (1.0)."""

import base64
import binascii
import hashlib
import hmac
import json
import os
import secrets
import ssl
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import httpx2

from softcal.app.connect.events import RegistryEvent
from softcal.app.connect.forwarder import NotDelivered
from softcal.app.connect.settings import WebhookSettings, read_secret
from softcal.core.errors import InputError

SECRET_PREFIX = "whsec_"
CONTENT_TYPE = "application/cloudevents+json; charset=utf-8"
MIN_KEY_BYTES, MAX_KEY_BYTES = 24, 64
"""Bytes of a key, as Standard Webhooks asks for."""


def new_secret() -> str:
    """Return a new secret for signatures."""
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(32)).decode()


def write_new_secret(path: Path) -> None:
    """Write a new secret that only its owner may read (`InputError`: the file exists, or cannot be written)."""
    try:
        with os.fdopen(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w", encoding="utf-8") as file:
            file.write(new_secret() + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; a secret is never overwritten") from error


def parse_secret(secret: str) -> bytes:
    """Return the key of a secret; raise `InputError` if `softcal connect secret` did not write it."""
    try:
        key = base64.b64decode(secret.removeprefix(SECRET_PREFIX), validate=True)
    except binascii.Error:
        key = b""
    if not secret.startswith(SECRET_PREFIX) or not MIN_KEY_BYTES <= len(key) <= MAX_KEY_BYTES:
        raise InputError(
            "the secret of a webhook begins with whsec_ and holds 24 to 64 bytes; `softcal connect secret`"
        )
    return key


def sign_event(key: bytes, event_id: str, timestamp: int, body: bytes) -> str:
    """Return `v1,` and the HMAC-SHA-256 of `ID.TIMESTAMP.BODY` in base64."""
    signed = b".".join([event_id.encode(), str(timestamp).encode(), body])
    return f"v1,{base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()}"


@contextmanager
def open_webhook(settings: WebhookSettings, clock_s: Callable[[], float] = time.time) -> Iterator["WebhookSender"]:
    """Open the sender of a webhook (`InputError`: its secret or certificates cannot be read)."""
    key = parse_secret(read_secret(settings.secret_file))
    verify = tls_context(settings.ca_file)
    with httpx2.Client(verify=verify, timeout=settings.timeout_s, follow_redirects=False, trust_env=False) as client:
        yield WebhookSender(client, settings.url, key, clock_s)


def tls_context(ca_file: Path | None) -> ssl.SSLContext:
    """Return what checks a server's certificate (`InputError`: the file holds no certificates)."""
    try:
        return ssl.create_default_context(cafile=ca_file)
    except (OSError, ssl.SSLError) as error:
        raise InputError(f"certificates {ca_file} cannot be read: {error}") from error


class WebhookSender:
    """Posts events one by one; any answer 2xx confirms."""

    max_events = 20

    def __init__(self, client: httpx2.Client, url: str, key: bytes, clock_s: Callable[[], float]) -> None:
        self._client, self._url, self._key, self._clock_s = client, url, key, clock_s

    def send(self, events: Sequence[RegistryEvent]) -> None:
        """Post events in order; raise `NotDelivered` for an answer other than 2xx, or without one."""
        for number, event in enumerate(events):
            body = json.dumps(event.to_json(), ensure_ascii=False, separators=(",", ":")).encode()
            timestamp = int(self._clock_s())
            headers = {
                "content-type": CONTENT_TYPE,
                "webhook-id": event.event_id,
                "webhook-timestamp": str(timestamp),
                "webhook-signature": sign_event(self._key, event.event_id, timestamp, body),
            }
            try:
                answer = self._client.post(self._url, content=body, headers=headers)
            except httpx2.HTTPError as error:
                raise NotDelivered(f"{self._url} did not answer: {error or type(error).__name__}", number) from error
            if not answer.is_success:
                raise NotDelivered(f"{self._url} answered {answer.status_code}; 2xx was expected", number)
