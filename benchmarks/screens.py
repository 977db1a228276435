"""How long every page takes to its first useful paint with 10,000 units in the registry, beside an empty page.

python benchmarks/screens.py [--units 10000] [--rounds 5]

A Chromium opens each page; the clock runs from the address to what a person came for: the word of the state, the yield
of a lot, the verdict of a unit, a table. "New browser" has nothing in its cache, "known browser" has opened the page
before; "browser CPU" is the time its page thread computed for a new one. "Server CPU" is what the server computed
until it is at rest again: "cold" for the first look at a page since the server began, the others in "warm". The empty
page holds one word and is served by the same Streamlit: what it takes is the floor. Needs Chromium and Playwright.
"""

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from common.command import median_s, parser_of
from common.desk_pictures import NAME, PIN, QUALITY, QUALITY_PIN, sign_in
from common.screens import chromium, served, served_by
from common.tables import print_table
from playwright.sync_api import Browser, Page

from softcal.app.views.lot import lot_view
from softcal.core.lot import Lot
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.orders import Heartbeat, StationState
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit
from softcal.db.connection import open_registry
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter

CHUNK = 200
SETTLE_MS = 500
"""So long a new browser goes on reading scripts before it counts as one that knows the page."""

Site = tuple[str, int]
"""The address of a server and the id of its process."""

LOT, UNIT = "bench", "U004242"
HEADLINE = ".st-key-headline p"
FIRST_NUMBER = "[data-testid=stMetricValue] >> nth=1"
EMPTY = 'import streamlit as st\nst.html("<b class=sc-word>READY</b>")\n'
PAGES = (
    ("line", "line", ".sc-word", "the word of the state"),
    ("lots", "lots", "[data-testid=stTable]", "table of lots"),
    ("lot", f"lot?lot={LOT}", HEADLINE, "the next step"),
    ("lot, audit", f"lot?lot={LOT}&tab=audit", "[data-testid=stButton]", "how to draw units"),
    ("lot, release", f"lot?lot={LOT}&tab=release", FIRST_NUMBER, "units by verdict"),
    ("lot, compare", f"lot?lot={LOT}&tab=compare", "[data-testid=stTable]", "its numbers"),
    ("lot, units", f"lot?lot={LOT}&tab=units", ".js-plotly-plot >> nth=0", "control chart"),
    ("lot, units", f"lot?lot={LOT}&tab=units", "[data-testid=stDataFrame] >> nth=-1", "table of units"),
    ("unit", f"unit?unit={LOT}/{UNIT}", "span[role=status]", "verdict"),
    ("unit", f"unit?unit={LOT}/{UNIT}", ".js-plotly-plot >> nth=0", "why this verdict"),
    ("unit, history", f"unit?unit={LOT}/{UNIT}&tab=history", "[data-testid=stTable]", "its revisions"),
    ("source", f"lots?tab=rig&lot={LOT}", "text=Press the source unit >> nth=0", "what to press"),
    ("networks", f"lot?lot={LOT}&tab=networks", HEADLINE, "error of the network in use"),
    ("limits", f"lot?lot={LOT}&tab=limits", HEADLINE, "the limit"),
    ("gap", "gap", "[data-testid=stExpander]", "how to begin"),
    ("station", "station", "[data-testid=stButton]", "what it can be told"),
    ("profiles", "station?tab=profiles", FIRST_NUMBER, "its numbers"),
    ("load cells", "station?tab=cells", "[data-testid=stForm]", "the form"),
    ("sign in", "settings", "[data-testid=stButton]", "who is signed in"),
)
PAGES_OF_QUALITY = (
    ("people", "settings?tab=people", "[data-testid=stTable]", "table of people"),
    ("audit trail", "settings?tab=audit_trail", "[data-testid=stDataFrame]", "newest rows"),
)


def fill(registry: Registry, units: int) -> None:
    """Register a lot of units with results of every kind, each with the map and the recording of one simulated unit."""
    unit_state, rng = add_simulated_unit(registry), np.random.default_rng(0)
    for start in range(0, units, CHUNK):
        with registry.transaction():
            for number in range(start, min(start + CHUNK, units)):
                registry.calibrations.add(LOT, result(unit_state, number, float(abs(rng.normal(0.08, 0.012)))))
    registry.lots.set_limit(LOT, 0.12, reason="benchmark")
    registry.people.set(QUALITY, "quality", QUALITY_PIN, actor="installation")
    registry.people.set(NAME, "engineer", PIN, actor=QUALITY)


def result(unit_state: UnitState, number: int, error: float) -> UnitState:
    """Return the result of one unit, by its forecast alone."""
    forecast = ErrorForecast(error, error - 0.02, error + 0.02)
    fit = replace(unit_state.fit, id=f"{number:064x}", serial=f"U{number:06d}", forecast=forecast)
    return replace(unit_state, fit=fit, limit=Limit("N", 0.12))


def add_simulated_unit(registry: Registry) -> UnitState:
    """Register a lot with its source, a trained network and one recording; return the calibration of that recording."""
    sim = simulate_lot(1, LotDesign(good=1))
    trained = fit_network(sim.source, NetworkConfig(hidden=(24, 12), max_epochs=30))
    registry.lots.add(Lot(LOT, sim.source.serial, 50.0))
    source_sha256 = registry.recordings.add(LOT, sim.source, "source")
    registry.networks.add(LOT, trained.network, {}, {"source_recording_sha256": source_sha256}, "f" * 64)
    recording = sim.units[0].recording
    model = make_source_model(sim.source, trained.network, method=Method())
    registry.recordings.add(LOT, recording, "unit")
    return calibrate(UnitProblem(model, recording))


