"""Memory and open handles of each service over time, while it is worked hard and abused.

    python benchmarks/service_memory.py SERVICE [--minutes 10] [--warm-up 5]

`rest`: requests with a token amid large bodies, half-sent heads, wrong hosts and tokens. `desk`: a browser opens pages
and drops files. `connect`: verdicts go out by webhook, MQTT and OPC UA, whose receivers fail and restart. `station`:
units are pressed, and every fifth meets a fault. The time after the warm-up is cut into blocks; a slope is that of the
least-squares line through their means, with Student's 95 % interval.
"""

import argparse
import asyncio
import http.client
import itertools
import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from asyncua import Client
from common.command import Commands
from common.registries import SOFTCAL, begin_lot
from common.screens import chromium, free_port, served_by
from common.tables import print_table
from playwright.sync_api import FilePayload
from scipy.stats import linregress, t

from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.orders import Order, OrderKind, Progress
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

EVERY_S = 2.0
BLOCKS = 10
LOT, STATION = "bench", "line-1"
PAGES = ("lots", f"lot?lot={LOT}", f"lot?lot={LOT}&tab=units", "new_lot", "gap", "station", "settings")
FAULT = "readout unplugged while pressing"
SHORT = ("--speed", "4", "--unit-seconds", "12", "--source-seconds", "25", "--hidden", "12,6")

Step = Callable[[int], None]
"""One piece of work, by its number."""


class Sampler:
    """Memory in MB, open handles and left files of a process and its children, over time."""

    def __init__(self, process_id: int, folder: Path) -> None:
        self.rows: list[tuple[float, float, int, int]] = []
        self._process_id, self._folder, self._is_over = process_id, folder, threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> "Sampler":
        self._began_s = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._is_over.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._is_over.wait(EVERY_S):
            with suppress(OSError, StopIteration):
                ids = list(_family(self._process_id))
                handles = sum(len(os.listdir(f"/proc/{one}/fd")) for one in ids)
                files = sum(path.is_file() for path in self._folder.rglob("*"))
                self.rows.append((time.monotonic() - self._began_s, sum(map(_memory_MB, ids)), handles, files))


def _family(process_id: int) -> Iterator[int]:
    yield process_id
    for thread in Path(f"/proc/{process_id}/task").iterdir():
        for child in (thread / "children").read_text().split():
            yield from _family(int(child))


def _memory_MB(process_id: int) -> float:
    pages = int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def slope_per_h(t_s: np.ndarray, values: np.ndarray) -> str:
    """Return the slope of values over time per hour, with its 95 % interval from means of blocks."""
    blocks = [np.mean([t_s[rows], values[rows]], axis=1) for rows in np.array_split(np.arange(len(t_s)), BLOCKS)]
    fit = linregress(*np.transpose(blocks))
    return f"{3600 * fit.slope:+.1f} ± {3600 * fit.stderr * t.ppf(0.975, BLOCKS - 2):.1f}"


def measure(name: str, process_id: int, folder: Path, options: argparse.Namespace, steps: tuple[Step, ...]) -> None:
    """Do each step again and again in a thread of its own, and print what became of the service."""
    is_over, done = threading.Event(), [0] * len(steps)

    def repeat(which: int) -> None:
        for number in itertools.count():
            if is_over.is_set():
                return
            steps[which](number)
            done[which] += 1

    threads = [threading.Thread(target=repeat, args=(which,), daemon=True) for which in range(1, len(steps))]
    with Sampler(process_id, folder) as sampler:
        for thread in threads:
            thread.start()
        end_s = time.monotonic() + 60 * (options.warm_up + options.minutes)
        while time.monotonic() < end_s:
            steps[0](done[0])
            done[0] += 1
        is_over.set()
    for thread in threads:
        thread.join()
    rows = np.array(sampler.rows)
    late = rows[rows[:, 0] > 60 * options.warm_up]
    course = [(late[0, k], late[-1, k], slope_per_h(late[:, 0], late[:, k])) for k in (1, 2)]
    head = "service | minutes | work done | samples | memory, MB | per h (95 %) | handles | per h (95 %) | files left"
    (first_MB, last_MB, grows_MB), (first, last, grows) = course
    cells = (f"{first_MB:.1f} to {last_MB:.1f}", grows_MB, f"{first:.0f} to {last:.0f}", grows)
    work = " + ".join(map(str, done))
    print_table(
        head, [(name, f"{options.minutes:g}", work, len(late), *cells, f"{late[0, 3]:.0f} to {late[-1, 3]:.0f}")]
    )


