"""The REST server as a stranger meets it: nothing he sends costs memory, a thread, a process or a place for others."""

import concurrent.futures
import json
import os
import shutil
import socket
import ssl
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError
from sqlalchemy.pool import NullPool

from softcal.db.connection import open_registry
from softcal.db.queues.job_board import MAX_WAITING
from tests.system_packages import NO_POSTGRESQL
from tests.wait import wait_until

ADMIN_URL = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
SOFTCAL = str(Path(sys.executable).with_name("softcal"))
PROBLEM = "application/problem+json"
MB = 2**20


@dataclass
class Served:
    """`softcal api serve` as a process of its own, with a token of an engineer."""

    port: int
    pid: int
    token: str
    url: str

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def client(self) -> httpx2.Client:
        return httpx2.Client(base_url=self.address, headers={"Authorization": f"Bearer {self.token}"}, timeout=60)

    def memory(self) -> int:
        status = Path(f"/proc/{self.pid}/status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) * 1024

    def handles(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/fd"))

    def send(self, head: str, body: bytes = b"") -> socket.socket:
        connection = socket.create_connection(("127.0.0.1", self.port), timeout=30)
        connection.sendall(head.replace("\n", "\r\n").encode() + body)
        return connection


@contextmanager
def served(
    url: str, folder: Path, add_everybody: Callable[[str], None], port: int, options: tuple[object, ...] = ()
) -> Iterator[Served]:
    """Serve a registry by the command; its jobs and logs lie in `folder`."""
    add_everybody(url)
    with open_registry(url) as registry:
        token = registry.tokens.add("Erin", "a test", 1)[1]
    environment = os.environ | {"XDG_DATA_HOME": str(folder / "data"), "SOFTCAL_LOGS": str(folder / "logs")}
    log = folder / "server.log"
    with log.open("w") as output:
        command = [SOFTCAL, "api", "serve", "--port", str(port), "--registry", url, *map(str, options)]
        process = subprocess.Popen(command, stdout=output, stderr=output, env=environment)
    try:
        deadline_s = time.monotonic() + 60
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), timeout=5).close()
                break
            except OSError:
                assert time.monotonic() < deadline_s and process.poll() is None, log.read_text()
                time.sleep(0.2)
        yield Served(port, process.pid, token, url)
    finally:
        process.terminate()
        process.wait(timeout=30)