@contextmanager
def empty_page(folder: Path) -> Iterator[Site]:
    """Serve a page that holds one word."""
    page = folder / "empty.py"
    page.write_text(EMPTY)
    flags = ("--server.headless=true", "--server.fileWatcherType=none", "--browser.gatherUsageStats=false")
    with served_by([sys.executable, "-m", "streamlit", "run", str(page), *flags], dict(os.environ)) as site:
        yield site


def paint_s(page: Page, address: str, path: str, selector: str) -> float:
    """Return the seconds from the address to what a person came for."""
    start_s = time.perf_counter()
    page.goto(f"{address}/{path}", wait_until="commit")
    page.locator(selector).first.wait_for(timeout=120_000, state="attached")
    return time.perf_counter() - start_s


def cpu_s(process_id: int) -> float:
    """Return the CPU seconds of a process since it began."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rest(page: Page) -> None:
    """Wait until the server has drawn the page to its end."""
    page.wait_for_timeout(SETTLE_MS)
    page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for(timeout=120_000)
    page.wait_for_timeout(SETTLE_MS)
    page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for(timeout=120_000)


def row(browser: Browser, site: Site, entry: tuple[str, str, str, str], rounds: int, cookies: list) -> tuple:
    """Return one row of the table: medians for a new browser, its page thread, a known browser; the server's CPU."""
    name, path, selector, what = entry
    address, process_id = site
    new, cpu, warm_s, of_server = [], [], [], []
    for _ in range(rounds):
        began_s = cpu_s(process_id)
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        context.add_cookies(cookies)
        page = context.new_page()
        devtools = context.new_cdp_session(page)
        devtools.send("Performance.enable", {"timeDomain": "threadTicks"})
        new.append(paint_s(page, address, path, selector))
        metrics = devtools.send("Performance.getMetrics")["metrics"]
        cpu.append(next(m["value"] for m in metrics if m["name"] == "TaskDuration"))
        rest(page)
        of_server.append(cpu_s(process_id) - began_s)
        tab, began_s = context.new_page(), cpu_s(process_id)
        warm_s.append(paint_s(tab, address, path, selector))
        rest(tab)
        of_server.append(cpu_s(process_id) - began_s)
        context.close()
    medians = (statistics.median(times) for times in (new, cpu, warm_s))
    return name, what, *medians, of_server[0], statistics.median(of_server[1:])


def cookies_of(browser: Browser, address: str, name: str, pin: str) -> list:
    """Sign somebody in and return what the browser remembers of it."""
    context = browser.new_context()
    sign_in(context.new_page(), address, name, pin)
    cookies = context.cookies()
    context.close()
    return cookies


def queries(registry: Registry) -> Iterator[tuple[str, Callable[[], object]]]:
    """Give what the lot page asks of the registry."""
    yield "verdict counts", lambda: registry.pages.verdict_counts(LOT)
    yield "errors of all units", lambda: registry.pages.lot_errors(LOT)
    yield "one page, worst first", lambda: registry.pages.unit_page(LOT, UnitFilter(sort="severity"))
    yield "one page, by serial", lambda: registry.pages.unit_page(LOT, UnitFilter(text="0042"))
    yield "did anything change?", lambda: registry.pages.change_marker(LOT)
    yield "the whole view, once per change", lambda: lot_view(registry, LOT)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--units", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--server", action="store_true", help="print what the server computes alone")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
        url = f"sqlite:///{Path(folder) / 'registry.db'}"
        with open_registry(url) as registry:
            fill(registry, options.units)
            rows = ((name, 1e3 * median_s(query, options.rounds)) for name, query in queries(registry))
            print_table((f"query, {options.units} units, SQLite", "ms"), rows)
            registry.order_queue.write_heartbeat(
                Heartbeat("line-1", StationState.READY, datetime.now(UTC), process="rig:1")
            )
        print(flush=True)
        os.environ["XDG_DATA_HOME"] = folder
        with empty_page(Path(folder)) as empty, served(url) as site, chromium() as browser:
            header = ("page", "to", "new browser s", "browser CPU s", "known browser s", "server CPU s, cold", "warm")
            columns = (0, 1, 5, 6) if options.server else range(len(header))
            rows = (tuple(one[k] for k in columns) for one in table(browser, empty, site, options.rounds))
            print_table(tuple(header[k] for k in columns), rows)


def table(browser: Browser, empty: Site, site: Site, rounds: int) -> Iterator[tuple]:
    """Give one row per page, the empty page first and last: the machine may be busier at one end than at the other."""
    baseline = ("empty page", "", ".sc-word", "its word")
    yield row(browser, empty, baseline, rounds, [])
    for name, pin, pages in ((NAME, PIN, PAGES), (QUALITY, QUALITY_PIN, PAGES_OF_QUALITY)):
        cookies = cookies_of(browser, site[0], name, pin)
        for entry in pages:
            yield row(browser, site, entry, rounds, cookies)
    yield row(browser, empty, baseline, rounds, [])


if __name__ == "__main__":
    main()