@contextmanager
def running(arguments: list[str], folder: Path) -> Iterator[int]:
    """Run a command of softcal with folders of its own for data and temporary files; give its process."""
    with (folder / "log").open("w") as log:
        process = subprocess.Popen([SOFTCAL, *arguments], stdout=log, stderr=log, env=environment(folder))
    try:
        yield process.pid
    finally:
        if process.poll() is not None:
            print((folder / "log").read_text(), file=sys.stderr)
        process.terminate()
        process.wait(timeout=60)


def environment(folder: Path) -> dict[str, str]:
    """Return an environment in which a service leaves its files in `folder/own`."""
    own = folder / "own"
    own.mkdir(exist_ok=True)
    names = ("XDG_DATA_HOME", "TMPDIR", "SOFTCAL_LOGS")
    return os.environ | dict.fromkeys(names, str(own)) | {"SOFTCAL_REGISTRY": url_of(folder)}


def url_of(folder: Path) -> str:
    """Return the URL of the registry in a folder."""
    return f"sqlite:///{folder / 'registry.db'}"


def wait_for(port: int) -> None:
    """Wait until somebody listens at a port of this machine."""
    while True:
        with suppress(OSError):
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return
        time.sleep(0.2)


def rest(options: argparse.Namespace) -> None:
    """`softcal api serve` amid requests that mean ill."""
    with _folder() as folder, open_registry(url_of(folder)) as registry:
        begin_lot(registry, LOT)
        _refuse(registry, range(300))
        registry.people.set("MES", "engineer", "2580", actor="admin")
        token = registry.tokens.add("MES", "benchmark", 1)[1]
        port = free_port()

        def ask(number: int) -> None:
            path = ("/v1/lots", f"/v1/lots/{LOT}/units?limit=200", "/v1/events", "/openapi.json")[number % 4]
            _ask(port, "GET", path, Authorization=f"Bearer {token}")

        def abuse(number: int) -> None:
            with suppress(OSError, http.client.HTTPException):
                _abuse(port, number % 6)

        with running(["api", "serve", "--port", str(port)], folder) as process_id:
            wait_for(port)
            measure("REST", process_id, folder / "own", options, (ask, abuse, abuse))


