"""How long a stop takes from the key, or from the order, to the stage's controller, through service and registry.

python benchmarks/station_stop.py [--rounds N] [--browser | --request] [--writer] [--load N]

The simulated rig runs at real time here. The clock starts when F8 is pressed in a Chromium that shows the line's screen
(--browser), when the request is sent that F8 sends (--request), or when the order is placed, and ends when the stop
byte has crossed the wire of the stage.
"""

import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from common.command import parser_of
from common.screens import chromium, served
from common.tables import print_table

from softcal.app.line.host import StationHost
from softcal.app.line.pressed_run import RunStore
from softcal.core.lot import Lot
from softcal.core.orders import Order, OrderKind, Progress, StationState
from softcal.core.profiles import unit_profile
from softcal.core.quality.gate import Gate
from softcal.db.connection import open_registry
from softcal.db.registry import Registry
from softcal.station.bench.bench import Bench, open_simulated_bench
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.tasks.service import Hooks, StationService

STATION, LOT = "line-1", "L1"
PHASES = ("homing", "searching for contact", "feeling the unit", "pressing", "reading the zero return")
GOAL_S, HANG_S = 0.3, 240.0


@dataclass
class Rig:
    """A served simulated station at real time, and the one who orders from it."""

    registry: Registry
    seed: int = 0
    station: SimulatedStation | None = None

    @contextmanager
    def open(self) -> Iterator[Bench]:
        """Open the bench as the service does, again after each stop."""
        self.seed += 1
        with open_simulated_bench(seed=self.seed, time_factor=1.0) as (bench, self.station):
            yield bench

    def order(self, kind: OrderKind) -> str:
        """Place an order."""
        order_id = f"{kind}-{time.monotonic_ns()}"
        serial = "A1" if kind is OrderKind.UNIT else ""
        self.registry.order_queue.place(Order(order_id, STATION, kind, serial, LOT, "benchmark"))
        return order_id

    def until(self, is_so: Callable[[], bool], what: str) -> None:
        """Wait, on a busy machine for long."""
        end_s = time.monotonic() + HANG_S
        while not is_so():
            if time.monotonic() > end_s:
                raise TimeoutError(f"waited for {what}")
            time.sleep(0.005)

    def progress(self, order_id: str) -> Progress:
        """Return how far an order is."""
        return self.registry.order_queue.progress(order_id)

    def is_ready(self) -> bool:
        """Whether a run may be ordered."""
        heartbeat = self.registry.order_queue.heartbeat(STATION)
        return heartbeat is not None and heartbeat.state is StationState.READY and not heartbeat.order_id


def main() -> None:
    """Stop runs in every phase and print the times."""
    parser = parser_of(__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="stops in each phase (default 5)")
    parser.add_argument("--browser", action="store_true", help="from the key in a real browser")
    parser.add_argument(
        "--request", action="store_true", help="from the request of the key, to a server nobody looks at"
    )
    parser.add_argument("--load", type=int, default=0, metavar="N", help="beside N processes that only compute")
    parser.add_argument("--writer", action="store_true", help="while another process keeps the registry writing")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        url = f"sqlite:///{folder}/r.db"
        with open_registry(url) as registry, serving(registry, Path(folder)) as rig:
            registry.lots.add(Lot(LOT, "A0", 50.0))
            way = pressed_key(url) if options.browser else sent_key(url) if options.request else place_order(rig)
            with loaded(options.load), way as stop, busy(options.writer, url):
                report([(phase, [stop_in(rig, phase, stop) for _ in range(options.rounds)]) for phase in PHASES])


@contextmanager
def serving(registry: Registry, folder: Path) -> Iterator[Rig]:
    """Serve the simulated rig in a thread of its own."""
    rig, is_over = Rig(registry), threading.Event()
    profile = unit_profile(np.random.default_rng(1))

    def service(report: Callable[[Progress], None], is_stop_requested: Callable[[], bool]) -> StationService:
        hooks = Hooks(report, is_stop_requested, lambda kind, facts: Gate())
        return StationService(rig.open, {OrderKind.UNIT: profile}, folder, hooks)

    store = RunStore(registry, STATION)
    host = StationHost(registry.order_queue, STATION, store, lambda actor, why: None, service)
    thread = threading.Thread(target=lambda: host.run(lambda: not is_over.is_set()))
    thread.start()
    try:
        rig.until(rig.is_ready, "a station that is ready")
        yield rig
    finally:
        is_over.set()
        thread.join()


