"""What the server refuses before any page: other names than its own, frames, scripts from elsewhere, its own metrics.

A page of a stranger can make a browser resolve the stranger's name to this machine (DNS rebinding). It would then speak
to it as if it were the stranger's. So a name that is not this server's is refused, of a WebSocket too. An address in
numbers cannot be rebound and is taken.
"""

import ipaddress
import os
import re
import socket
from base64 import b64encode
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path

import streamlit
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS_VARIABLE = "SOFTCAL_HOSTS"
"""Environment variable: other names of this server, with commas between."""

CLOSED = ("/_stcore/metrics", "/_stcore/script-health-check")


def inline_hashes(html: str) -> str:
    """Return the hashes of the scripts that stand in a page (CSP Level 3, 6.7.3.3), with spaces between."""
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    return " ".join(f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'" for text in scripts)


INDEX = Path(streamlit.__file__).with_name("static") / "index.html"
POLICY = (
    f"default-src 'self'; script-src 'self' {inline_hashes(INDEX.read_text(encoding='utf-8'))} blob:; "
    "style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; connect-src 'self' data: blob:; "
    "media-src 'self' data: blob:; object-src 'none'; base-uri 'self'; form-action 'self'; frame-ancestors 'none'"
)
"""Streamlit writes styles at run time, and makes modules of blobs; nothing leaves this machine."""

HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-frame-options", b"DENY"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"same-origin"),
)
HOST = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[A-Za-z0-9._-]+))(?::\d{1,5})?")

REFUSAL = (
    b"This server is not known under this name. Open it by its address in numbers, "
    b"or start `softcal ui` with --host NAME."
)


ELSEWHERE = b"Only a page of this server may ask for this."


def server_names(more: Iterable[str]) -> frozenset[str]:
    """Return the names under which this server may be reached, beside addresses in numbers."""
    hostname = socket.gethostname().lower()
    return frozenset(
        {"localhost", hostname, f"{hostname}.local", *(name.strip().lower() for name in more if name.strip())}
    )


def is_server_name(host: str, names: frozenset[str]) -> bool:
    """Whether a Host names this server: one of its names, or an address in numbers, any port."""
    parts = HOST.fullmatch(host)
    if parts is None:
        return False
    bare = (parts["six"] or parts["name"]).rstrip(".").lower()
    try:
        ipaddress.ip_address(bare)
    except ValueError:
        return bare in names
    return True


def is_same_origin(scope: Scope, host: str) -> bool:
    """Whether a page of this server asks, by the Origin that browsers send (RFC 6454): its host and its port.

    What changes nothing may be asked from anywhere; a program that is no browser sends none.
    """
    headers = {name: value.decode("latin-1").lower() for name, value in scope["headers"]}
    origin: str | None = headers.get(b"origin")
    if origin is None or (scope["type"] == "http" and scope["method"] in ("GET", "HEAD", "OPTIONS")):
        return True
    # A proxy names the host that the browser knows.
    public_host: str = headers.get(b"x-forwarded-host", host.lower()).split(",")[0].strip()
    return origin.partition("://")[2] == public_host


class Guard:
    """ASGI middleware around the application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._names = server_names(os.environ.get(HOSTS_VARIABLE, "").split(","))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse, or hand on and add the headers."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        hosts = [value.decode("latin-1") for name, value in scope["headers"] if name == b"host"]
        if len(hosts) != 1 or not is_server_name(hosts[0], self._names):
            await _refuse(scope, receive, send, 421, REFUSAL)
        elif not is_same_origin(scope, hosts[0]):
            await _refuse(scope, receive, send, 403, ELSEWHERE)
        elif scope["path"].rstrip("/").endswith(CLOSED):
            await _refuse(scope, receive, send, 404, b"")
        else:

            async def send_with_headers(message: Message) -> None:
                if message["type"] == "http.response.start":
                    message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
                await send(message)

            await self._app(scope, receive, send_with_headers)


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, body: bytes) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
