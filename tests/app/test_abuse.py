"""Nobody outside slows the line: the REST server and the screens under a flood of everything, memory and handles flat.

`SOFTCAL_ABUSE_S` says how many seconds each lasts.
"""

import http.client
import itertools
import os
import random
import resource
import shutil
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError
from sqlalchemy.pool import NullPool

from softcal.core.lot import Lot
from softcal.db.connection import open_registry
from tests.system_packages import NO_POSTGRESQL

pytestmark = [pytest.mark.long, pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")]
LASTS_S = float(os.environ.get("SOFTCAL_ABUSE_S", "20"))
ADMIN_URL = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
SOFTCAL = str(Path(sys.executable).with_name("softcal"))
MB = 2**20


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, calibrated: str, require) -> Iterator[str]:
    """A registry with a lot, on both databases."""
    if request.param == "sqlite":
        yield calibrated
        return
    engine = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT", poolclass=NullPool)
    name = f"softcal_test_{uuid.uuid4().hex[:12]}"
    try:
        with engine.connect() as admin:
            admin.execute(text(f"CREATE DATABASE {name}"))
    except OperationalError:
        require(False, NO_POSTGRESQL)
    database_url = engine.url.set(database=name).render_as_string(hide_password=False)
    with open_registry(database_url) as registry:
        registry.lots.add(Lot("small", "A0", 50.0))
    yield database_url
    with engine.connect() as admin:
        admin.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))


def cut_connections(url: str) -> None:
    """End every connection of a registry on PostgreSQL, as its restart does."""
    if url.startswith("postgresql"):
        engine = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT", poolclass=NullPool)
        with engine.connect() as admin:
            name = url.rpartition("/")[2]
            admin.execute(text(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'"))


@dataclass
class Flood:
    """Requests of people who mean ill, from several threads, until the block ends; their errors are theirs."""

    port: int
    attacks: tuple[Callable[["Flood"], None], ...]
    count: int = 0

    def __enter__(self) -> "Flood":
        self.over = threading.Event()
        self._threads = [threading.Thread(target=self._run, args=(seed,)) for seed in range(3)]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.over.set()
        for thread in self._threads:
            thread.join()

    def _run(self, seed: int) -> None:
        draw = random.Random(seed)
        while not self.over.is_set():
            with suppress(OSError, http.client.HTTPException):
                draw.choice(self.attacks)(self)
            self.count += 1

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=5)
        try:
            connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
            answer = connection.getresponse()
            answer.read()
            return answer.status
        finally:
            connection.close()

    def send(self, content: bytes, waits_s: float) -> None:
        with socket.create_connection(("127.0.0.1", self.port), timeout=5) as connection:
            connection.sendall(content)
            self.over.wait(waits_s)


def big_body(flood: Flood) -> None:
    flood.send(b"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 600000000\r\n\r\n" + bytes(MB), 0.0)


def slow_head(flood: Flood) -> None:
    flood.send(b"GET /v1/me HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ", 1.0)


def long_head(flood: Flood) -> None:
    flood.ask("GET", "/v1/me", X_Long="a" * 60_000)


def wrong_host(flood: Flood) -> None:
    flood.ask("GET", "/v1/lots", Host="evil.example")


def wrong_token(flood: Flood) -> None:
    flood.ask("GET", "/v1/lots", Authorization=f"Bearer softcal_{random.random()}")


def wrong_origin(flood: Flood) -> None:
    flood.ask("POST", "/browser-memory", b"guessed", Origin="http://127.0.0.1:1", X_Softcal_Key="1")


def guessed_ticket(flood: Flood) -> None:
    flood.ask("POST", "/browser-memory", b"x" * 100_000, X_Softcal_Key="1")


def nonsense(flood: Flood) -> None:
    flood.send(random.randbytes(2000), 0.1)


def memory_of(pid: int) -> int:
    """Resident bytes of a process and its children."""
    pids = [pid, *map(int, subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True).stdout.split())]
    lines = [line for one in pids for line in Path(f"/proc/{one}/status").read_text().splitlines()]
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmRSS"))


