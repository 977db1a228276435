"""Random sequences of what happens at a line, in Chromium: wrong cards and motions that nobody asked for.

python benchmarks/line_sequences.py [--first 0] [--count 300] [--kept results.jsonl] [--minutes 18]

A station is played by its rows: it takes orders, ends them with a drawn verdict, breaks, falls silent and comes back
as another process. A person scans units, codes and nonsense, presses F2, F4, F6 and F8 once, or twice 0–500 ms apart,
reloads, looks at a second tab; the server is killed and started again. After every event two things are checked:

- The card that the browser shows is the one that the registry says, within the patience below.
- Every run that was ordered has a start of its own: F2 or a scanned start, at most 2.5 s before the order, made while
  the card showed that unit, or while the scan of that unit at that screen was not answered yet. The page itself writes
  down when each key was pressed, and what stood on the card then. No start has two runs.

Each sequence has its seed and one line in the file of `--kept`; those that stand there are not run again. Needs
Chromium and Playwright.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
from playwright.sync_api import BrowserContext, Page
from playwright.sync_api import Error as PlaywrightError
from screens_common import GOOD, LOT, STATION, PlayedLine, chromium, free_port, is_healthy

from softcal.app.line.facts import Screen, read_line
from softcal.app.line.line import take_scan
from softcal.app.texts.catalogue import text
from softcal.app.views.line import LineView, line_view
from softcal.core.errors import SoftcalError
from softcal.core.orders import Heartbeat, Order, Progress, RunState, StationState
from softcal.core.quality.line_rules import RETESTS
from softcal.core.words.reason import plain
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

EVENTS = 10
"""Of one sequence."""

PATIENCE_S = 8.0
"""A card may lag behind the registry for so long: a poll of a second, and a busy machine."""

MOST_RETESTS = 99
"""The rules of a lot allow no more. With fewer the three units are used up, and what follows presses nothing."""

LATE_MS = 2500
"""A start that was not ordered within this time is ordered no more, and the screen says so."""

TICK_MS = 1
"""The browser's clock counts in whole milliseconds."""

SERIALS = ("EG-2411-001", "EG-2411-002", "EG-2411-003")
CODES = (*SERIALS, *SERIALS, "EG-2411-000", "not a serial!", "LOT:none", "BADGE:Kim", "GOLDEN:EG-2411-900", "CMD:START")
KEYS = ("F2", "F2", "F2", "F4", "F6", "F8")
KINDS = {
    "press": 4,
    "scan": 5,
    "key": 6,
    "twice": 4,
    "reload": 2,
    "tab": 1,
    "kill": 0.5,
    "silent": 0.5,
    "break": 0.7,
    "wait": 2,
}
START = "CMD:START"
COMMANDS = ("CMD:", "BADGE:")
"""Codes that change nothing about which unit was scanned last."""

WATCH = """
addEventListener("keydown", (event) => {
  if (event.repeat || !["F2", "Enter"].includes(event.key)) return
  const card = document.querySelector(".sc-card")
  window.pressed({
    at_ms: Date.now(), key: event.key, state: card?.dataset.state ?? "",
    serial: card?.querySelector(".sc-serial")?.textContent ?? "", taken_ms: document.softcalTaken ?? 0,
  })
}, true)
"""
"""Writes down each key that may be a start, with what stood on the card at that moment."""


@dataclass(frozen=True)
class Key:
    """One press of F2 or of Enter at a screen.

    Args:
        at_ms: when, since 1970.
        key: which.
        state, serial: of the card that was shown.
        taken_ms: the newest scan that the screen knew to be taken.
    """

    at_ms: float
    key: str
    state: str
    serial: str
    taken_ms: float

    def is_for(self, serial: str, scanned: str, scanned_ms: float) -> bool:
        """Whether it may press a unit: the card showed it, or it was scanned here and no answer to that was shown."""
        is_shown = self.state.startswith(("armed", "ask")) and self.serial == serial
        return is_shown or (scanned == serial and self.taken_ms < scanned_ms)


