"""Shared by the tests of the screens: pages drawn in process, and the application in a real browser."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache, partial
from ipaddress import ip_address
from pathlib import Path
from subprocess import DEVNULL
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from playwright.sync_api import Browser, Page, expect, sync_playwright
from streamlit.components.v2 import manifest_scanner
from streamlit.testing.v1 import AppTest

from softcal.app.bootstrap import open_chosen_registry
from softcal.app.cli.main import main
from softcal.app.jobs import launch as job_launch
from softcal.app.jobs.jobs import run_job
from softcal.app.line.serve import Serving
from softcal.app.line.serve import serve as serve_here
from softcal.app.line.station_gate import RIG_ONLY
from softcal.app.ui import account as identity
from softcal.app.ui import browser_memory, server_cache
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Order, OrderKind, RunState, StationState
from softcal.db.connection import open_registry
from softcal.db.registry import Registry
from tests.app.line_screen import LOT, SHORT, STATION, Line, opened

MAIN = Path(identity.__file__).with_name("main.py")
CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-sync",
]
START_S = 120
AS_SERVED: dict[str, Any] = {
    "rules": RIG_ONLY,
    "unit_s": 12.0,
    "source_s": 25.0,
    "network": NetworkConfig(hidden=(12, 6), max_epochs=40),
}
"""What `SHORT` says to the command, for who serves in process."""

SOFTCAL = str(Path(sys.executable).with_name("softcal"))
PINS = {"operator": ("Oh", "1111"), "engineer": ("Erin", "2580"), "quality": ("Quinn", "7777")}


@pytest.fixture(scope="session")
def small_calibrated(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a registry with the small lot calibrated, one unit of it dead."""
    root = tmp_path_factory.mktemp("screens")
    shutil.copytree(trained_lot / "lot", root / "lot")
    shutil.copy(trained_lot / "registry.db", root / "registry.db")
    dead = "t_s,output\n" + "".join(f"{k / 50},0.5\n" for k in range(1500))
    (root / "lot/units/A4.csv").write_text(dead)
    url = f"sqlite:///{root / 'registry.db'}"
    assert main(["batch", str(root / "lot"), "--registry", url, "--hidden", "16,8", "--no-own"]) == 1
    return root / "registry.db"


