"""Cookies that no script can read: set by an answer of this server, for who brings the ticket of a page.

A page speaks over a WebSocket, which sets no cookie. So it gives its browser a ticket, once and for a moment; the
browser brings it here and gets the cookies: HttpOnly, SameSite=Strict, Secure where the connection is encrypted.
"""

import secrets
import time
from collections.abc import Mapping

from starlette.requests import Request
from starlette.responses import Response

PATH = "/browser-memory"
HEADER = "x-softcal-key"
"""No page of another server can send it: its browser would have to ask this one first."""

TICKET_HOLDS_S = 60.0
TICKET_BYTES = 24
MAX_TICKETS = 1000
COOKIE_AGE_S = 400 * 24 * 3600
"""The longest that browsers keep a cookie (RFC 6265bis, 5.5)."""

_tickets: dict[str, tuple[float, dict[str, str]]] = {}


def new_ticket(cookies: Mapping[str, str]) -> str:
    """Return a ticket for cookies by name; "" removes one."""
    now_s = time.monotonic()
    for old in [ticket for ticket, (until_s, _) in _tickets.items() if until_s < now_s][: len(_tickets)]:
        _tickets.pop(old, None)
    while len(_tickets) >= MAX_TICKETS:
        _tickets.pop(next(iter(_tickets)), None)
    ticket = secrets.token_urlsafe(TICKET_BYTES)
    _tickets[ticket] = now_s + TICKET_HOLDS_S, dict(cookies)
    return ticket


async def set_cookies(request: Request) -> Response:
    """Set the cookies of the ticket that the request brings; 404 where it holds no longer."""
    if HEADER not in request.headers:
        return Response(status_code=403)
    ticket = b""
    async for part in request.stream():
        ticket += part
        if len(ticket) > 4 * TICKET_BYTES:
            return Response(status_code=413)
    until_s, cookies = _tickets.pop(ticket.decode(errors="replace"), (0.0, {}))
    if until_s < time.monotonic():
        return Response(status_code=404)
    answer = Response(status_code=204, headers={"cache-control": "no-store"})
    is_encrypted = "https" in (request.url.scheme, request.headers.get("x-forwarded-proto", "").split(",")[0].strip())
    for name, value in cookies.items():
        # A sign-in ends with the browser; that a machine is known does not.
        max_age = 0 if not value else None if name.endswith("_session") else COOKIE_AGE_S
        answer.set_cookie(name, value, max_age=max_age, path="/", secure=is_encrypted, httponly=True, samesite="strict")
    return answer
