"""What the operator's screen costs: first useful paint with a full registry, server time per live update and client.

python benchmarks/ui_cost.py [--units 10000] [--clients 1 2 4] [--seconds 15]

The station is played by its rows: a run that reports five times a second. The server's time is that of its process by
the kernel's account; an update is a change of the progress bar that a browser has drawn. Needs Chromium and Playwright.
"""

import argparse
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from playwright.sync_api import Browser, Page
from registry_common import print_markdown, record
from screens_common import LOT, PlayedLine, chromium, pressed_signal, served

from softcal.core.orders import Progress, RunState, StationState
from softcal.db.connection import open_registry

CHUNK = 200
ROUNDS = 5
REPORT_S = 0.2
RUN_S = 40.0
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
COUNT_UPDATES = """() => {
  window.softcalSeen = new Set()
  const look = () => {
    const bar = document.querySelector("[role=progressbar]")
    if (bar) window.softcalSeen.add(bar.getAttribute("aria-valuenow"))
  }
  new MutationObserver(look).observe(document.body, { subtree: true, childList: true, attributes: true })
}"""


def fill(line: PlayedLine, units: int) -> None:
    """Register units with results, so that counts and yields have something to count."""
    for start in range(0, units, CHUNK):
        with line.registry.transaction():
            for number in range(start, min(start + CHUNK, units)):
                result = record(f"U{number:06d}", number, line.network_id)
                line.registry.add_calibration(LOT, replace(result, verdict="fail" if number % 25 == 0 else "pass"))


def paint_s(browser: Browser, address: str) -> float:
    """Return the seconds from the address to the word of the state, in a fresh browser profile."""
    page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
    start_s = time.perf_counter()
    page.goto(f"{address}/line")
    page.locator(".sc-word").wait_for()
    seconds = time.perf_counter() - start_s
    page.context.close()
    return seconds


@contextmanager
def pressing(line: PlayedLine) -> Iterator[None]:
    """Play a run that goes on and on during the block."""
    order, signal, is_over = line.place("EG-2411-040"), pressed_signal(), threading.Event()
    line.beat(StationState.RUNNING)

    def report() -> None:
        began_s = time.monotonic()
        while not is_over.wait(REPORT_S):
            fraction = (time.monotonic() - began_s) / RUN_S % 1.0
            progress = Progress(order.order_id, RunState.RUNNING, "pressing", fraction, 11.0, signal=signal)
            line.queue.report(progress)

    reporter = threading.Thread(target=report, daemon=True)
    reporter.start()
    try:
        yield
    finally:
        is_over.set()
        reporter.join()
        line.end(order, "pass")


def cpu_s(process: int) -> float:
    """Return the CPU time of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def memory_MB(process: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def watched(browser: Browser, address: str) -> Page:
    """Open the screen of a run and count what it draws."""
    page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
    page.goto(f"{address}/line")
    page.locator("canvas").first.wait_for()
    page.evaluate(COUNT_UPDATES)
    return page


def live_row(browser: Browser, address: str, process: int, clients: int, seconds: float) -> tuple[object, ...]:
    """Let some clients watch a run, and return what that cost."""
    pages = [watched(browser, address) for _ in range(clients)]
    time.sleep(2.0)
    for page in pages:
        page.evaluate("window.softcalSeen.clear()")
    before_s, began_s = cpu_s(process), time.perf_counter()
    time.sleep(seconds)
    used_s, passed_s = cpu_s(process) - before_s, time.perf_counter() - began_s
    updates = [int(page.evaluate("window.softcalSeen.size")) for page in pages]
    for page in pages:
        page.context.close()
    per_update_ms = 1e3 * used_s / max(1, sum(updates))
    rate_Hz = statistics.mean(updates) / passed_s
    return clients, rate_Hz, per_update_ms, f"{used_s / passed_s:.0%}", round(memory_MB(process))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10_000)
    parser.add_argument("--clients", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--seconds", type=float, default=15.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder, chromium() as browser:
        url = f"sqlite:///{Path(folder) / 'registry.db'}"
        with open_registry(url) as registry:
            line = PlayedLine(registry)
            fill(line, options.units)
            with served(url) as (address, process), line.alive():
                first = paint_s(browser, address)
                again = statistics.median(paint_s(browser, address) for _ in range(ROUNDS))
                header = (f"operator's screen, {options.units} units", "first visit s", f"median of {ROUNDS} s")
                print_markdown(header, [("to the word of the state", first, again)])
                print(flush=True)
                with pressing(line):
                    rows = (live_row(browser, address, process, n, options.seconds) for n in options.clients)
                    print_markdown(
                        ("clients", "updates/s each", "server CPU ms per update", "of a core", "server MB"), rows
                    )


if __name__ == "__main__":
    main()
