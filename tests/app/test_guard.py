"""What the served application refuses before any page, asked of the real server over plain sockets and by Chromium."""

import base64
import http.client
import os
import socket
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Page

from softcal.app.ui.guard import is_server_name, server_names

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, serve: Callable) -> Iterator[tuple[str, int]]:
    url = f"sqlite:///{tmp_path_factory.mktemp('guard') / 'new.db'}"
    with serve(url, "--host", "line.plant.example") as screen:
        yield "127.0.0.1", screen.port


def status_of_request(address: tuple[str, int], path: str, host: str) -> tuple[int, dict[str, str]]:
    connection = http.client.HTTPConnection(*address, timeout=30)
    connection.request("GET", path, headers={"Host": host})
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}


def handshake(address: tuple[str, int], host: str, origin: str | None = None) -> str:
    """Return the first line of the answer to a WebSocket handshake under a host's name, from a page of `origin`."""
    key = base64.b64encode(os.urandom(16)).decode()
    request = (
        f"GET /_stcore/stream HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nOrigin: {origin or f'http://{host}'}\r\n\r\n"
    )
    with socket.create_connection(address, timeout=30) as wire:
        wire.sendall(request.encode())
        return wire.recv(200).decode().splitlines()[0]


@pytest.mark.parametrize("path", ["/", "/_stcore/health", "/line"])
def test_a_foreign_name_is_refused_and_an_own_one_is_not(address, path):
    assert status_of_request(address, path, f"evil.example:{address[1]}")[0] == 421
    for name in ("127.0.0.1", f"localhost:{address[1]}", "line.plant.example"):
        assert status_of_request(address, path, name)[0] == 200


def test_a_web_socket_under_a_foreign_name_is_refused(address):
    assert " 403 " in f"{handshake(address, f'evil.example:{address[1]}')} "
    assert " 101 " in f"{handshake(address, f'127.0.0.1:{address[1]}')} "


@pytest.mark.parametrize("origin", ["http://127.0.0.1:1", "http://localhost", "http://evil.example", "null"])
def test_a_web_socket_of_another_page_is_refused_be_it_of_this_machine(address, origin):
    assert " 403 " in f"{handshake(address, f'127.0.0.1:{address[1]}', origin)} "


def test_metrics_are_closed_and_no_page_may_be_framed_or_fetch_elsewhere(address):
    assert status_of_request(address, "/_stcore/metrics", "127.0.0.1")[0] == 404
    _, headers = status_of_request(address, "/", "127.0.0.1")
    assert headers["x-frame-options"] == "DENY" and headers["x-content-type-options"] == "nosniff"
    policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
    assert policy["frame-ancestors"] == "'none'" and policy["object-src"] == "'none'"
    assert not {"'unsafe-inline'", "'unsafe-eval'", "data:"} & set(policy["script-src"].split())
    assert "http" not in policy["connect-src"] and "*" not in headers["content-security-policy"]


def test_own_names_are_names_and_no_parts_of_names():
    names = server_names(["line.example"])
    for host in ("[::1]:8501", "192.168.0.7", "LOCALHOST.", "line.example:80"):
        assert is_server_name(host, names) is True, host
    for host in ("x.line.example", "127.0.0.1.evil.example", "localhost:1@evil.example", ""):
        assert is_server_name(host, names) is False, host


def test_the_policy_lets_every_page_of_softcal_be_drawn(address, page: Page):
    refused: list[str] = []
    page.on(
        "console", lambda message: refused.append(message.text) if "Content Security Policy" in message.text else None
    )
    for name in ("line", "lot", "sign_in"):
        page.goto(f"http://{address[0]}:{address[1]}/{name}")
        page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for()
    assert refused == []
