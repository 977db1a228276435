"""The operator's screen in a real browser on a simulated station: a lot of six, and all that may happen to it."""

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, expect
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from softcal.app.line.facts import LineFacts, Screen, read_line
from softcal.app.line.line import START_S, take_scan
from softcal.app.ui.stop_key import PATH as STOP_PATH
from softcal.core.orders import Order, OrderKind, RunState
from softcal.db.connection import open_registry

STATION, LOT = "line-1", "LOT-7"
SHORT = ("--speed", "4", "--unit-seconds", "12", "--source-seconds", "25", "--hidden", "12,6")
VERDICTS = ("pass", "conditional", "fail", "retest")


@dataclass
class Line:
    """A served station with a trained lot, and a screen that shows it."""

    registry: Any
    screen: Any
    station: Any

    def order(self, kind: OrderKind, serial: str = "", reason: str = "") -> str:
        order_id = f"{kind}-{time.monotonic_ns()}"
        self.registry.order_queue.place(Order(order_id, STATION, kind, serial, LOT, "engineer", reason))
        return order_id

    @property
    def facts(self) -> LineFacts:
        return read_line(self.registry, Screen(STATION))

    def until(self, is_so: Callable[[], bool], what: str) -> None:
        deadline_s = time.monotonic() + 120
        while not is_so():
            assert time.monotonic() < deadline_s, f"waited for {what}; {self.facts}"
            time.sleep(0.1)

    def clear(self) -> None:
        """Nothing runs, nothing stands still and no unit waits, whatever other tests left here."""
        self.until(lambda: self.facts.is_answering and self.facts.active is None, "a run to end")
        for code in ("CMD:OK", "CMD:OK", "CMD:CANCEL"):
            take_scan(self.registry, Screen(STATION), code)
        self.until(lambda: not self.facts.is_stopped and self.facts.may_press, "the station to be ready")

    def runs(self) -> int:
        """How many runs this station was ever ordered."""
        return sum(order.kind.is_run for order, _ in self.registry.order_queue.runs(STATION, 10_000))

    def press(self, serial: str) -> None:
        """Order a run of a unit and wait for its end."""
        order_id = self.order(OrderKind.UNIT, serial)
        self.until(lambda: not self.registry.order_queue.progress(order_id).state.is_active, f"the run of {serial}")

    def verdict(self, serial: str) -> str | None:
        return {unit.serial: unit.verdict for unit in self.registry.units(LOT)}.get(serial)


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory, serve: Callable, serve_station: Callable) -> Iterator[Line]:
    folder = tmp_path_factory.mktemp("line")
    url = f"sqlite:///{folder / 'line.db'}"
    with (
        serve_station(url, STATION, folder, *SHORT) as station,
        serve(url) as screen,
        open_registry(url) as registry,
    ):
        line = Line(registry, screen, station)
        source, deadline_s = line.order(OrderKind.SOURCE, "A0"), time.monotonic() + 120
        while (progress := registry.order_queue.progress(source)).state.is_active:
            assert time.monotonic() < deadline_s, progress
            time.sleep(0.2)
        assert progress.state is RunState.DONE, progress.text
        yield line


@pytest.fixture
def panel(line: Line, page: Page) -> Page:
    """The operator's screen, opened at its address, on a line that is free."""
    line.clear()
    return opened(page, line)


@pytest.fixture
def judged(line: Line) -> str:
    """A unit that has its verdict."""
    line.clear()
    # One that no other test presses: whatever ran before, it has this one result.
    if line.verdict("A9") is None:
        line.press("A9")
    return "A9"


def card(page: Page, *states: str) -> Locator:
    return page.locator(", ".join(f".sc-card[data-state={state}]" for state in states))


def scan_until(page: Page, text: str, *states: str, serial: str = "") -> None:
    """Scan as a person does: again when nothing came of it."""
    for _ in range(3):
        scan(page, text)
        try:
            shown(page, *states, serial=serial, timeout_ms=10_000)
            return
        except AssertionError:
            continue
    scan(page, text)
    shown(page, *states, serial=serial, timeout_ms=10_000)


