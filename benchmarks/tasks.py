"""Jobs of operator, engineer and auditor, done in the browser from an empty registry: clicks and seconds.

python benchmarks/tasks.py [--only 1 2 3] [--pictures DIR]

No command is typed after the server was started: people, the demo, files, limits, a station, audits, release and
papers all come through the pages. A click is a press of mouse or key, a field that is filled, or a file that is
dropped. Seconds run from the first page of the job until what was wanted stands there; the machine's work (pressing,
training) is in them. Needs Chromium and Playwright.
"""

import io
import os
import re
import signal
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from common.command import parser_of
from common.desk_pictures import columns
from common.screens import chromium, served_by
from common.tables import print_table
from playwright.sync_api import Browser, Locator, Page
from playwright.sync_api import Error as PlaywrightError

from softcal.app.files.recording_file import write_columns
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.db.connection import open_registry

PEOPLE = {"Quinn": ("7350", "Quality"), "Erin": ("2580", "Engineer")}
UNITS, DEMO = 14, "demo"
LOT = f"{datetime.now().astimezone():%G-%V}"
"""The name that a new lot has where nobody gives one."""

TIMEOUT_MS = 420_000
YIELD = re.compile("First pass|Total yield")


@dataclass
class Hand:
    """One person at one browser; every press counts."""

    page: Page
    address: str
    clicks: int = 0

    def open(self, path: str) -> None:
        """Go to a page of the bar: one press."""
        self.clicks += 1
        self.page.goto(f"{self.address}/{path}")
        self.settled()

    def click(self, name: str, exact: bool = False) -> None:
        """Press what has this name."""
        self.clicks += 1
        button = self.page.get_by_role("button", name=name, exact=exact).first
        button.wait_for(timeout=TIMEOUT_MS)
        button.click()

    def fill(self, label: str, text: str, exact: bool = False) -> None:
        """Fill a field."""
        self.clicks += 1
        self.page.get_by_label(label, exact=exact).first.fill(text)
        self.page.keyboard.press("Tab")
        self.settled()

    def choose(self, label: str, option: str) -> None:
        """Choose one of a list: two presses."""
        self.clicks += 2
        self.page.get_by_role("combobox", name=label).first.click()
        self.page.get_by_role("option", name=option, exact=True).first.click()
        self.settled()

    def drop(self, files: list[Path]) -> None:
        """Drop files."""
        self.clicks += 1
        self.page.locator("input[type=file]").first.set_input_files([str(file) for file in files])

    def key(self, name: str) -> None:
        """Press a key."""
        self.clicks += 1
        self.page.keyboard.press(name)

    def scan(self, text: str) -> None:
        """Scan a code: one press."""
        self.clicks += 1
        self.page.keyboard.type(text, delay=1)
        self.page.keyboard.press("Enter")

    def take(self, name: str) -> bytes:
        """Take a file along and return it; an empty one is none."""
        with self.page.expect_download(timeout=TIMEOUT_MS) as download:
            self.click(name)
        content = download.value.path().read_bytes()
        if not content:
            raise PlaywrightError(f"{name}: the file is empty")
        return content

    def sees(self, text: str | re.Pattern[str]) -> Locator:
        """Wait until a text stands there."""
        element = self.page.get_by_text(text).first
        element.wait_for(timeout=TIMEOUT_MS)
        return element

    def card(self, *states: str) -> str:
        """Wait for a card of the line in one of these states; return which."""
        card = self.page.locator(", ".join(f".sc-card[data-state={state}]" for state in states)).first
        card.wait_for(timeout=TIMEOUT_MS)
        return str(card.get_attribute("data-state"))

    def settled(self) -> None:
        """Wait until the page is drawn: nobody types into what is being drawn anew."""
        self.page.wait_for_timeout(250)
        self.page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for(timeout=TIMEOUT_MS)


def first_account(hand: Hand) -> None:
    """Give the first account: at one's own machine everything is open until then."""
    hand.open("settings?tab=people")
    hand.fill("Name", "Quinn", exact=True)
    hand.fill("PIN (4 digits or more)", "7350")
    hand.fill("The same PIN again", "7350")
    hand.fill("Reason", "second person comes")
    hand.click("Save")
    hand.page.get_by_label("PIN", exact=True).wait_for(timeout=TIMEOUT_MS)


def add_engineer(hand: Hand) -> None:
    hand.open("settings?tab=people")
    hand.fill("Name", "Erin", exact=True)
    hand.choose("Role", "Engineer")
    hand.fill("PIN (4 digits or more)", "2580")
    hand.fill("The same PIN again", "2580")
    hand.fill("Reason", "new engineer of line 1")
    hand.click("Save")
    hand.sees("Erin was saved")


def try_demo(hand: Hand) -> None:
    hand.open("lots")
    hand.click("Try the demo")
    hand.page.wait_for_url("**/lot*", timeout=TIMEOUT_MS)
    hand.sees(YIELD)


