"""Serve the application as a process of its own, shown in a browser or a window."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import webbrowser
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import make_url

from softcal.app.bootstrap import registry_url
from softcal.app.output import echo
from softcal.app.ui.guard import HOSTS_VARIABLE
from softcal.app.ui.uploads import remove_server_folder
from softcal.core.errors import InputError
from softcal.db.schema.database import redacted_url

FIRST_PORT, PORTS = 8501, 50
START_TIMEOUT_S = 60.0
WINDOW_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge", "microsoft-edge")


@dataclass(frozen=True)
class UiOptions:
    """How the application is served.

    Args:
        registry: URL of the registry; None takes the default.
        port: TCP port; 0 takes the first free one from 8501.
        is_window, is_kiosk: open as an application window, full screen.
        accounts: TOML file that names the identity provider for sign-in by company account.
        hosts: other names under which browsers reach this server.
    """

    registry: str | None = None
    port: int = 0
    address: str = "127.0.0.1"
    is_window: bool = False
    is_kiosk: bool = False
    opens_browser: bool = True
    station: str | None = None
    accounts: Path | None = None
    hosts: tuple[str, ...] = ()


def serve(options: UiOptions) -> int:
    """Serve until the window is closed, or for good without one; return the server's exit code.

    Raises:
        InputError: no port is free, the server did not start, or there is no browser.
    """
    window = next(filter(None, map(shutil.which, WINDOW_BROWSERS)), None) if options.is_window else None
    if options.is_window and window is None:
        raise InputError(f"no browser for a window; install one of {', '.join(WINDOW_BROWSERS)}, or leave --window out")
    port = options.port or _free_port(options.address)
    url = f"http://{options.address}:{port}"
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a terminated `softcal ui` takes its server with it
    flags = {"server.port": str(port), "server.address": options.address, "logger.level": "error"}
    if options.accounts is not None:
        flags["secrets.files"] = str(options.accounts.resolve())
    command = [sys.executable, "-m", "softcal.app.ui.server", *(f"--{key}={value}" for key, value in flags.items())]
    extra = {"SOFTCAL_REGISTRY": registry_url(options.registry)}
    if options.station is not None:
        extra["SOFTCAL_STATION"] = options.station
    if options.hosts:
        extra[HOSTS_VARIABLE] = ",".join(options.hosts)
    server = subprocess.Popen(command, env=dict(os.environ) | extra)
    try:
        _wait_until_healthy(server, url)
        registry_name = redacted_url(make_url(registry_url(options.registry)))
        echo(f"softcal is at {url}; Ctrl-C ends the screen, not the station; its registry is {registry_name}")
        if window is not None:
            with tempfile.TemporaryDirectory(prefix="softcal-window-", ignore_cleanup_errors=True) as profile:
                look = [f"--app={url}", f"--user-data-dir={profile}", "--no-first-run"]
                look += ["--disable-background-networking", *(["--kiosk"] if options.is_kiosk else [])]
                subprocess.run([window, *look], check=False)
            return 0
        if options.opens_browser:
            webbrowser.open(url)
        return server.wait()
    except KeyboardInterrupt:
        return 0
    finally:
        server.terminate()
        server.wait()
        remove_server_folder(server.pid)


def _free_port(address: str) -> int:
    for port in range(FIRST_PORT, FIRST_PORT + PORTS):
        with socket.socket() as probe:
            try:
                probe.bind((address, port))
                return port
            except OSError:
                continue
    raise InputError(f"no free port from {FIRST_PORT} to {FIRST_PORT + PORTS - 1} on {address}; give one with --port")


def _wait_until_healthy(server: "subprocess.Popen[bytes]", url: str) -> None:
    deadline_s = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline_s:
        if server.poll() is not None:
            raise InputError(f"the application ended at its start with code {server.returncode}; its output is above")
        try:
            with urllib.request.urlopen(f"{url}/_stcore/health", timeout=2):
                return
        except (urllib.error.URLError, OSError):
            time.sleep(0.1)
    raise InputError(f"the application did not answer at {url} within {START_TIMEOUT_S:.0f} s")