def scan(page: Page, text: str, ending: str | None = "Enter") -> None:
    """Type as a scanner does: fast, and ended by a key or by nothing."""
    if ending is None:
        page.keyboard.insert_text(text)  # All at once: typed letters come slowly on a busy machine.
        return
    page.keyboard.type(text, delay=1)
    page.keyboard.press(ending)


def shown(page: Page, *states: str, serial: str = "", timeout_ms: float = 30_000) -> Locator:
    """Wait for the card in one of these states; where it never comes, say what stands there instead."""
    wanted = card(page, *states).filter(has_text=serial)
    try:
        wanted.wait_for(timeout=timeout_ms)
    except PlaywrightTimeout:
        stands = page.locator(".sc-card").first
        state, says = stands.get_attribute("data-state"), stands.inner_text()
        raise AssertionError(
            f"no {' or '.join(states)} of {serial or 'any unit'}; {state} stands there: {says}"
        ) from None
    return wanted


def press(page: Page, key: str, *states: str, serial: str = "") -> None:
    """Press a key as a person does: again when nothing came of it, since a busy machine's station may answer late."""
    for _ in range(5):
        page.keyboard.press(key)
        try:
            shown(page, *states, serial=serial, timeout_ms=5_000)
            return
        except AssertionError:
            continue
    page.keyboard.press(key)
    shown(page, *states, serial=serial, timeout_ms=5_000)


def verdict_of(page: Page, serial: str) -> str:
    return str(shown(page, *VERDICTS, serial=serial, timeout_ms=400_000).get_attribute("data-state"))


FOCUS = "(document.activeElement.shadowRoot?.activeElement ?? document.activeElement).tagName"


def focus(page: Page) -> str:
    return str(page.evaluate(FOCUS))


def opened(page: Page, line: Line) -> Page:
    """Open the screen; it listens from the moment it has the focus."""
    page.goto(line.screen.address)
    page.wait_for_function(f"{FOCUS} === 'INPUT'")
    return page


@pytest.mark.slow
def test_a_lot_of_six_from_scan_to_verdict_whatever_happens(line: Line, panel: Page) -> None:
    verdicts = {}

    # The first: lower case as scanned, started by its key.
    scan(panel, "a1")
    shown(panel, "armed", serial="A1")
    press(panel, "F2", "running", serial="A1")
    panel.get_by_role("progressbar").wait_for()
    panel.locator("[data-testid=stEChartsChart] canvas, canvas").first.wait_for()
    verdicts["A1"] = verdict_of(panel, "A1")

    # The second: a symbology prefix, ended by Tab, started by a code; the page is reloaded in mid-run.
    scan(panel, "]C0A2", "Tab")
    shown(panel, "armed", serial="A2")
    scan_until(panel, "cmd:start", "running", serial="A2")
    panel.reload()
    shown(panel, "running", serial="A2")
    verdicts["A2"] = verdict_of(panel, "A2")

    # The third: a scanner that sends no end; the screen's server is killed in mid-run and started again.
    scan(panel, "A3", ending=None)
    shown(panel, "armed", serial="A3")
    press(panel, "F2", "running", serial="A3")
    line.screen.kill()
    line.screen.start()
    verdicts["A3"] = verdict_of(panel, "A3")

    # The fourth: a device is unplugged in mid-run. The station stops; it is read, mended, and the unit pressed again.
    scan(panel, "A4")
    shown(panel, "armed", serial="A4")
    line.order(OrderKind.FAULT, reason="readout unplugged while pressing")
    press(panel, "F2", "running", "stopped", serial="A4")
    shown(panel, "stopped")
    expect(card(panel, "stopped")).to_contain_text("Check its cable")
    expect(panel.locator(".sc-chip").first).to_contain_text("STOPPED")
    scan(panel, "A5")
    panel.get_by_text("Press F4 or scan OK first").first.wait_for()
    press(panel, "F4", "hand")
    scan(panel, "A4")
    shown(panel, "armed", serial="A4")
    press(panel, "F2", "running", serial="A4")
    verdicts["A4"] = verdict_of(panel, "A4")

    # The fifth and sixth: by touch, and stopped by hand first.
    scan(panel, "A5")
    panel.get_by_role("button", name="Start").click()
    shown(panel, "running", serial="A5")
    scan(panel, "A6")
    panel.get_by_text("A6 was not taken").first.wait_for()
    verdicts["A5"] = verdict_of(panel, "A5")
    panel.get_by_text("A6 was scanned while A5 was pressed").first.wait_for()
    scan(panel, "A6")
    shown(panel, "armed", serial="A6")
    press(panel, "F2", "running", serial="A6")
    panel.locator("[data-testid=stEChartsChart] canvas").first.wait_for()  # It moves: now there is something to stop.
    press(panel, "F8", "stopped", serial="A6")
    scan_until(panel, "CMD:OK", "hand")
    scan(panel, "A6")
    shown(panel, "armed", serial="A6")
    press(panel, "F2", "running", serial="A6")
    verdicts["A6"] = verdict_of(panel, "A6")

    assert focus(panel) == "INPUT"
    assert {serial: line.verdict(serial) for serial in verdicts} == verdicts
    expect(panel.locator(".sc-cells")).to_contain_text("6")