class Station(threading.Thread):
    """Plays the station: takes orders, ends runs with drawn verdicts, breaks and falls silent when it is told so."""

    def __init__(self, line: PlayedLine, seed: int) -> None:
        super().__init__(daemon=True)
        self._line, self._rng = line, np.random.default_rng(seed)
        self._process, self._state = 1, StationState.READY
        self.is_over, self.is_silent, self.breaks = threading.Event(), threading.Event(), threading.Event()

    def run(self) -> None:
        while not self.is_over.wait(0.2):
            try:
                self._step()
            except SoftcalError as error:
                print(f"played station: {error}", file=sys.stderr, flush=True)

    def come_back(self) -> None:
        """Come back as another process: what was running is cut off."""
        self._process += 1
        self._line.queue.interrupt(STATION, plain("the service was started again"))
        self.is_silent.clear()

    def _step(self) -> None:
        if self.is_silent.is_set():
            return
        process = f"rig:{self._process}"
        self._line.queue.beat(
            Heartbeat(STATION, self._state, datetime.now(UTC), (), process, gate=GOOD), after=timedelta(0)
        )
        order = self._line.queue.take(STATION)
        if order is None:
            if self.breaks.is_set():
                self.breaks.clear()
                self._state = StationState.STOPPED
            return
        if not order.kind.is_run:
            self._state = StationState.READY
            self._line.queue.report(Progress(order.order_id, RunState.DONE))
            return
        ends_s = time.monotonic() + float(self._rng.uniform(0.5, 2.0))
        while time.monotonic() < ends_s and not self.is_silent.is_set():
            other = self._line.queue.take(STATION)
            if other is not None or self.breaks.is_set():
                self.breaks.clear()
                self._state = StationState.STOPPED
                self._line.end(order, "", code="E-STOPPED", message=plain("stopped by hand"))
                if other is not None:
                    self._line.queue.report(Progress(other.order_id, RunState.DONE))
                return
            time.sleep(0.1)
        if not self.is_silent.is_set():
            word = str(self._rng.choice(["pass", "conditional", "fail", "retest"], p=[0.6, 0.1, 0.15, 0.15]))
            self._line.end(order, "" if order.kind == "golden" else word)


