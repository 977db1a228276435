"""Checks before the REST routes: host, token, and size and time limits of header and body.

One ASGI layer that refuses before a byte of a body is read, and the protocol that lets half-sent heads go. What it
refuses it refuses as every other error: one line of `application/problem+json`.
"""

import asyncio
import hashlib
import ssl
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import h11
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from softcal.app.rest.problem import SIGN_IN, Headers, problem
from softcal.core.errors import InputError, RegistryError
from softcal.db.entries import User

MAX_BODY = 64 * 1024
"""Bytes of a request's body; no request of softcal needs a tenth of it."""

MAX_HEAD = 16 * 1024
"""Bytes of a request's head."""

HEAD_S, BODY_S = 10.0, 10.0
"""A head, counted from the connection or the last answer, and a body have to be there within that time. Who reads
nothing of an answer for as long as a head may take is closed, too."""

MAX_CONNECTIONS = 256
"""With more, the one whose peer has waited longest is closed: who says or reads nothing shuts nobody out."""

PUBLIC_PATHS = ("/health", "/openapi.json")
"""What needs no token."""


class RequestGuard:
    """ASGI middleware: host, token, size of the body, and ETag of an answer.

    Args:
        user_of: returns the account of a token (`InputError`: no valid token).
        hosts: names under which this server may be asked, without port.
    """

    def __init__(self, app: ASGIApp, user_of: Callable[[str], User], hosts: Sequence[str]) -> None:
        self._app, self._user_of, self._hosts = app, user_of, frozenset(host.lower() for host in hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or pass it on with the account in `state.user` and the whole body, and add an ETag."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope)
        refusal = self._refusal(headers) or await self._sign_in(scope, headers)
        if refusal is None:
            try:
                body = await _read_body(receive, headers)
            except _RequestRefused as refused:
                refusal = refused.answer
            except ClientDisconnect:
                return
            else:
                answer = _EtagSender(send, headers.one("if-none-match")) if scope["method"] == "GET" else None
                await self._app(scope, _replay(body, receive), send if answer is None else answer.take)
                return
        # The body stays where it is: a connection that went on would have to read it.
        refusal.headers["connection"] = "close"
        await refusal(scope, receive, send)

    def _refusal(self, headers: Headers) -> Response | None:
        hosts = headers.all("host")
        if len(hosts) != 1 or _host_name(hosts[0]) not in self._hosts:
            return problem(400, "this server is not known under this name; start it with --name, or ask it by its own")
        if headers.size() > MAX_HEAD:
            return problem(431, f"a head of at most {MAX_HEAD // 1024} KiB was expected; nothing was done")
        return None

    async def _sign_in(self, scope: Scope, headers: Headers) -> Response | None:
        if scope["path"] in PUBLIC_PATHS or not scope["path"].startswith("/v1/"):
            return None
        kind, _, secret = headers.one("authorization").partition(" ")
        if kind.lower() != "bearer" or not secret:
            return problem(401, "sign in with a token: `Authorization: Bearer TOKEN`", SIGN_IN)
        try:
            scope.setdefault("state", {})["user"] = await run_in_threadpool(self._user_of, secret.strip())
        except InputError as error:
            return problem(401, str(error), SIGN_IN)
        except RegistryError as error:
            return problem(503, str(error))
        return None


def _host_name(host: str) -> str:
    name, colon, port = host.rpartition(":")
    return (name if colon and port.isdigit() else host).lower().strip("[]")


class _RequestRefused(Exception):
    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.answer = problem(status, f"{detail}; nothing was done")


async def _read_body(receive: Receive, headers: Headers) -> bytes:
    """Return the body; raise `_RequestRefused` if it is too long or too slow, and never pass on a partial body."""
    length, body = headers.one("content-length"), bytearray()
    declared_length = int(length) if length.isdigit() else 0
    try:
        async with asyncio.timeout(BODY_S):
            while max(declared_length, len(body)) <= MAX_BODY:
                message = await receive()
                if message["type"] == "http.disconnect":
                    raise ClientDisconnect
                body += message.get("body", b"")
                if not message.get("more_body") and len(body) <= MAX_BODY:
                    return bytes(body)
    except TimeoutError as error:
        raise _RequestRefused(408, f"the body did not come within {BODY_S:g} s") from error
    raise _RequestRefused(413, f"a body of at most {MAX_BODY // 1024} KiB was expected")


def _replay(body: bytes, receive: Receive) -> Receive:
    parts = [body]

    async def read() -> Message:
        return {"type": "http.request", "body": parts.pop(), "more_body": False} if parts else await receive()

    return read


class _EtagSender:
    """Buffers a complete answer, then sends it with its ETag, or 304 if the client has it already."""

    def __init__(self, send: Send, if_none_match: str) -> None:
        self._send, self._if_none_match, self._body = send, if_none_match, bytearray()
        self._start: Message = {}

    async def take(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._start = {**message, "headers": list(message.get("headers", ()))}
            return
        self._body += message.get("body", b"")
        if message.get("more_body"):
            return
        if self._start["status"] == 200:
            etag = f'"{hashlib.sha256(self._body).hexdigest()[:32]}"'
            # What is said of a unit may change at any time, and is for who may read it.
            self._start["headers"] += [(b"etag", etag.encode()), (b"cache-control", b"private, no-cache")]
            if is_etag_listed(etag, self._if_none_match):
                etag_headers = (b"etag", b"cache-control")
                headers = [(name, value) for name, value in self._start["headers"] if name in etag_headers]
                self._start, self._body = {**self._start, "status": 304, "headers": headers}, bytearray()
        await self._send(self._start)
        await self._send({"type": "http.response.body", "body": bytes(self._body)})


def is_etag_listed(etag: str, if_none_match: str) -> bool:
    """Whether If-None-Match names a tag (RFC 9110, 13.1.2: a list, weak or strong, or `*`)."""
    tags = {tag.strip().removeprefix("W/") for tag in if_none_match.split(",")}
    return "*" in tags or etag in tags


class BoundedProtocol(H11Protocol):
    """HTTP/1.1 that waits for a peer no longer than `HEAD_S`: for its TLS handshake, a head, or to read an answer."""

    tls_context: ssl.SSLContext | None = None
    wait_start_s = 0.0
    _wait_timer: asyncio.TimerHandle | None = None
    _early: bytearray | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timeout of the first header; at the limit of connections close the one waiting longest."""
        super().connection_made(transport)
        self._await_peer()
        if len(self.connections) > MAX_CONNECTIONS:
            waiting = [one for one in self.connections if isinstance(one, BoundedProtocol) and one.is_waiting]
            oldest = min(waiting, key=lambda one: one.wait_start_s)
            # It is among the connections until the loop comes to it; it must not be chosen twice.
            oldest._end_wait()
            oldest.transport.abort()
        if self.tls_context is not None:
            # By `create_server` a handshake would count as a connection only once it is over.
            transport.pause_reading()
            self._early = bytearray()
            self.tasks.add(handshake := self.loop.create_task(self._encrypt(transport, self.tls_context)))
            handshake.add_done_callback(self.tasks.discard)

    async def _encrypt(self, transport: asyncio.Transport, context: ssl.SSLContext) -> None:
        encrypted = None
        with suppress(OSError):  # Its handshake failed.
            encrypted = await self.loop.start_tls(transport, self, context, server_side=True)
        if encrypted is None:
            self.connection_lost(ConnectionResetError())
        else:
            super().connection_made(encrypted)
            early, self._early = bytes(self._early or b""), None
            if early:
                self.data_received(early)

    def data_received(self, data: bytes) -> None:
        """Take what was sent; until the encrypted connection is there, put it by: an answer would be readable."""
        if self._early is None:
            super().data_received(data)
        else:
            self._early += data

    @property
    def is_waiting(self) -> bool:
        """Whether the peer has to do something: shake hands, send its head or body, read an answer."""
        return self._wait_timer is not None or self.conn.their_state is h11.SEND_BODY

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the wait."""
        self._end_wait()
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """End the wait once a head is whole."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete and not self.flow.write_paused:
            self._end_wait()

    def on_response_complete(self) -> None:
        """Start the timeout of the next header; close where the next request is there before the answer was read."""
        if not self.transport.is_closing():
            self._await_peer()
            if self.conn.trailing_data[0]:
                self.transport.close()
        super().on_response_complete()

    def pause_writing(self) -> None:
        """Start the timeout of a peer that does not read."""
        super().pause_writing()
        self._await_peer()

    def resume_writing(self) -> None:
        """End it, or start the timeout of the next header."""
        super().resume_writing()
        self._end_wait()
        if self.cycle is None or self.cycle.response_complete:
            self._await_peer()

    def send_400_response(self, msg: str) -> None:  # noqa: V105
        """Refuse a request that is no HTTP, as every other error."""
        answer = problem(400, f"a request of HTTP/1.1 with a head of at most {MAX_HEAD // 1024} KiB was expected")
        headers = [*answer.raw_headers, (b"connection", b"close")]
        start = h11.Response(status_code=400, headers=headers, reason=b"Bad Request")
        for event in (start, h11.Data(data=bytes(answer.body)), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def _await_peer(self) -> None:
        self._end_wait()
        self.wait_start_s = time.monotonic()
        self._wait_timer = self.loop.call_later(HEAD_S, self.transport.abort)

    def _end_wait(self) -> None:
        if self._wait_timer is not None:
            self._wait_timer.cancel()
            self._wait_timer = None