@pytest.fixture(scope="session", autouse=True)
def packages_looked_through_once() -> Iterator[None]:
    """Streamlit reads the metadata of every installed package whenever a page is drawn in process; here, once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(manifest_scanner, "scan_component_manifests", cache(manifest_scanner.scan_component_manifests))
        yield


@pytest.fixture(autouse=True)
def patient_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """A start waits as long as a busy machine makes it; the tests of a late one set their own time."""
    monkeypatch.setattr("softcal.app.line.line.START_S", 120.0)


@pytest.fixture
def separate_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs and logs of the test lie in its own folder."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("SOFTCAL_LOGS", str(tmp_path / "logs"))


@pytest.fixture
def calibrated(small_calibrated: Path, tmp_path: Path) -> str:
    """The URL of a copy of it, free to be changed."""
    shutil.copy(small_calibrated, tmp_path / "calibrated.db")
    return f"sqlite:///{tmp_path / 'calibrated.db'}"


@pytest.fixture
def open_page(monkeypatch: pytest.MonkeyPatch) -> Callable[..., AppTest]:
    """`open_page(url, page=None, role=None, **query)` draws the application, or one page, as somebody of that role."""

    def show(url: str, page: Callable[[], None] | None = None, role: str | None = None, **query: str) -> AppTest:
        monkeypatch.setenv("SOFTCAL_REGISTRY", url)
        monkeypatch.setattr(browser_memory, "_cookies", dict)
        server_cache.registry.clear()
        make = partial(AppTest.from_file, str(MAIN)) if page is None else partial(AppTest.from_function, page)
        # A busy machine draws slowly; nobody waits here for a time.
        screen = make(default_timeout=120)
        for key, value in query.items():
            screen.query_params[key] = value
        # Nobody draws here who could say so: the whole page at once.
        screen.session_state[browser_memory.HAS_DRAWN] = True
        if role is not None:
            _sign_in(screen, url, role)
        screen.run(timeout=120)
        assert not screen.exception
        return screen

    return show


def _sign_in(screen: AppTest, url: str, role: str) -> None:
    add_people(url)
    identity._sign_ins()[role] = identity.SignIn(PINS[role][0], datetime.now(UTC) + timedelta(hours=1))
    screen.session_state[browser_memory.STATE] = {identity.SESSION: role}


def add_people(url: str) -> None:
    """Put one person of each role into a registry."""
    with open_registry(url) as registry:
        names = {user.name for user in registry.people.all()}
        for role, (name, pin) in PINS.items():
            if name not in names:
                registry.people.set(name, role, pin, actor="test")


@pytest.fixture(scope="session")
def add_everybody() -> Callable[[str], None]:
    """`add_everybody(url)` puts one person of each role into a registry."""
    return add_people


class Screen:
    """The application on a registry, started by its command in a process group of its own.

    Args:
        is_patient: a start is late after minutes; what is late after the seconds of the line is tried where it is not.
    """

    def __init__(self, url: str, options: tuple[str, ...], is_patient: bool = True):
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        command = [SOFTCAL, "ui", "--no-browser", "--port", str(self.port), "--registry", url, *options]
        environment = os.environ | ({"PYTHONPATH": str(Path(__file__).with_name("slow_start"))} if is_patient else {})
        quiet: dict[str, Any] = {"stdout": DEVNULL, "stderr": DEVNULL, "start_new_session": True}
        self._start = partial(subprocess.Popen, command, env=environment, **quiet)
        self.start()

    def __str__(self) -> str:
        return self.address

    def start(self) -> None:
        """Start it and wait until it answers."""
        self._process = self._start()
        wait_for(f"{self.address}/_stcore/health")

    def kill(self) -> None:
        """Kill it as a power cut would."""
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait(timeout=30)

    @contextmanager
    def stalled(self) -> Iterator[None]:
        """It does nothing for a while, as on a machine that is busy with something else."""
        os.killpg(self._process.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.killpg(self._process.pid, signal.SIGCONT)

    def end(self) -> None:
        """End it in good order."""
        self._process.terminate()
        self._process.wait(timeout=30)


@contextmanager
def served(url: str, *options: str, is_patient: bool = True) -> Iterator[Screen]:
    """Serve the application on a registry by its command; give the screen."""
    screen = Screen(url, options, is_patient)
    try:
        yield screen
    finally:
        screen.end()


@pytest.fixture(scope="session")
def serve() -> Callable[..., AbstractContextManager[Screen]]:
    """`with serve(url, *options) as screen`: the application on a registry, by its command."""
    return served


@pytest.fixture(scope="session")
def serve_station() -> Callable[..., AbstractContextManager["ServedStation"]]:
    """`with serve_station(url, name, folder, *options) as station`: a simulated station as a process of its own."""
    return station_served


class ServedStation:
    """A simulated station as a process of its own, started by its command."""

    def __init__(self, url: str, name: str, folder: Path, options: tuple[str, ...]):
        command = [SOFTCAL, "station", "serve", "--simulated", "5", "--name", name, "--registry", url]
        self._command = [*command, "--spool", str(folder / "spool"), *options]
        self._url, self._name, self._log = url, name, folder / "station.log"
        self.start()

    def start(self) -> None:
        """Start it and wait until it answers."""
        with self._log.open("a") as log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=log)
        mine = f"{socket.gethostname()}:{self._process.pid}"
        with open_registry(self._url) as registry:
            deadline_s = time.monotonic() + START_S
            while (heartbeat := registry.order_queue.heartbeat(self._name)) is None or heartbeat.process != mine:
                assert time.monotonic() < deadline_s and self._process.poll() is None, self._log.read_text()
                time.sleep(0.1)

    def kill(self) -> None:
        """Kill it as a power cut would."""
        self._process.kill()
        self._process.wait(timeout=30)

    def end(self) -> None:
        """End it in good order."""
        self._process.terminate()
        self._process.wait(timeout=30)


@contextmanager
def station_served(url: str, name: str, folder: Path, *options: str) -> Iterator[ServedStation]:
    """Serve a simulated station by its command until the block ends."""
    station = ServedStation(url, name, folder, options)
    try:
        yield station
    finally:
        station.end()


@dataclass(frozen=True)
class TlsFiles:
    """Files of a certificate for this machine and of who signed it."""

    ca: Path
    cert: Path
    key: Path


@pytest.fixture(scope="session")
def tls(tmp_path_factory: pytest.TempPathFactory) -> TlsFiles:
    """An authority of the tests, and a certificate of localhost that it signed."""
    folder = tmp_path_factory.mktemp("tls")
    ca_key, ca = _certificate("an authority of tests", None)
    key, cert = _certificate("localhost", (ca_key, ca))
    pem = serialization.Encoding.PEM
    for name, content in (("ca", ca.public_bytes(pem)), ("cert", cert.public_bytes(pem)), ("key", _pem(key))):
        (folder / f"{name}.pem").write_bytes(content)
    return TlsFiles(*(folder / f"{name}.pem" for name in ("ca", "cert", "key")))


def _pem(key: rsa.RSAPrivateKey) -> bytes:
    no_password = serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, no_password)


def _certificate(
    name: str, signer: tuple[rsa.RSAPrivateKey, x509.Certificate] | None
) -> tuple[rsa.RSAPrivateKey, x509.Certificate]:
    key, now = rsa.generate_private_key(65537, 2048), datetime.now(UTC)
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    signing, issuer = (key, subject) if signer is None else (signer[0], signer[1].subject)
    hosts = [x509.DNSName("localhost"), x509.IPAddress(ip_address("127.0.0.1"))]
    names = x509.SubjectAlternativeName([*hosts, x509.UniformResourceIdentifier("urn:softcal:server")])
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(signing.public_key())
    builder = x509.CertificateBuilder(issuer, subject, key.public_key(), x509.random_serial_number())
    builder = builder.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=1))
    builder = builder.add_extension(x509.BasicConstraints(signer is None, None), True).add_extension(names, False)
    builder = builder.add_extension(authority, False)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
    return key, builder.sign(signing, hashes.SHA256())


@pytest.fixture(scope="session")
def some_port() -> Callable[[], int]:
    """`some_port()` gives a TCP port nobody listens at."""
    return free_port


def free_port() -> int:
    """Return a TCP port nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_for(url: str) -> None:
    """Wait until an address answers."""
    deadline_s = time.monotonic() + START_S
    while time.monotonic() < deadline_s:
        try:
            with urllib.request.urlopen(url, timeout=2):
                return
        except (urllib.error.URLError, OSError):
            time.sleep(0.2)
    pytest.fail(f"{url} did not answer within {START_S} s")