def new_lot(hand: Hand, files: Path) -> None:
    hand.open("lots?tab=files")
    hand.drop(sorted(files.glob("units/*.csv")))
    hand.sees("What the columns are")
    hand.clicks += 1
    hand.sees("This limit is agreed").click()
    hand.settled()
    hand.click("Store the lot and calibrate")
    hand.page.wait_for_url("**/lot*", timeout=TIMEOUT_MS)
    hand.sees(YIELD)


def certificate(hand: Hand) -> None:
    """From the lot's page, where the job before ended: its release, the archive of all files, and take it."""
    hand.open(f"lot?lot={LOT}&tab=release")
    hand.click("Pack the lot into one archive")
    with zipfile.ZipFile(io.BytesIO(hand.take("Take the archive"))) as archive:
        if not any(name.endswith(".pdf") for name in archive.namelist()):
            raise PlaywrightError("the archive holds no certificate")


def set_limit(hand: Hand) -> None:
    hand.open(f"lot?lot={LOT}&tab=limits")
    hand.fill("New limit", "0.15")
    hand.fill("Reason", "drawing D 117 rev. B")
    hand.click("Set 0.15 N")
    hand.sees("drawing D 117 rev. B")


def audit(hand: Hand, files: Path) -> None:
    hand.open(f"lot?lot={LOT}&tab=audit")
    hand.click("Draw", exact=True)
    hand.sees("to be measured")
    hand.settled()
    serials = set(re.findall(r"\bU\d{3}\b", hand.page.locator("[data-testid=stMain]").inner_text()))
    hand.drop([file for file in sorted(files.glob("audit/*.csv")) if file.stem in serials])
    hand.click("Score")
    hand.sees("The recordings were scored")


def look_at_unit(hand: Hand) -> None:
    hand.open(f"lot?lot={LOT}")
    hand.clicks += 1
    hand.page.get_by_role("tab", name="Units").click()
    hand.page.get_by_test_id("stDataFrame").last.wait_for(timeout=TIMEOUT_MS)
    hand.clicks += 1
    hand.page.get_by_test_id("stDataFrame").last.click(position={"x": 18, "y": 55})
    hand.sees("Why this verdict")


def release(hand: Hand) -> None:
    hand.open(f"lot?lot={LOT}&tab=release")
    hand.take("Statement (PDF)")


def archive(hand: Hand) -> None:
    hand.open(f"lot?lot={LOT}&tab=release")
    hand.click("Pack the lot into one archive")
    hand.take("Take the archive")


def begin_station(hand: Hand) -> None:
    hand.open("station")
    hand.click("Start a simulated station")
    hand.sees(re.compile("State: "))


def press_units(hand: Hand) -> None:
    hand.open("line")
    hand.card("ready", "hand", "no_lot", "closed")
    hand.scan("BADGE:Kim")
    hand.scan(f"LOT:{DEMO}")
    hand.scan("A7")
    state = hand.card("armed", "ask_new")
    if state == "ask_new":
        hand.key("F4")
        hand.card("armed")
    hand.key("F2")
    hand.card("pass", "conditional", "fail", "retest")


def stop_and_read(hand: Hand) -> None:
    hand.open("line")
    hand.card("ready", "hand", "closed", "pass", "conditional", "fail", "retest")
    hand.scan("A8")
    if hand.card("armed", "ask_new") == "ask_new":
        hand.key("F4")
        hand.card("armed")
    hand.key("F2")
    hand.card("running")
    hand.key("F8")
    hand.card("stopped", "broken")
    hand.key("F4")
    hand.card("hand", "ready", "armed", "closed")


def look_at_wall(hand: Hand) -> None:
    hand.open(f"line?wall&lot={LOT}")
    hand.page.locator(".sw-tile b").first.wait_for(timeout=TIMEOUT_MS)


def who_changed_the_limit(hand: Hand) -> None:
    hand.open("settings?tab=audit_trail")
    hand.fill("Find words", "D 117")
    hand.sees(re.compile(r"found: [1-9]"))
    if b"drawing D 117 rev. B" not in hand.take("What was found as CSV"):
        raise PlaywrightError("the reason is not in the CSV")


def changes_and_report(hand: Hand) -> None:
    who_changed_the_limit(hand)
    report(hand)


def report(hand: Hand) -> None:
    hand.open(f"lot?lot={LOT}")
    hand.take("Report (PDF)")


def sign_in(hand: Hand, name: str) -> None:
    """Sign somebody in; no job of the table."""
    hand.page.goto(f"{hand.address}/settings")
    hand.page.get_by_label("Name").fill(name)
    hand.page.get_by_label("PIN", exact=True).fill(PEOPLE[name][0])
    hand.page.keyboard.press("Enter")
    hand.page.get_by_role("heading", name=name).wait_for(timeout=TIMEOUT_MS)
    while not any("session" in cookie["name"] for cookie in hand.page.context.cookies()):
        hand.page.wait_for_timeout(200)


