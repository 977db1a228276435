"""Signing in by company account, tried in a real browser against an OpenID provider that runs in the test."""

import base64
import hashlib
import json
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, parse_qsl, urlencode, urlsplit

import pytest
from joserfc import jwt
from joserfc.jwk import RSAKey
from playwright.sync_api import Page

from softcal.app.texts.catalogue import text

pytestmark = pytest.mark.long

CLIENT, SECRET = "softcal", "between softcal and the provider"
LIFE_S = 300
RIG = text("en", "tab.laboratory")
"""A tab of the engineer's."""
ACCOUNTS = """[auth]
redirect_uri = "http://127.0.0.1:{{port}}/oauth2callback"
cookie_secret = "a long random text that only this server knows"
client_id = "{client}"
client_secret = "{secret}"
server_metadata_url = "{issuer}/.well-known/openid-configuration"
"""
ENGINEER = {"sub": "4711", "name": "Emi Ko", "email": "emi@example.com", "roles": ["/plant/line 3/engineer"]}


class Provider:
    """OpenID Connect Core 1.0, authorisation code flow (section 3.1), with PKCE (RFC 7636).

    Args:
        claims: of whoever signs in next.
        ended: addresses that a person was sent back to after signing out.
    """

    def __init__(self) -> None:
        self.claims: dict[str, object] = {}
        self.ended: list[str] = []
        self.key = RSAKey.generate_key(2048, {"kid": "key-1", "use": "sig", "alg": "RS256"})
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self.issuer = f"http://127.0.0.1:{self.server.server_address[1]}"
        self._codes: dict[str, dict[str, str]] = {}

    @property
    def metadata(self) -> dict[str, object]:
        """The discovery document (OpenID Connect Discovery 1.0, section 3)."""
        return {
            "issuer": self.issuer,
            "authorization_endpoint": f"{self.issuer}/authorize",
            "token_endpoint": f"{self.issuer}/token",
            "jwks_uri": f"{self.issuer}/jwks",
            "end_session_endpoint": f"{self.issuer}/end",
            "response_types_supported": ["code"],
            "subject_types_supported": ["public"],
            "id_token_signing_alg_values_supported": ["RS256"],
            "code_challenge_methods_supported": ["S256"],
        }

    def authorise(self, query: dict[str, str]) -> str:
        """Return where the browser goes on, with a code."""
        code = secrets.token_urlsafe(16)
        self._codes[code] = query
        return f"{query['redirect_uri']}?{urlencode({'code': code, 'state': query['state']})}"

    def token(self, query: dict[str, str], credentials: str) -> dict[str, object]:
        """Return the tokens for a code, once, to the client that asked for it."""
        granted = self._codes.pop(query["code"])
        assert credentials == f"{CLIENT}:{SECRET}"
        assert query["redirect_uri"] == granted["redirect_uri"]
        digest = hashlib.sha256(query["code_verifier"].encode()).digest()
        assert base64.urlsafe_b64encode(digest).rstrip(b"=").decode() == granted["code_challenge"]
        now_s = int(time.time())
        life = {"iat": now_s, "exp": now_s + LIFE_S, "nonce": granted["nonce"]}
        claims = {"iss": self.issuer, "aud": CLIENT, **life, **self.claims}
        signed = jwt.encode({"alg": "RS256", "kid": "key-1"}, claims, self.key)
        return {"access_token": secrets.token_urlsafe(16), "token_type": "Bearer", "id_token": signed}


@contextmanager
def provider_served() -> Iterator[Provider]:
    """Serve a provider until the block ends."""
    provider = Provider()
    thread = threading.Thread(target=provider.server.serve_forever, daemon=True)
    thread.start()
    try:
        yield provider
    finally:
        provider.server.shutdown()
        provider.server.server_close()
        thread.join()


def _handler(provider: Provider) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            address = urlsplit(self.path)
            query = dict(parse_qsl(address.query))
            if address.path == "/.well-known/openid-configuration":
                self._answer(provider.metadata)
            elif address.path == "/jwks":
                self._answer({"keys": [provider.key.as_dict(private=False)]})
            elif address.path == "/authorize":
                self._send_on(provider.authorise(query))
            else:
                provider.ended.append(query["post_logout_redirect_uri"])
                self._send_on(query["post_logout_redirect_uri"])

        def do_POST(self) -> None:
            form = parse_qs(self.rfile.read(int(self.headers["Content-Length"])).decode())
            credentials = base64.b64decode(self.headers["Authorization"].removeprefix("Basic ")).decode()
            self._answer(provider.token({name: values[0] for name, values in form.items()}, credentials))

        def _answer(self, content: dict[str, object]) -> None:
            body = json.dumps(content).encode()
            self.send_response(200)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def _send_on(self, address: str) -> None:
            self.send_response(302)
            self.send_header("Location", address)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    return Handler


@pytest.fixture(scope="module")
def company(tmp_path_factory: pytest.TempPathFactory, serve: Callable) -> Iterator[tuple[str, Provider]]:
    """The address of the application with company accounts, and the provider that knows them."""
    folder: Path = tmp_path_factory.mktemp("company")
    with provider_served() as provider:
        file = folder / "accounts.toml"
        file.write_text(ACCOUNTS.format(client=CLIENT, secret=SECRET, issuer=provider.issuer))
        with serve(f"sqlite:///{folder / 'new.db'}", "--accounts", str(file)) as screen:
            yield screen.address, provider


def enter(page: Page, address: str) -> None:
    page.goto(f"{address}/sign_in")
    page.get_by_role("button", name=text("en", "sign_in.company")).click()
    page.wait_for_url("**/lots")  # An empty registry opens with what to do first.


def open_sign_in(page: Page) -> str:
    """Open the page by the bar; return the bar."""
    page.locator(".st-key-bar-person button").click()
    page.get_by_role("heading", name=text("en", "page.settings")).wait_for()
    page.get_by_role("tab").first.wait_for()
    return f"{page.locator('.st-key-bar').inner_text()} {' '.join(page.get_by_role('tab').all_inner_texts())}"


def test_a_company_account_signs_in_with_its_role_and_out_again(company: tuple[str, Provider], page: Page) -> None:
    address, provider = company
    provider.claims = ENGINEER
    enter(page, address)
    bar = open_sign_in(page)
    assert "emi@example.com" in bar and RIG in bar
    page.get_by_text("Engineer").wait_for()
    page.get_by_role("button", name=text("en", "sign_in.leave")).click()
    page.wait_for_url("**/lots")  # An empty registry opens with what to do first.
    assert provider.ended == [f"{address}/oauth2callback"]
    bar = open_sign_in(page)
    assert RIG not in bar
    page.get_by_role("button", name=text("en", "sign_in.company")).wait_for()


def test_a_company_account_without_a_role_gets_none_and_is_told_why(company: tuple[str, Provider], page: Page) -> None:
    address, provider = company
    provider.claims = ENGINEER | {"roles": ["bookkeeper"]}
    enter(page, address)
    bar = open_sign_in(page)
    assert RIG not in bar and "emi@example.com" not in bar
    page.get_by_role("heading", name="emi@example.com").wait_for()
    page.get_by_text(text("en", "sign_in.no_role", claim="").split(".")[0]).wait_for()
    page.get_by_role("button", name=text("en", "sign_in.leave")).wait_for()