@pytest.fixture
def registry(
    calibrated: str, add_everybody: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Registry]:
    """The calibrated lot's registry with everybody in it, the one that commands open."""
    add_everybody(calibrated)
    monkeypatch.setenv("SOFTCAL_REGISTRY", calibrated)
    with open_registry(calibrated) as opened:
        yield opened


@pytest.fixture(scope="session")
def chromium(require_program: Callable[..., str]) -> Iterator[Browser]:
    """One headless Chromium for all tests."""
    path = require_program("chromium")
    expect.set_options(timeout=1000 * START_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def page(chromium: Browser) -> Iterator[Page]:
    """A fresh browser tab; it fails the test when anything outside this machine was asked for."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    addresses: list[str] = []
    context.on("request", lambda request: addresses.append(request.url))
    tab = context.new_page()
    tab.set_default_timeout(1000 * START_S)
    yield tab
    context.close()
    assert not [
        url for url in addresses if not url.startswith(("http://127.0.0.1", "ws://127.0.0.1", "data:", "blob:"))
    ]


@pytest.fixture
def sign_in(page: Page) -> Callable[[str, str], None]:
    """`sign_in(address, role)`: sign in as somebody of a role, by keyboard."""

    def enter(address: str, role: str) -> None:
        name, pin = PINS[role]
        page.goto(f"{address}/sign_in")
        page.get_by_label("Name").fill(name)
        page.get_by_label("PIN").fill(pin)
        page.keyboard.press("Enter")
        page.get_by_role("heading", name=name).wait_for()
        wait_for_memory(page, "session")

    return enter


def wait_for_memory(page: Page, name: str) -> None:
    """Wait until the browser remembers something: it is told at the end of the run that has drawn the page."""
    deadline_s = time.monotonic() + START_S
    while not any(str(cookie.get("name")).endswith(name) for cookie in page.context.cookies()):
        assert time.monotonic() < deadline_s, f"the browser was not told to remember {name!r}"
        page.wait_for_timeout(50)


@pytest.fixture(scope="session")
def remembered() -> Callable[[Page, str], None]:
    """`remembered(page, name)` waits until the browser remembers something."""
    return wait_for_memory


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Line]:
    """A line: a served station with a trained lot, and a screen that shows it."""
    folder = tmp_path_factory.mktemp("line")
    url = f"sqlite:///{folder / 'line.db'}"
    with open_registry(url) as registry:
        _press_source(registry, folder)
        with station_served(url, STATION, folder, *SHORT) as station, served(url) as screen:
            yield Line(registry, screen, station, url)


def _press_source(registry: Registry, folder: Path) -> None:
    """Press the lot's source and train its network, in this process and without its clock."""
    order = Order("source", STATION, OrderKind.SOURCE, "A0", LOT, "engineer", "")
    answers: list[bool] = []

    def goes_on() -> bool:
        heartbeat = registry.order_queue.heartbeat(STATION)
        if not answers and heartbeat is not None and heartbeat.state in (StationState.READY, StationState.CLOSED):
            answers.append(registry.order_queue.place(order))
        return not answers or registry.order_queue.progress(order.order_id).state.is_active

    serve_here(registry, Serving(STATION, simulated_seed=5, speed=1000.0, **AS_SERVED), folder / "spool", goes_on)
    assert registry.order_queue.progress(order.order_id).state is RunState.DONE


@pytest.fixture
def panel(line: Line, page: Page) -> Page:
    """The operator's screen, opened at its address, on a line that is free."""
    line.clear()
    return opened(page, line.screen)


@pytest.fixture
def jobs_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs are done where they are asked for, before the page goes on."""

    def launch(job_id: str, on_end: Callable[[], None] = lambda: None) -> None:
        with open_chosen_registry(None) as registry:
            run_job(registry, job_id, on_cancel=lambda: None)
        on_end()

    monkeypatch.setattr(job_launch, "launch", launch)


@pytest.fixture
def show(open_page, monkeypatch: pytest.MonkeyPatch) -> Callable[..., AppTest]:
    """`show(url, page, role="engineer", **query)` draws one page alone."""

    def draw(url: str, page: str, role: str = "engineer", **query: str) -> AppTest:
        imports = f"from softcal.app.ui.app_pages import {page}\nfrom softcal.app.ui.presentation import show_errors\n"
        source = f"{imports}with show_errors():\n    {page}.render()\n"
        monkeypatch.setattr(AppTest, "from_function", lambda _, **options: AppTest.from_string(source, **options))
        return open_page(url, lambda: None, role=role, **query)

    return draw


@pytest.fixture(scope="session")
def install_example(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], Path]:
    """`install_example(folder)`: where pip has installed it; the tests' own environment does not see it."""

    def install(example: Path) -> Path:
        folder = tmp_path_factory.mktemp("plugin")
        source = shutil.copytree(example, folder / "source", ignore=shutil.ignore_patterns("build", "*.egg-info"))
        offline = ["--no-index", "--no-deps", "--no-build-isolation", "--quiet", "--disable-pip-version-check"]
        command = [sys.executable, "-m", "pip", "install", *offline, "--target", str(folder / "site"), str(source)]
        subprocess.run(command, check=True, capture_output=True)
        return folder / "site"

    return install


@pytest.fixture
def make_lot(trained_lot: Path, press_unit: Callable[..., pd.DataFrame], tmp_path: Path) -> Callable[..., Path]:
    """`make_lot(name, audits, day_gain)`: a lot of the small lot's source; its recordings read on a day with a gain."""

    def make(
        name: str = "large",
        audits: int = 10,
        day_gain: float = 1.0,
        model: str = "EG",
        limit_N: float = 0.8,
        units: int = 14,
    ) -> Path:
        folder = tmp_path / name
        shutil.copytree(trained_lot / "lot/source", folder / "source")
        for part in ("units", "audit"):
            (folder / part).mkdir()
        (folder / "lot.toml").write_text(
            f'sample_rate_Hz = 50.0\nsource = "A0"\n[lot]\nid = "{name}"\nsensor_model = "{model}"\n'
            f'[reference]\nunit = "N"\n[output]\nunit = "V"\n[limit]\nrmse = {limit_N}\n'
        )
        rng = np.random.default_rng(len(name))
        for k in range(units):
            gain, offset_V = 1 + 0.1 * rng.normal(), 0.5 + 0.02 * rng.normal()
            seed = 1000 * len(name) + k
            unit = press_unit(1500, gain, offset_V, seed)
            unit["output"] = 0.5 + day_gain * (unit["output"] - 0.5)
            unit[["t_s", "output"]].to_csv(folder / f"units/{name}-{k:02d}.csv", index=False)
            if k < audits:
                press_unit(900, gain, offset_V, seed + 500).to_csv(folder / f"audit/{name}-{k:02d}.csv", index=False)
        return folder

    return make