def handles_of(pid: int) -> int:
    """Open handles of a process and its children."""
    pids = [pid, *map(int, subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True).stdout.split())]
    return sum(len(os.listdir(f"/proc/{one}/fd")) for one in pids)


@pytest.fixture
def server(url: str, add_everybody, some_port, tmp_path: Path) -> Iterator[tuple[int, int, str]]:
    """Port and process id of `softcal api serve`, and a token."""
    add_everybody(url)
    with open_registry(url) as registry:
        token = registry.tokens.add("Erin", "a test", 1)[1]
    port = some_port()
    environment = os.environ | {"XDG_DATA_HOME": str(tmp_path / "data"), "SOFTCAL_LOGS": str(tmp_path / "logs")}
    command = [SOFTCAL, "api", "serve", "--port", str(port), "--registry", url]
    with (tmp_path / "server.log").open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
    try:
        deadline_s = time.monotonic() + 60
        while time.monotonic() < deadline_s:
            with suppress(OSError):
                socket.create_connection(("127.0.0.1", port), timeout=1).close()
                break
            time.sleep(0.2)
        yield port, process.pid, token
    finally:
        process.terminate()
        process.wait(timeout=30)


def test_the_rest_server_under_a_flood_serves_who_has_a_token_and_stays_as_large_as_it_is(server, url):
    port, pid, token = server
    attacks = (big_body, slow_head, long_head, wrong_host, wrong_token, nonsense)
    answers, writes_s, sizes, number = [], [], [], itertools.count()
    with Flood(port, attacks) as flood, open_registry(url) as registry:
        end_s = time.monotonic() + LASTS_S
        while time.monotonic() < end_s:
            answers.append(flood.ask("GET", "/v1/lots", Authorization=f"Bearer {token}"))
            begun_s = time.monotonic()
            registry.lots.add(Lot(f"L{next(number)}", "S0", 50.0))
            writes_s.append(time.monotonic() - begun_s)
            sizes.append((memory_of(pid), handles_of(pid)))
            if len(answers) == 5:
                cut_connections(url)
    # What is cut in the middle may be refused once, with the word when to ask again.
    assert answers.count(200) >= len(answers) - 2 and set(answers) <= {200, 503}, answers
    assert flood.count > len(attacks) and max(writes_s) < 5
    warm, last = sizes[len(sizes) // 3], sizes[-1]
    assert last[0] - warm[0] < 30 * MB and last[1] - warm[1] < 60, sizes


def test_a_full_disk_and_a_file_that_grows_no_more_are_reported_and_nothing_ends(server, url):
    if not url.startswith("sqlite"):
        return
    port, pid, token = server
    flood = Flood(port, ())
    headers = {"Authorization": f"Bearer {token}", "Content_Type": "application/json"}
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, before[1]))
    full = [flood.ask("POST", "/v1/jobs", b'{"lot": "small"}', **headers) for _ in range(3)]
    reads = flood.ask("GET", "/v1/lots", **headers)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
    assert set(full) == {503} and reads == 200
    assert flood.ask("POST", "/v1/jobs/" + "0" * 32 + "/cancel", **headers) == 404


def test_the_screens_under_a_flood_stay_as_large_as_they_are(calibrated, serve, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    shutil.rmtree(tmp_path / "data", ignore_errors=True)
    with serve(calibrated) as screen:
        pid, answers, sizes = screen._process.pid, [], []
        with Flood(screen.port, (wrong_host, wrong_origin, guessed_ticket, long_head, nonsense)) as flood:
            end_s = time.monotonic() + LASTS_S
            while time.monotonic() < end_s:
                answers.append(flood.ask("GET", "/_stcore/health"))
                sizes.append((memory_of(pid), handles_of(pid)))
                time.sleep(0.2)
        assert set(answers) == {200}
        warm, last = sizes[len(sizes) // 3], sizes[-1]
        assert last[0] - warm[0] < 30 * MB and last[1] - warm[1] < 60, sizes