class Server:
    """The application as a process that can be killed; always at the same port."""

    def __init__(self, url: str) -> None:
        self._url, self.port = url, free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self.start()

    def start(self) -> None:
        """Start it and wait until it answers."""
        command = [sys.executable, "-m", "softcal.app.ui.server", "--server.address=127.0.0.1", "--logger.level=error"]
        environment = dict(os.environ) | {"SOFTCAL_REGISTRY": self._url}
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(
            [*command, f"--server.port={self.port}"], env=environment, stdout=quiet, stderr=quiet
        )
        while not is_healthy(f"{self.address}/_stcore/health"):
            time.sleep(0.2)

    def kill(self) -> None:
        """Kill it as a power cut would."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()


class Trial:
    """One sequence: what is done, what is seen, what is wrong."""

    def __init__(self, context: BrowserContext, server: Server, registry: Registry, station: Station, seed: int):
        self._server, self._registry, self._station = server, registry, station
        self._rng = np.random.default_rng(seed)
        self._context = context
        self._keys: list[Key] = []
        self._scans: list[tuple[float, str]] = []
        self._known = {order.order_id for order in self.runs()}
        self.page = self._opened(self._keys)
        self.done: list[str] = []
        self.wrong: list[str] = []

    def go(self) -> None:
        """Do every event of the sequence and check after each."""
        names, weights = list(KINDS), np.array(list(KINDS.values()))
        for _ in range(EVENTS):
            kind = str(self._rng.choice(names, p=weights / weights.sum()))
            getattr(self, f"_do_{kind}")()
            self._check_card(self.page)
            self._check_motion()
            if kind in ("reload", "kill"):
                self._scans.clear()  # Another screen, as far as the line can tell.
        self.page.wait_for_timeout(LATE_MS)
        self._check_motion()
        self.page.close()

    def _opened(self, keys: list[Key]) -> Page:
        page = self._context.new_page()
        page.set_default_timeout(60_000)
        page.expose_function("pressed", lambda found: keys.append(Key(**found)))
        page.add_init_script(WATCH)
        page.goto(f"{self._server.address}/line")
        page.locator(".sc-card").first.wait_for()
        page.wait_for_function(
            "(document.activeElement.shadowRoot?.activeElement ?? document.activeElement).tagName === 'INPUT'"
        )
        return page

    def _scan(self, code: str) -> None:
        self._scans.append((1e3 * time.time(), code))
        self.page.keyboard.type(code, delay=1)
        self.page.keyboard.press("Enter")

    def _do_press(self) -> None:
        """Do what a person does: scan, read, say yes where it is asked for, start."""
        serial = str(self._rng.choice(SERIALS))
        self.done.append(f"press {serial}")
        self._scan(serial)
        self._check_card(self.page)
        if self._card(self.page)[0].startswith("ask"):
            self.page.keyboard.press("F4")
            self._check_card(self.page)
        self.page.keyboard.press("F2")

    def _do_scan(self) -> None:
        code = str(self._rng.choice(CODES))
        self.done.append(code)
        self._scan(code)

    def _do_key(self) -> None:
        key = str(self._rng.choice(KEYS))
        self.done.append(key)
        self.page.keyboard.press(key)

    def _do_twice(self) -> None:
        first, second = (str(self._rng.choice(KEYS)) for _ in range(2))
        apart_ms = int(self._rng.integers(0, 501))
        self.done.append(f"{first}, {apart_ms} ms, {second}")
        self.page.keyboard.press(first)
        self.page.wait_for_timeout(apart_ms)
        self.page.keyboard.press(second)

    def _do_reload(self) -> None:
        self.done.append("reload")
        self.page.reload()
        self.page.locator(".sc-card").first.wait_for()

    def _do_tab(self) -> None:
        self.done.append("second tab")
        other = self._opened([])
        self._check_card(other)
        other.close()

    def _do_kill(self) -> None:
        self.done.append("kill server")
        self._server.kill()
        self.page.wait_for_timeout(int(self._rng.integers(0, 3000)))
        self._server.start()
        self.page.locator("#softcal-gone").wait_for(state="hidden", timeout=60_000)

    def _do_silent(self) -> None:
        self.done.append("station silent")
        self._station.is_silent.set()
        until_s = time.monotonic() + PATIENCE_S
        while read_line(self._registry, Screen(STATION)).is_answering and time.monotonic() < until_s:
            self.page.wait_for_timeout(100)
        self._check_card(self.page)
        self._station.come_back()

    def _do_break(self) -> None:
        self.done.append("station breaks")
        self._station.breaks.set()
        self.page.wait_for_timeout(500)

    def _do_wait(self) -> None:
        self.done.append("wait")
        self.page.wait_for_timeout(int(self._rng.integers(200, 2500)))

    def _expected(self) -> tuple[str, str]:
        view: LineView = line_view(read_line(self._registry, Screen(STATION)), "", partial(text, "en"))
        return view.state, view.serial

    def _card(self, page: Page) -> tuple[str, str]:
        try:
            seen = page.evaluate(
                "() => { const c = document.querySelector('.sc-card'); "
                "return [c?.dataset.state ?? '', c?.querySelector('.sc-serial')?.textContent ?? ''] }"
            )
        except PlaywrightError:
            return "", ""
        return seen[0], seen[1]

    def _check_card(self, page: Page) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            expected = self._expected()
            # Read on both sides of the look: what changes meanwhile is no error of the screen.
            if self._card(page) == expected == self._expected():
                return
            page.wait_for_timeout(150)
        self.wrong.append(f"card {self._card(page)}, registry {self._expected()}")

    def runs(self) -> list[Order]:
        """Return every run that was ever ordered."""
        queue = self._registry.order_queue
        return [order for order, _ in queue.runs(STATION, 10_000) if order.kind.is_run]

    def _check_motion(self) -> None:
        new = [order for order in self.runs() if order.order_id not in self._known]
        for order in sorted(new, key=lambda order: order.created or datetime.max.replace(tzinfo=UTC)):
            self._known.add(order.order_id)
            start = self._start_of(order)
            if start is None:
                starts = [(key, *self._scanned_at(key)) for key in self._keys if self._is_start(key)]
                self.wrong.append(f"{order.serial} pressed at {order.created}, asked by none of {starts[-3:]}")
            else:
                # Whatever was pressed before it is answered, too.
                del self._keys[: self._keys.index(start) + 1]

    def _start_of(self, order: Order) -> Key | None:
        """Return the start that asked for a run."""
        if order.created is None:
            return None
        ordered_ms = 1e3 * order.created.timestamp()
        for key in self._keys:
            is_in_time = -TICK_MS <= ordered_ms - key.at_ms <= LATE_MS
            if self._is_start(key) and is_in_time and key.is_for(order.serial, *self._scanned_at(key)):
                return key
        return None

    def _is_start(self, key: Key) -> bool:
        return key.key == "F2" or self._typed_at(key) == START

    def _typed_at(self, key: Key) -> str:
        return next((code for at_ms, code in reversed(self._scans) if at_ms <= key.at_ms + TICK_MS), "")

    def _scanned_at(self, key: Key) -> tuple[str, float]:
        """Return the unit that was scanned last at this screen before a key, and when (ms since 1970)."""
        units = ((at_ms, code) for at_ms, code in reversed(self._scans) if not code.startswith(COMMANDS))
        found = next(((code, at_ms) for at_ms, code in units if at_ms <= key.at_ms), ("", 0.0))
        return found[0].removeprefix("GOLDEN:"), found[1]


def runs_of(registry: Registry) -> int:
    """Return how many runs the station was ever ordered."""
    return sum(order.kind.is_run for order, _ in registry.order_queue.runs(STATION, 10_000))


def cleared(registry: Registry, station: Station) -> None:
    """Bring the line to rest between two sequences: nothing runs, nothing stands still, no unit waits."""
    station.is_silent.clear()
    station.breaks.clear()
    until_s = time.monotonic() + 30
    while time.monotonic() < until_s:
        facts = read_line(registry, Screen(STATION))
        if facts.active is None and not facts.is_stopped and facts.is_answering and not facts.serial:
            return
        for code in ("CMD:OK", "CMD:CANCEL"):
            try:
                take_scan(registry, Screen(STATION), code)
            except SoftcalError:
                time.sleep(0.2)
        time.sleep(0.3)


@contextmanager
def line_served(folder: Path, seed: int) -> Iterator[tuple[Server, Registry, Station]]:
    """Serve a line whose station is played."""
    url = f"sqlite:///{folder / 'line.db'}"
    os.environ["XDG_DATA_HOME"] = str(folder)
    with open_registry(url) as registry:
        line = PlayedLine(registry)
        rules = registry.line_rules(registry.lot(LOT))
        endless = replace(rules, retests=dict.fromkeys(RETESTS, MOST_RETESTS))
        registry.set_line_rules(LOT, endless, reason="a benchmark presses units again and again")
        line.beat()
        station = Station(line, seed)
        station.start()
        server = Server(url)
        try:
            yield server, registry, station
        finally:
            station.is_over.set()
            station.join()
            server.kill()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="seed of the first sequence")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--kept", type=Path, default=Path("line-sequences.jsonl"))
    parser.add_argument("--minutes", type=float, default=18.0, help="stop after so long; the same call goes on")
    options = parser.parse_args()
    known = [json.loads(line) for line in options.kept.read_text().splitlines()] if options.kept.is_file() else []
    seeds = [
        seed
        for seed in range(options.first, options.first + options.count)
        if seed not in {row["seed"] for row in known}
    ]
    until_s = time.monotonic() + 60 * options.minutes
    with (
        tempfile.TemporaryDirectory(prefix="softcal-line-", ignore_cleanup_errors=True) as place,
        chromium() as browser,
    ):
        # One browser for all, as a line has it: what a sequence leaves behind are its rows, which `cleared` looks at.
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        with line_served(Path(place), options.first) as (server, registry, station):
            for seed in seeds:
                if time.monotonic() > until_s:
                    break
                began_s = time.monotonic()
                cleared(registry, station)
                begun = runs_of(registry)
                trial = Trial(context, server, registry, station, seed)
                trial.go()
                took_s = round(time.monotonic() - began_s, 1)
                row = {
                    "seed": seed,
                    "s": took_s,
                    "events": trial.done,
                    "wrong": trial.wrong,
                    "runs": runs_of(registry) - begun,
                }
                known.append(row)
                with options.kept.open("a") as kept:
                    kept.write(json.dumps(row) + "\n")
                print(seed, trial.wrong or "good", file=sys.stderr, flush=True)
    _print(known)


def _print(rows: list[dict]) -> None:
    events = sum(len(row["events"]) for row in rows)
    wrong = [one for row in rows for one in row["wrong"]]
    kinds = Counter("card" if one.startswith("card") else "motion" for one in wrong)
    irregular = sum(
        e in ("reload", "kill server", "station silent", "second tab") for row in rows for e in row["events"]
    )
    print(f"{len(rows)} sequences, {events} events, {irregular} of them reloads, tabs, kills and silences:")
    runs = sum(row["runs"] for row in rows)
    print(f"{runs} runs ordered; {kinds['card']} wrong cards, {kinds['motion']} unasked motions")
    for row in rows:
        for one in row["wrong"]:
            print(f"  seed {row['seed']}: {one} after {' → '.join(row['events'])}")


if __name__ == "__main__":
    main()