def _ask(port: int, method: str, path: str, body: bytes = b"", **headers: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    try:
        connection.request(method, path, body, headers)
        connection.getresponse().read()
    finally:
        connection.close()


def _abuse(port: int, kind: int) -> None:
    match kind:
        case 0:
            _ask(port, "GET", "/v1/lots", Host="evil.example")
        case 1:
            _ask(port, "GET", "/v1/lots", Authorization=f"Bearer softcal_{random.random()}")
        case 2:
            _ask(port, "POST", "/v1/jobs", bytes(2**16 + 1), Authorization="Bearer softcal_none")
        case _:
            contents = {
                3: b"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 600000000\r\n\r\n" + bytes(2**20),
                4: b"GET /v1/me HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: " + b"a" * random.randrange(20_000),
                5: random.randbytes(2000),
            }
            with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
                connection.sendall(contents[kind])
                time.sleep(0.2)


def desk(options: argparse.Namespace) -> None:
    """`softcal ui` while a browser opens its pages and drops files."""
    with _folder() as folder, open_registry(url_of(folder)) as registry, chromium() as browser:
        begin_lot(registry, LOT)
        _refuse(registry, range(300))
        rows = "".join(f"{k / 50},{k % 7}\n" for k in range(20_000))
        command = [sys.executable, "-m", "softcal.app.ui.server", "--server.address=127.0.0.1", "--logger.level=error"]
        with served_by(command, environment(folder)) as (address, process_id):

            def visit(number: int) -> None:
                context = browser.new_context()
                page = context.new_page()
                for path in PAGES:
                    page.goto(f"{address}/{path}")
                    page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for(timeout=60_000)
                    if path == "new_lot":
                        content = f"t_s,output\n{number},0\n{rows}".encode()
                        drop = FilePayload(name=f"U{number}.csv", mimeType="text/csv", buffer=content)
                        page.locator("input[type=file]").first.set_input_files([drop])
                        page.get_by_text(f"U{number}.csv").first.wait_for(timeout=60_000)
                context.close()

            measure("desk", process_id, folder / "own", options, (visit,))


class _Receiver(BaseHTTPRequestHandler):
    """Takes four posts of five."""

    count = itertools.count()

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.send_response(503 if next(self.count) % 5 == 4 else 204)
        self.end_headers()

    def log_message(self, *arguments: object) -> None:  # type: ignore[override]
        pass


def connect(options: argparse.Namespace) -> None:
    """`softcal connect run` with all kinds of destinations, whose receivers fail and restart."""
    with _folder() as folder, open_registry(url_of(folder)) as registry:
        begin_lot(registry, LOT)
        hook = ThreadingHTTPServer(("127.0.0.1", 0), _Receiver)
        threading.Thread(target=hook.serve_forever, daemon=True).start()
        broker, opcua = free_port(), free_port()
        subprocess.run([SOFTCAL, "connect", "secret", "--out", str(folder / "secret")], check=True)
        file, endpoint = folder / "plant.toml", f"opc.tcp://127.0.0.1:{opcua}/softcal"
        file.write_text(
            f'[[webhook]]\nname = "mes"\nurl = "http://127.0.0.1:{hook.server_port}/"\nsecret_file = "secret"\n'
            f'[[mqtt]]\nname = "plant"\nbroker = "mqtt://127.0.0.1:{broker}"\n'
            f'[opcua]\nendpoint = "{endpoint}"\n[alerts]\nevery_s = 5\n'
        )
        (folder / "broker").write_text(f"listener {broker} 127.0.0.1\nallow_anonymous true\n")
        command = [shutil.which("mosquitto") or "mosquitto", "-c", str(folder / "broker")]
        brokers = [subprocess.Popen(command, stderr=subprocess.DEVNULL)]

        def judge(number: int) -> None:
            _refuse(registry, range(5 * (number % 60), 5 * (number % 60) + 5))
            time.sleep(0.5)

        def read(number: int) -> None:
            with suppress(OSError, asyncio.TimeoutError):
                asyncio.run(_browse(endpoint))
            time.sleep(2.0)

        def restart(number: int) -> None:
            time.sleep(30.0)
            brokers[0].terminate()
            brokers[0].wait()
            brokers[0] = subprocess.Popen(command, stderr=subprocess.DEVNULL)

        with running(["connect", "run", str(file)], folder) as process_id:
            wait_for(opcua)
            measure("connect", process_id, folder / "own", options, (judge, read, restart))
        brokers[0].terminate()
        hook.shutdown()


async def _browse(endpoint: str) -> None:
    async with Client(endpoint) as client:
        for node in await client.nodes.objects.get_children():
            await node.get_children()


def station(options: argparse.Namespace) -> None:
    """`softcal station serve --simulated` while unit after unit is pressed; every fifth meets a fault."""
    with _folder() as folder, open_registry(url_of(folder)) as registry:
        registry.lots.add(Lot(LOT, "S0", 50.0))
        names = itertools.count()

        def order(kind: OrderKind, serial: str = "", reason: str = "") -> Progress:
            order_id = f"o{next(names)}"
            registry.order_queue.place(Order(order_id, STATION, kind, serial, LOT, "benchmark", reason))
            while (progress := registry.order_queue.progress(order_id)).state.is_active:
                time.sleep(0.1)
            return progress

        def press(number: int) -> None:
            if number % 5 == 4:
                order(OrderKind.FAULT, reason=FAULT)
            progress = order(OrderKind.UNIT, f"U{number}")
            if progress.code:
                order(OrderKind.ACKNOWLEDGE)

        arguments = ["station", "serve", "--simulated", "5", "--name", STATION, "--spool", str(folder / "spool")]
        with running([*arguments, *SHORT], folder) as process_id:
            while registry.order_queue.heartbeat(STATION) is None:
                time.sleep(0.2)
            order(OrderKind.SOURCE, "S0")
            measure("station", process_id, folder / "own", options, (press,))
        codes = [progress.code for _, progress in registry.order_queue.runs(STATION, 10_000)]
        print(f"{len(codes)} runs; ended with a code: {len(codes) - codes.count('')}.")


def _refuse(registry: Registry, numbers: range) -> None:
    with registry.transaction():
        for number in numbers:
            registry.calibrations.refuse(LOT, f"U{number}", "fail", (plain("dead"),))


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as name:
        yield Path(name)


def main() -> None:
    """Run the command of one service."""
    commands = Commands(__doc__)
    for work in (rest, desk, connect, station):
        parser = commands.add(work)
        parser.add_argument("--minutes", type=float, default=10.0)
        parser.add_argument("--warm-up", type=float, default=5.0, help="minutes before (default 5)")
    commands.run()


if __name__ == "__main__":
    main()