def test_a_unit_scanned_twice_is_asked_for_and_the_old_result_stands_there(judged: str, panel: Page) -> None:
    scan(panel, judged)
    question = shown(panel, "ask")
    expect(question).to_contain_text("has a result already")
    panel.keyboard.press("F6")
    shown(panel, "hand")


def test_a_unit_that_waits_stands_there_after_a_reload_a_restart_and_at_another_screen(
    line: Line, judged: str, panel: Page, chromium: Browser
) -> None:
    scan(panel, "A7")
    shown(panel, "armed", serial="A7")
    panel.reload()
    shown(panel, "armed", serial="A7")
    line.screen.kill()
    line.screen.start()
    shown(panel, "armed", serial="A7")
    context = chromium.new_context()
    other = opened(context.new_page(), line)
    shown(other, "armed", serial="A7")
    scan(other, "A0")
    shown(other, "hand")
    shown(panel, "hand")
    panel.bring_to_front()
    panel.wait_for_function(f"{FOCUS} === 'INPUT'")  # It listens from here on.
    panel.keyboard.press("F2")
    panel.get_by_text("Scan the unit in your hand first").first.wait_for()
    assert line.facts.active is None
    context.close()


@pytest.mark.parametrize("apart_ms", [0, 50, 250, 500])
def test_no_number_of_presses_that_acknowledge_a_stop_moves_the_stage(line: Line, panel: Page, apart_ms: int) -> None:
    line.order(OrderKind.FAULT, reason="readout unplugged while pressing")
    line.press("A8")
    shown(panel, "stopped")
    before = line.runs()
    for key in ("F4",) * 6:
        panel.keyboard.press(key)
        panel.wait_for_timeout(apart_ms)  # What is tried is the time between two presses.
    shown(panel, "hand")
    panel.reload()
    shown(panel, "hand")
    panel.wait_for_function(f"{FOCUS} === 'INPUT'")  # It listens from here on.
    for key in ("F4", "F4", "F2", "F2"):
        panel.keyboard.press(key)
        panel.wait_for_timeout(apart_ms)
    panel.get_by_text("Scan the unit in your hand first").first.wait_for()
    assert line.runs() == before and line.facts.active is None


@pytest.mark.parametrize("way", ["key", "code"])
def test_a_server_that_stalls_for_longer_than_a_start_may_take_loses_no_acknowledgement(
    line: Line, panel: Page, way: str
) -> None:
    line.order(OrderKind.FAULT, reason="readout unplugged while pressing")
    line.press("A8")
    shown(panel, "stopped")
    with line.screen.stalled():
        panel.keyboard.press("F4") if way == "key" else scan(panel, "CMD:OK")
        panel.wait_for_timeout(1500 * START_S)
    shown(panel, "hand")