def jobs(folder: Path) -> Iterator[tuple[str, str, str, Callable[[Hand], object]]]:
    """Give who, signed in as whom, what, and how."""
    alone = "engineer, alone on the machine"
    yield alone, "", "try the demo and land on its lot", try_demo
    yield alone, "", "own files dropped, calibrated", lambda hand: new_lot(hand, folder)
    yield alone, "", "the certificates of its units", certificate
    yield "auditor", "", "the first account: a second person comes", first_account
    yield "auditor", "Quinn", "give the engineer an account", add_engineer
    yield "engineer", "Erin", "set the limit, with the reason", set_limit
    yield "engineer", "Erin", "draw an audit, bring its recordings, see what they say", lambda hand: audit(hand, folder)
    yield "engineer", "Erin", "find the worst unit and why", look_at_unit
    yield "engineer", "Erin", "files of all units as one archive", archive
    yield "engineer", "Erin", "start a simulated station", begin_station
    yield "operator", "", "badge, lot, scan, press, verdict", press_units
    yield "operator", "", "stop a run, read it, go on", stop_and_read
    yield "operator", "", "the lot at one glance", look_at_wall
    yield "auditor", "Quinn", "what is released, with the statement", release
    yield (
        "auditor",
        "Quinn",
        "who changed the limit and why, as CSV; the lot's report",
        changes_and_report,
    )


def write_files(folder: Path) -> None:
    """Write what an engineer has: one table a unit, the source with its reference, and audits apart."""
    sim = simulate_lot(7, LotDesign(good=UNITS, unit_s=40, audit_s=60, has_stage=True))
    write_columns(folder / "units/S0.csv", columns(sim.source.unlabelled, sim.source.reference))
    for unit in sim.units:
        write_columns(folder / f"units/{unit.serial}.csv", columns(unit.recording))
        write_columns(folder / f"audit/{unit.serial}.csv", columns(unit.audit.unlabelled, unit.audit.reference))


@contextmanager
def server(root: Path) -> Iterator[tuple[str, Path]]:
    """Serve the application on an empty registry; give its address and its log."""
    log, url = root / "server.log", f"sqlite:///{root / 'registry.db'}"
    os.environ |= {"XDG_DATA_HOME": str(root), "SOFTCAL_REGISTRY": url}
    command = [sys.executable, "-u", "-m", "softcal.app.ui.server", "--server.address=127.0.0.1"]
    with log.open("w") as out, served_by(command, dict(os.environ), out) as (address, _):
        yield address, log


@contextmanager
def simulated_station_ended(root: Path) -> Iterator[None]:
    """End the station that a page started: it outlives the server, as it should."""
    try:
        yield
    finally:
        with open_registry(f"sqlite:///{root / 'registry.db'}") as registry:
            for heartbeat in registry.order_queue.stations():
                with suppress(ProcessLookupError):
                    os.kill(int(heartbeat.process.rpartition(":")[2]), signal.SIGTERM)


def do_task(browser: Browser, address: str, who: str, job: Callable[[Hand], object], picture: Path | None) -> tuple:
    """Do one job in a new browser; return clicks, seconds and what went wrong."""
    context = browser.new_context(viewport={"width": 1280, "height": 1000}, accept_downloads=True)
    hand = Hand(context.new_page(), address)
    hand.page.set_default_timeout(60_000)
    wrong, start_s = "", time.perf_counter()
    try:
        if who:
            sign_in(hand, who)
        start_s = time.perf_counter()
        job(hand)
    except PlaywrightError as error:
        wrong = str(error).splitlines()[0][:90]
    seconds = time.perf_counter() - start_s
    if picture is not None:
        hand.page.screenshot(path=picture)
    context.close()
    return hand.clicks, seconds, wrong or "done"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--only", type=int, nargs="*", help="jobs of these numbers; later ones may need earlier ones")
    parser.add_argument("--pictures", type=Path, help="folder for a picture of the end of each job")
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="softcal-tasks-", ignore_cleanup_errors=True) as folder:
        root = Path(folder)
        write_files(root / "files")
        with server(root) as (address, _), simulated_station_ended(root), chromium() as browser:
            rows = []
            for number, (role, who, what, job) in enumerate(jobs(root / "files"), 1):
                if options.only and number not in options.only:
                    continue
                picture = options.pictures and options.pictures / f"task-{number:02d}.png"
                clicks, seconds, end = do_task(browser, address, who, job, picture)
                rows.append((number, role, what, clicks, f"{seconds:.0f}", end))
                print(rows[-1], file=sys.stderr, flush=True)
            print_table(("", "who", "job", "clicks", "s", "end"), rows)


if __name__ == "__main__":
    main()
