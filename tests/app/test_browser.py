"""The application in a real browser: it starts by its command, shows a lot, and asks nobody outside this machine."""

import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, sync_playwright

from softcal.app.cli import main

CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-sync",
]
START_S = 120


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def served(lot_folder: Path, registry_url: str) -> Iterator[str]:
    """The address of the application on a registry with one calibrated lot."""
    assert main(["batch", str(lot_folder), "--registry", registry_url, "--hidden", "16,8", "--no-own"]) in (0, 1)
    port = _free_port()
    command = [str(Path(sys.executable).with_name("softcal")), "ui", "--no-browser", "--port", str(port)]
    server = subprocess.Popen(
        [*command, "--registry", registry_url], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        _wait_for(f"http://127.0.0.1:{port}/_stcore/health")
        yield f"http://127.0.0.1:{port}"
    finally:
        server.terminate()
        server.wait(timeout=30)


def _wait_for(url: str) -> None:
    deadline_s = time.monotonic() + START_S
    while time.monotonic() < deadline_s:
        try:
            with urllib.request.urlopen(url, timeout=2):
                return
        except (urllib.error.URLError, OSError):
            time.sleep(0.2)
    pytest.fail(f"{url} did not answer within {START_S} s")


@pytest.fixture
def page(require) -> Iterator[Page]:
    chromium = shutil.which("chromium")
    require(chromium, "no chromium on this machine; install Debian's package chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=CHROMIUM_FLAGS)
        yield browser.new_page(viewport={"width": 1280, "height": 900})
        browser.close()


def test_a_lot_and_a_unit_are_shown_without_any_outside_request(served: str, page: Page) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(served)
    page.get_by_role("heading", name="Units that need a look").wait_for(timeout=90_000)
    page.goto(f"{served}/unit?unit=A2")
    page.get_by_role("heading", name="What the predicted error is made of").wait_for(timeout=90_000)
    page.get_by_role("heading", name="History").wait_for(timeout=90_000)
    assert not [url for url in asked if not url.startswith((served, "data:", "blob:"))]