@pytest.mark.parametrize("code", ["F2", "CMD:START", "cmd:start", "]C0CMD:Start"])
def test_a_start_moves_nothing_after_a_stall_however_it_was_given(line: Line, panel: Page, code: str) -> None:
    scan(panel, "A7")
    shown(panel, "armed", serial="A7")
    before = line.runs()
    refused = panel.get_by_role("alert").filter(has_text="Not taken")
    with line.screen.stalled():
        panel.keyboard.press("F2") if code == "F2" else scan(panel, code)
        # The screen says so by itself, since nobody answers it.
        refused.wait_for()
    # The server, which hears of it only now, lets the unit go or still has it; the card may change its buttons.
    shown(panel, "armed", "hand")
    panel.wait_for_timeout(3000)  # Within it, whatever was on its way has come.
    expect(refused).to_be_visible()
    assert line.runs() == before and line.facts.active is None
    press(panel, "F6", "hand", "ready", *VERDICTS)


@pytest.mark.parametrize("code", ["F8", "CMD:STOP", "cmd:stop", "]C0CMD:Stop"])
def test_a_stop_takes_its_own_way_however_it_was_given(panel: Page, code: str) -> None:
    with panel.expect_request(lambda request: request.url.endswith(STOP_PATH), timeout=10_000):
        panel.keyboard.press("F8") if code == "F8" else scan(panel, code)
    panel.get_by_text("Nothing is running").first.wait_for()


@pytest.mark.parametrize("apart_ms", [0, 100, 400])
def test_a_key_pressed_again_and_again_presses_a_unit_once(line: Line, panel: Page, apart_ms: int) -> None:
    # A shape of its own each time: the lot would know one it has seen, and not ask.
    before, serial = line.runs(), {0: "B000", 100: "BB00", 400: "BBB0"}[apart_ms]
    scan(panel, serial)
    shown(panel, "ask_new", serial=serial)
    press(panel, "F4", "armed", serial=serial)
    for key in ("F2", "F2", "F4", "F2"):
        panel.keyboard.press(key)
        panel.wait_for_timeout(apart_ms)
    verdict_of(panel, serial)
    for key in ("F4", "F2", "F4", "F2"):
        panel.keyboard.press(key)
        panel.wait_for_timeout(apart_ms)
    panel.get_by_text("Scan the unit in your hand first").first.wait_for()
    assert line.runs() == before + 1


def test_a_server_that_is_gone_is_said_within_two_seconds_and_a_scan_is_refused_not_lost(
    line: Line, panel: Page
) -> None:
    shown(panel, "hand", "ready", *VERDICTS)
    line.screen.kill()
    gone = panel.locator("#softcal-gone")
    gone.filter(has_text="no connection to its server").wait_for(timeout=2_000)
    panel.keyboard.press("F2")
    scan(panel, "A8")
    panel.get_by_role("alert").filter(has_text="Not taken").filter(has_text="A8").wait_for()
    line.screen.start()
    expect(gone).to_be_hidden(timeout=60_000)
    assert line.facts.serial == "" and line.facts.active is None


def test_a_station_that_is_gone_is_said_within_two_seconds(line: Line, panel: Page) -> None:
    shown(panel, "hand", "ready", *VERDICTS)
    line.station.kill()
    try:
        shown(panel, "silent", timeout_ms=2_000)
    finally:
        line.station.start()
    shown(panel, "hand", "ready", *VERDICTS)


def test_what_a_screen_reader_says_is_what_stands_there(panel: Page) -> None:
    live = panel.get_by_role("status").and_(panel.locator("[aria-live=assertive]"))
    scan(panel, "A7")
    shown(panel, "armed", serial="A7")
    expect(live).to_have_text(re.compile(r"READY\. A7\. Put the unit into the fixture"))
    scan(panel, "A0")
    expect(live).to_contain_text("source unit")
    panel.keyboard.press("F6")