@pytest.fixture(scope="module")
def server(small_calibrated, add_everybody, some_port, tmp_path_factory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("rest")
    shutil.copy(small_calibrated, folder / "registry.db")
    with served(f"sqlite:///{folder / 'registry.db'}", folder, add_everybody, some_port()) as one:
        yield one


@pytest.fixture
def separate_server(calibrated, add_everybody, some_port, tmp_path) -> Iterator[Served]:
    """One that the test may break."""
    with served(calibrated, tmp_path, add_everybody, some_port()) as one:
        yield one


def read_answer(connection: socket.socket) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and what came of the body, until the server ends the connection."""
    content = b""
    try:
        while part := connection.recv(65536):
            content += part
    except ConnectionResetError:
        pass
    head, _, body = content.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines)}
    return int(first.split()[1]), headers, body


HEAD = "POST /v1/jobs HTTP/1.1\nHost: 127.0.0.1\nContent-Type: application/json\n"


@pytest.mark.parametrize("length", ["Content-Length: 600000000", "Transfer-Encoding: chunked"])
def test_who_has_no_token_is_refused_before_a_byte_of_the_body_is_read(server, length):
    begun_s = time.monotonic()
    with server.send(f"{HEAD}{length}\n\n") as connection:
        status, headers, body = read_answer(connection)
    assert (status, headers["content-type"]) == (401, PROBLEM) and time.monotonic() - begun_s < 3
    assert json.loads(body)["status"] == 401


def test_a_body_of_600_MB_without_a_token_costs_no_memory(server):
    before = server.memory()
    connection = server.send(f"{HEAD}Content-Length: {600 * MB}\n\n")
    with connection, pytest.raises(OSError):
        for _ in range(600):
            connection.sendall(bytes(MB))
    assert server.memory() - before < 30 * MB


@pytest.mark.parametrize("is_chunked", [False, True])
def test_a_body_over_64_KiB_is_413_however_it_is_sent(server, is_chunked):
    head = f"{HEAD}Authorization: Bearer {server.token}\n"
    part = b" " * 16384
    if is_chunked:
        answer = server.send(f"{head}Transfer-Encoding: chunked\n\n", (b"4000\r\n" + part + b"\r\n") * 5)
    else:
        answer = server.send(f"{head}Content-Length: {65537}\n\n")
    with answer:
        status, headers, _ = read_answer(answer)
    assert (status, headers["content-type"]) == (413, PROBLEM)


def test_a_body_of_64_KiB_is_read(server):
    with server.client() as client:
        body = json.dumps({"lot": "no such lot"}).encode()
        answer = client.post("/v1/jobs", content=body.ljust(65536), headers={"Content-Type": "application/json"})
    assert answer.status_code == 404, answer.text


def test_heads_and_bodies_that_are_half_sent_are_let_go(server):
    with server.client() as client:
        assert client.get("/v1/lots").status_code == 200
    before = server.handles()
    heads = [server.send("GET /v1/me HTTP/1.1\nHost: 127.0.0.1\nX-A: ") for _ in range(100)]
    bodies = [
        server.send(f"{HEAD}Authorization: Bearer {server.token}\nContent-Length: 100\n\n", b"{") for _ in range(10)
    ]
    silent = [socket.create_connection(("127.0.0.1", server.port), timeout=30) for _ in range(10)]
    open_connection = server.send("GET /health HTTP/1.1\nHost: 127.0.0.1\n\nGET /v1/me HTTP/1.1\nHost:")
    for connection in (*heads, *bodies, *silent, open_connection):
        with connection, suppress(ConnectionResetError):
            while connection.recv(65536):
                pass
    # Of 121 connections none is held; a few are the registry's.
    assert server.handles() <= before + 20


def test_a_flood_of_half_sent_heads_keeps_nobody_out(server):
    flood = []
    try:
        for _ in range(600):
            flood.append(server.send("GET /v1/me HTTP/1.1\nHost: 127.0.0.1\nX-A: "))
        with server.client() as client:
            assert client.get("/v1/me").status_code == 200
        assert server.handles() < 350
    finally:
        for connection in flood:
            connection.close()


def test_bodies_that_are_half_sent_keep_nobody_out(server):
    head = f"{HEAD}Authorization: Bearer {server.token}\nContent-Length: 100\n\n"
    flood = [server.send(head, b"{") for _ in range(400)]
    try:
        with server.client() as client:
            assert client.get("/v1/me").status_code == 200
    finally:
        for connection in flood:
            connection.close()


@pytest.mark.long
def test_who_reads_no_answer_keeps_nobody_out_and_is_let_go(separate_server):
    server, flood = separate_server, []
    before = server.handles()
    for _ in range(300):
        reader = socket.socket()
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        reader.settimeout(0.2)
        flood.append(reader)
        with suppress(OSError):
            reader.connect(("127.0.0.1", server.port))
            reader.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 200)
    try:
        with server.client() as client:
            assert client.get("/v1/me").status_code == 200
        wait_until(lambda: server.handles() <= before + 20, "they are let go")
    finally:
        for connection in flood:
            connection.close()


@pytest.mark.long
def test_who_does_not_shake_hands_keeps_nobody_out(calibrated, add_everybody, some_port, tmp_path, tls):
    options = ("--cert", tls.cert, "--key", tls.key)
    with served(calibrated, tmp_path, add_everybody, some_port(), options) as server:
        before = server.handles()
        address = f"https://127.0.0.1:{server.port}/v1/me"
        trust = ssl.create_default_context(cafile=str(tls.ca))
        sign_in = {"Authorization": f"Bearer {server.token}"}
        flood = [socket.create_connection(("127.0.0.1", server.port), timeout=30) for _ in range(600)]
        try:
            for _ in range(5):
                assert httpx2.get(address, headers=sign_in, verify=trust, timeout=60).status_code == 200
            assert server.handles() < 350
            wait_until(lambda: server.handles() <= before + 20, "they are let go")
            # What is no handshake gets no answer that others could read.
            with server.send("GET /health HTTP/1.1\nHost: 127.0.0.1\n\n") as plain:
                assert b"HTTP" not in plain.recv(100)
        finally:
            for connection in flood:
                connection.close()


@pytest.mark.parametrize(
    ("head", "status"),
    [
        ("GET /v1/me HTTP/1.1\nHost: evil.example\n\n", 400),
        ("GET /v1/me HTTP/1.1\nHost: 127.0.0.1\nHost: evil.example\n\n", 400),
        ("GET /health HTTP/1.0\n\n", 400),
        ("nonsense\n\n", 400),
        (f"GET /v1/me HTTP/1.1\nHost: 127.0.0.1\nX-A: {'a' * 100_000}\n\n", 431),
        ("TRACE /health HTTP/1.1\nHost: 127.0.0.1\n\n", 405),
        ("GET /nothing HTTP/1.1\nHost: 127.0.0.1\n\n", 404),
    ],
    ids=["host", "hosts", "no_host", "nonsense", "long_head", "method", "nothing"],
)
def test_every_refusal_is_a_problem_of_rfc_9457(server, head, status):
    with server.send(head.replace("\n\n", "\nConnection: close\n\n")) as connection:
        status_code, headers, body = read_answer(connection)
    # A head that is too long is refused by who sees it first.
    assert (status_code, headers["content-type"]) == (json.loads(body)["status"], PROBLEM)
    assert status_code == status or (status_code, status) == (400, 431)


@pytest.mark.parametrize(
    "path", ["/v1/lots/small/units?verdicts=fail", "/v1/lots/small/units?limit=1&limit=2", "/v1/me?x=1", "/v1/jobs?a"]
)
def test_a_question_that_is_not_known_is_refused_and_named(server, path):
    with server.client() as client:
        answer = client.get(path)
    assert (answer.status_code, answer.headers["content-type"]) == (422, PROBLEM)
    assert path.partition("?")[2].split("=")[0] in answer.json()["detail"]


@pytest.mark.parametrize("path", ["/v1/lots", "/v1/lots/small/units?verdict=fail", "/v1/lots/small/results.parquet"])
def test_an_answer_that_has_not_changed_is_not_sent_again(server, path):
    with server.client() as client:
        first = client.get(path)
        again = client.get(path, headers={"If-None-Match": f'"other", W/{first.headers["etag"]}'})
        other = client.get(path, headers={"If-None-Match": '"other"'})
        any_one = client.get(path, headers={"If-None-Match": "*"})
    assert first.status_code == other.status_code == 200 and other.content == first.content
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", first.headers["etag"])
    assert any_one.status_code == 304


@pytest.mark.long
def test_a_flood_of_jobs_fills_a_queue_with_a_bound_and_starts_two_processes_at_most(separate_server):
    server = separate_server

    def post(number: int) -> httpx2.Response:
        with server.client() as client:
            return client.post("/v1/jobs", json={"lot": "small"}, headers={"Idempotency-Key": f"k{number}"})

    max_running = 0
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        posts = [pool.submit(post, number) for number in range(3 * MAX_WAITING)]
        while not all(one.done() for one in posts):
            max_running = max(max_running, len(children(server.pid)))
            time.sleep(0.1)
    answers = [one.result() for one in posts]
    refused = [one for one in answers if one.status_code == 429]
    assert {one.status_code for one in answers} == {202, 429} and max_running <= 2
    assert all(int(one.headers["retry-after"]) > 0 for one in refused)
    accepted = [one.json()["job_id"] for one in answers if one.status_code == 202]
    with open_registry(server.url) as registry:
        wait_until(lambda: not any(registry.job_board.job(job).state.is_active for job in accepted), within_s=400)
        assert {str(registry.job_board.job(job).state) for job in accepted} == {"done"}


def children(pid: int) -> list[int]:
    """Living processes that a process has started."""
    pids = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent = status.read_text().rpartition(")")[2].split()[:2]
        except OSError:
            continue
        if int(parent) == pid and state != "Z":
            pids.append(int(status.parent.name))
    return pids


def test_a_registry_that_is_away_says_when_to_ask_again_and_comes_back(add_everybody, some_port, tmp_path, require):
    try:
        admin = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT", poolclass=NullPool).connect()
    except OperationalError:
        require(False, NO_POSTGRESQL)
    name = f"softcal_test_{uuid.uuid4().hex[:12]}"
    with admin:
        admin.execute(text(f"CREATE DATABASE {name}"))
        url = admin.engine.url.set(database=name).render_as_string(hide_password=False)
        try:
            with served(url, tmp_path, add_everybody, some_port()) as server, server.client() as client:
                assert client.get("/v1/lots").status_code == 200
                admin.execute(text(f"ALTER DATABASE {name} ALLOW_CONNECTIONS false"))
                admin.execute(text(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'"))
                away = client.get("/v1/lots")
                admin.execute(text(f"ALTER DATABASE {name} ALLOW_CONNECTIONS true"))
                back = client.get("/v1/lots")
        finally:
            admin.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    assert (away.status_code, away.headers["content-type"]) == (503, PROBLEM), away.text
    assert int(away.headers["retry-after"]) > 0 and back.status_code == 200


def test_the_document_names_every_closed_set(server):
    with server.client() as client:
        document = client.get("/openapi.json").json()
        parts = document["components"]["schemas"]
        assert set(enum_of(parts, "AccountAnswer", "role")) == {"operator", "engineer", "quality"}
    for model, field in [
        ("JobAnswer", "state"), ("JobAnswer", "kind"), ("OrderAnswer", "kind"), ("OrderAnswer", "state"),
        ("OrderAnswer", "verdict"), ("StationAnswer", "state"), ("StationAnswer", "last_verdict"),
        ("EventAnswer", "type"), ("UnitAnswer", "verdict"), ("UnitAnswer", "role"),
    ]:  # fmt: skip
        assert enum_of(parts, model, field), (model, field)


def enum_of(parts: dict, model: str, field: str) -> list[str]:
    """The values that the document allows for a field."""
    values, open_parts = [], [parts[model]["properties"][field]]
    while open_parts:
        part = open_parts.pop()
        if "$ref" in part:
            part = parts[part["$ref"].rpartition("/")[2]]
        values += part.get("enum", [part["const"]] if "const" in part else [])
        open_parts += part.get("anyOf", [])
    return values