@contextmanager
def place_order(rig: Rig) -> Iterator[Callable[[], None]]:
    """Tell the station by an order."""
    yield lambda: None if rig.order(OrderKind.STOP) else None


@contextmanager
def sent_key(url: str) -> Iterator[Callable[[], None]]:
    """Tell the station by the request that the stop key sends."""
    with served(url) as (address, _):
        headers = {"x-softcal-key": "stop"}

        def send() -> None:
            request = urllib.request.Request(f"{address}/line-stop", STATION.encode(), headers, method="POST")
            urllib.request.urlopen(request, timeout=HANG_S).close()

        yield send


@contextmanager
def pressed_key(url: str) -> Iterator[Callable[[], None]]:
    """Tell the station by the key, in a browser."""
    with served(url) as (address, _), chromium() as browser:
        page = browser.new_page()
        page.goto(address)
        page.wait_for_selector(".sc-card", timeout=60_000)
        yield lambda: page.keyboard.press("F8")


@contextmanager
def loaded(count: int) -> Iterator[None]:
    """Let so many processes compute beside."""
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


@contextmanager
def busy(is_busy: bool, url: str) -> Iterator[None]:
    """Keep another connection writing, as a batch does: half a second of lock, then a tenth free."""
    is_over = threading.Event()

    def write() -> None:
        with open_registry(url) as registry:
            while not is_over.wait(0.1):
                with registry.database.writing():
                    time.sleep(0.5)

    writer = threading.Thread(target=write)
    if is_busy:
        writer.start()
    try:
        yield
    finally:
        is_over.set()
        if is_busy:
            writer.join()


def stop_in(rig: Rig, phase: str, stop: Callable[[], None]) -> float:
    """Order a run, stop it in this phase, acknowledge; return the seconds from being told to the stop byte."""
    run = run_in(rig, phase)
    time.sleep(np.random.default_rng().uniform(0.0, 0.2))
    station = rig.station
    if station is None:
        raise ValueError("no station is open")
    station.stage.stop_received_s = None
    began_s = time.monotonic()
    is_there = (lambda: station.stage.stop_received_s is not None, "the stop byte")
    waiting = threading.Thread(target=rig.until, args=is_there)
    waiting.start()
    stop()
    waiting.join()
    took_s = time.monotonic() - began_s
    rig.until(lambda: not rig.progress(run).state.is_active, "the end of the run")
    acknowledge(rig)
    return took_s


def run_in(rig: Rig, phase: str) -> str:
    """Order runs until one is in this phase: on a busy machine the simulated devices fall silent now and then."""
    while True:
        run = rig.order(OrderKind.UNIT)
        rig.until(partial(has_come, rig, run, phase), phase)
        progress = rig.progress(run)
        if progress.state.is_active:
            return run
        print(f"not counted, ended before {phase}: {progress.text}", file=sys.stderr, flush=True)
        acknowledge(rig)


def has_come(rig: Rig, run: str, phase: str) -> bool:
    """Whether a run is in this phase, or over."""
    progress = rig.progress(run)
    return progress.phase == phase or not progress.state.is_active


def acknowledge(rig: Rig) -> None:
    """Take what stands there as read."""
    rig.order(OrderKind.ACKNOWLEDGE)
    rig.until(rig.is_ready, "a station that is ready")


def report(times: list[tuple[str, list[float]]]) -> None:
    """Print a row for each phase."""
    every = [*times, ("all", [t for _, some in times for t in some])]
    rows = ((phase, len(took_s), f"{np.median(took_s):.3f}", f"{np.max(took_s):.3f}") for phase, took_s in every)
    print_table("phase | stops | median, s | largest, s", rows)
    print(f"Goal: {GOAL_S} s.")


if __name__ == "__main__":
    main()