def test_everything_is_reached_by_keyboard_and_focus_is_seen(panel: Page) -> None:
    scan(panel, "A7")
    start = panel.get_by_role("button", name="Another unit")
    start.wait_for()
    assert focus(panel) == "INPUT"
    panel.keyboard.press("Shift+Tab")
    expect(start).to_be_focused()
    outline = start.evaluate("e => getComputedStyle(e).outlineStyle + getComputedStyle(e).boxShadow")
    assert outline != "nonenone"
    # A scan that comes while a button has the focus goes into the field all the same.
    scan(panel, "A8")
    shown(panel, "armed", serial="A8")
    panel.keyboard.press("F6")
    card(panel, "armed").wait_for(state="detached")


FIT = """() => {
  const wide = document.documentElement.scrollWidth > window.innerWidth + 1
  const cut = [...document.querySelectorAll(".sc-word, .sc-do, .sc-serial, .sc-card")].filter((e) => {
    const box = e.getBoundingClientRect()
    return box.right > window.innerWidth + 1 || box.left < -1 || e.scrollWidth > e.clientWidth + 1
  })
  const field = document.querySelector(".st-key-scan-field") ?? document.querySelector(".st-key-line-actions")
  return { wide, cut: cut.map((e) => e.className), bottom: field.getBoundingClientRect().bottom }
}"""


@pytest.mark.parametrize(("width", "height", "zoom"), [(1024, 768, 1.0), (1024, 768, 1.25), (1280, 800, 1.25)])
def test_a_small_panel_and_a_zoomed_one_show_it_all(
    line: Line, chromium: Browser, width: int, height: int, zoom: float
) -> None:
    size = {"width": int(width / zoom), "height": int(height / zoom)}
    context = chromium.new_context(viewport=size, device_scale_factor=zoom)
    page = context.new_page()
    opened(page, line)
    line.clear()
    scan(page, "A" + "7" * 60)
    shown(page, "ask_new")
    press(page, "F4", "armed")
    found = page.evaluate(FIT)
    assert (found["wide"], found["cut"]) == (False, [])
    assert found["bottom"] <= size["height"]
    page.keyboard.press("F6")
    context.close()


CONTRAST = """() => {
  const parse = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number)
  const light = ([r, g, b]) => {
    const [x, y, z] = [r, g, b].map((v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    return 0.2126 * x + 0.7152 * y + 0.0722 * z
  }
  const groundOf = (e) => {
    for (; e; e = e.parentElement) {
      const colour = parse(getComputedStyle(e).backgroundColor)
      if (colour.length === 3 || colour[3] > 0.99) return colour
    }
    return [255, 255, 255]
  }
  const weak = []
  for (const e of document.querySelectorAll("#root *")) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())
    if (!own || !e.checkVisibility() || e.closest("[aria-hidden=true], style, script, noscript")) continue
    const style = getComputedStyle(e)
    if (style.fontFamily.includes("Material")) continue
    const [a, b] = [light(parse(style.color)), light(groundOf(e))].sort((x, y) => y - x)
    const ratio = (a + 0.05) / (b + 0.05)
    const isLarge = parseFloat(style.fontSize) >= 24
    if (ratio < (isLarge ? 3 : 4.5)) weak.push(`${e.textContent.trim().slice(0, 40)}: ${ratio.toFixed(2)}`)
  }
  return weak
}"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_word_stands_out_from_its_ground(line: Line, judged: str, chromium: Browser, theme: Any) -> None:
    context = chromium.new_context(viewport={"width": 1280, "height": 800}, color_scheme=theme)
    page = context.new_page()
    opened(page, line)
    page.locator(".sc-chip").first.wait_for()
    scan(page, "LOT:nowhere")
    page.get_by_text("is not in the registry").first.wait_for()
    assert page.evaluate(CONTRAST) == []
    scan(page, judged)
    page.get_by_role("button", name="Yes, again").wait_for()
    assert page.evaluate(CONTRAST) == []
    page.keyboard.press("F6")
    context.close()
