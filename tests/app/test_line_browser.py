"""The operator's screen in a real browser on a simulated station: a lot of six, and all that may happen to it."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from softcal.app.line.line import START_S
from softcal.app.ui.stop_key import PATH as STOP_PATH
from softcal.core.orders import OrderKind
from tests.app.line_screen import VERDICTS, Line, card, focus, opened, press, scan, verdict_of, wait_for_card

pytestmark = pytest.mark.long


@pytest.fixture
def decided_unit(line: Line) -> str:
    """A unit that has its verdict."""
    line.clear()
    # One that no other test presses: whatever ran before, it has this one result.
    if line.verdict("A9") is None:
        line.press("A9")
    return "A9"


def test_a_lot_of_six_from_scan_to_verdict_whatever_happens(line: Line, panel: Page) -> None:
    verdicts = {}

    # The first: lower case as scanned, started by its key.
    scan(panel, "a1")
    wait_for_card(panel, "armed", serial="A1")
    press(panel, "F2", "running", serial="A1")
    panel.get_by_role("progressbar").wait_for()
    panel.locator("[data-testid=stEChartsChart] canvas, canvas").first.wait_for()
    verdicts["A1"] = verdict_of(panel, "A1")

    # The second: a symbology prefix, ended by Tab, started by a code; the page is reloaded in mid-run.
    scan(panel, "]C0A2", "Tab")
    wait_for_card(panel, "armed", serial="A2")
    scan(panel, "cmd:start")
    wait_for_card(panel, "running", serial="A2")
    panel.reload()
    wait_for_card(panel, "running", serial="A2")
    verdicts["A2"] = verdict_of(panel, "A2")

    # The third: a scanner that sends no end; the screen's server is killed in mid-run and started again.
    scan(panel, "A3", ending=None)
    wait_for_card(panel, "armed", serial="A3")
    press(panel, "F2", "running", serial="A3")
    line.screen.kill()
    line.screen.start()
    verdicts["A3"] = verdict_of(panel, "A3")

    # The fourth: a device is unplugged in mid-run. The station stops; it is read, mended, and the unit pressed again.
    scan(panel, "A4")
    wait_for_card(panel, "armed", serial="A4")
    line.order(OrderKind.FAULT, reason="readout unplugged while pressing")
    press(panel, "F2", "running", "stopped", serial="A4")
    wait_for_card(panel, "stopped")
    expect(card(panel, "stopped")).to_contain_text("Check its cable")
    expect(panel.locator(".sc-chip").first).to_contain_text("STOPPED")
    scan(panel, "A5")
    panel.get_by_text("Press F4 or scan OK first").first.wait_for()
    press(panel, "F4", "hand")
    scan(panel, "A4")
    wait_for_card(panel, "armed", serial="A4")
    press(panel, "F2", "running", serial="A4")
    verdicts["A4"] = verdict_of(panel, "A4")

    # The fifth and sixth: by touch, and stopped by hand first.
    scan(panel, "A5")
    panel.get_by_role("button", name="Start").click()
    wait_for_card(panel, "running", serial="A5")
    scan(panel, "A6")
    panel.get_by_text("A6 was not taken").first.wait_for()
    verdicts["A5"] = verdict_of(panel, "A5")
    panel.get_by_text("A6 was scanned while A5 was pressed").first.wait_for()
    scan(panel, "A6")
    wait_for_card(panel, "armed", serial="A6")
    press(panel, "F2", "running", serial="A6")
    panel.locator("[data-testid=stEChartsChart] canvas").first.wait_for()  # It moves: now there is something to stop.
    press(panel, "F8", "stopped", serial="A6")
    scan(panel, "CMD:OK")
    wait_for_card(panel, "hand")
    scan(panel, "A6")
    wait_for_card(panel, "armed", serial="A6")
    press(panel, "F2", "running", serial="A6")
    verdicts["A6"] = verdict_of(panel, "A6")

    assert focus(panel) == "INPUT"
    assert {serial: line.verdict(serial) for serial in verdicts} == verdicts
    expect(panel.locator(".sc-cells")).to_contain_text("6")


def test_a_unit_scanned_twice_is_asked_for_and_the_old_result_stands_there(decided_unit: str, panel: Page) -> None:
    scan(panel, decided_unit)
    question = wait_for_card(panel, "ask")
    expect(question).to_contain_text("has a result already")
    panel.keyboard.press("F6")
    wait_for_card(panel, "hand")


def test_a_unit_that_waits_stands_there_after_a_reload_a_restart_and_at_another_screen(
    line: Line, decided_unit: str, panel: Page, chromium: Browser
) -> None:
    scan(panel, "A7")
    wait_for_card(panel, "armed", serial="A7")
    panel.reload()
    wait_for_card(panel, "armed", serial="A7")
    line.screen.kill()
    line.screen.start()
    wait_for_card(panel, "armed", serial="A7")
    context = chromium.new_context()
    other = opened(context.new_page(), line.screen)
    wait_for_card(other, "armed", serial="A7")
    scan(other, "A0")
    wait_for_card(other, "hand")
    wait_for_card(panel, "hand")
    panel.bring_to_front()
    panel.locator("input:focus").wait_for(state="attached")  # It listens from here on.
    panel.keyboard.press("F2")
    panel.get_by_text("Scan the unit in your hand first").first.wait_for()
    assert line.status.active is None
    context.close()


@pytest.mark.parametrize("apart_ms", [0, 50, 250, 500])
def test_no_number_of_presses_that_acknowledge_a_stop_moves_the_stage(line: Line, panel: Page, apart_ms: int) -> None:
    line.order(OrderKind.FAULT, reason="readout unplugged while pressing")
    line.press("A8")
    wait_for_card(panel, "stopped")
    before = line.runs()
    for key in ("F4",) * 6:
        panel.keyboard.press(key)
        panel.wait_for_timeout(apart_ms)  # What is tried is the time between two presses.
    wait_for_card(panel, "hand")
    panel.reload()
    wait_for_card(panel, "hand")
    panel.locator("input:focus").wait_for(state="attached")  # It listens from here on.
    for key in ("F4", "F4", "F2", "F2"):
        panel.keyboard.press(key)
        panel.wait_for_timeout(apart_ms)
    panel.get_by_text("Scan the unit in your hand first").first.wait_for()
    assert line.runs() == before and line.status.active is None


@pytest.mark.parametrize("way", ["key", "code"])
def test_a_server_that_stalls_for_longer_than_a_start_may_take_loses_no_acknowledgement(
    line: Line, panel: Page, way: str
) -> None:
    line.order(OrderKind.FAULT, reason="readout unplugged while pressing")
    line.press("A8")
    wait_for_card(panel, "stopped")
    with line.screen.stalled():
        panel.keyboard.press("F4") if way == "key" else scan(panel, "CMD:OK")
        panel.wait_for_timeout(1500 * START_S)
    wait_for_card(panel, "hand")


@pytest.fixture(scope="module")
def strict(line: Line, serve: Callable) -> Iterator[Any]:
    """A second screen, whose starts are late after the seconds of the line."""
    with serve(line.url, is_patient=False) as screen:
        yield screen


@pytest.mark.parametrize("code", ["F2", "CMD:START", "cmd:start", "]C0CMD:Start"])
def test_a_start_moves_nothing_after_a_stall_however_it_was_given(
    line: Line, strict: Any, page: Page, code: str
) -> None:
    line.clear()
    panel = opened(page, strict)
    scan(panel, "A7")
    wait_for_card(panel, "armed", serial="A7")
    before = line.runs()
    refused = panel.get_by_role("alert").filter(has_text="Not taken")
    with strict.stalled():
        panel.keyboard.press("F2") if code == "F2" else scan(panel, code)
        # The screen says so by itself, since nobody answers it.
        refused.wait_for()
    # The server, which hears of it only now, lets the unit go or still has it; the card may change its buttons.
    wait_for_card(panel, "armed", "hand")
    panel.wait_for_timeout(3000)  # Within it, whatever was on its way has come.
    expect(refused).to_be_visible()
    assert line.runs() == before and line.status.active is None
    press(panel, "F6", "hand", "ready", *VERDICTS)


@pytest.mark.parametrize("code", ["F8", "CMD:STOP", "cmd:stop", "]C0CMD:Stop"])
def test_a_stop_takes_its_own_way_however_it_was_given(panel: Page, code: str) -> None:
    with panel.expect_request(lambda request: request.url.endswith(STOP_PATH)):
        panel.keyboard.press("F8") if code == "F8" else scan(panel, code)
    panel.get_by_text("Nothing is running").first.wait_for()


HELD_KEY_SCRIPT = """() => {
  window.keys = { unheard: 0, all: 0 }
  window.held = setInterval(() => {
    // A key that is held down is heard and does nothing.
    const key = new KeyboardEvent("keydown", { key: "F8", repeat: true, bubbles: true, cancelable: true })
    window.keys.all++
    if (document.body.dispatchEvent(key)) window.keys.unheard++
  }, 0)
}"""


def test_no_key_goes_unheard_while_the_screen_is_drawn_anew(line: Line, panel: Page) -> None:
    panel.evaluate(HELD_KEY_SCRIPT)
    for _ in range(3):
        scan(panel, "A7")
        wait_for_card(panel, "armed", serial="A7")
        panel.keyboard.press("F6")
        wait_for_card(panel, "hand", "ready", *VERDICTS)
    line.order(OrderKind.FAULT, reason="readout unplugged while pressing")
    line.press("A8")
    wait_for_card(panel, "stopped")
    press(panel, "F4", "hand")
    keys = panel.evaluate("() => { clearInterval(window.held); return window.keys }")
    assert keys["all"] > 500
    assert keys["unheard"] == 0


@pytest.mark.parametrize("apart_ms", [0, 100, 400])
def test_a_key_pressed_again_and_again_presses_a_unit_once(line: Line, panel: Page, apart_ms: int) -> None:
    # A shape of its own each time: the lot would know one it has seen, and not ask.
    before, serial = line.runs(), {0: "B000", 100: "BB00", 400: "BBB0"}[apart_ms]
    scan(panel, serial)
    wait_for_card(panel, "ask_new", serial=serial)
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


def test_a_server_that_is_gone_is_reported_and_a_scan_is_refused_not_lost(line: Line, panel: Page) -> None:
    wait_for_card(panel, "hand", "ready", *VERDICTS)
    line.screen.kill()
    offline_notice = panel.locator("#softcal-gone")
    offline_notice.filter(has_text="no connection to its server").wait_for()
    panel.keyboard.press("F2")
    scan(panel, "A8")
    panel.get_by_role("alert").filter(has_text="Not taken").filter(has_text="A8").wait_for()
    line.screen.start()
    offline_notice.wait_for(state="hidden")
    assert line.status.serial == "" and line.status.active is None


def test_a_station_that_is_gone_is_reported(line: Line, panel: Page) -> None:
    wait_for_card(panel, "hand", "ready", *VERDICTS)
    line.station.kill()
    try:
        wait_for_card(panel, "silent")
    finally:
        line.station.start()
    wait_for_card(panel, "hand", "ready", *VERDICTS)


def test_what_a_screen_reader_says_is_what_stands_there(panel: Page) -> None:
    live = panel.get_by_role("status").and_(panel.locator("[aria-live=assertive]"))
    scan(panel, "A7")
    wait_for_card(panel, "armed", serial="A7")
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
    wait_for_card(panel, "armed", serial="A8")
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
    opened(page, line.screen)
    line.clear()
    scan(page, "A" + "7" * 60)
    wait_for_card(page, "ask_new")
    press(page, "F4", "armed")
    fit = page.evaluate(FIT)
    assert (fit["wide"], fit["cut"]) == (False, [])
    assert fit["bottom"] <= size["height"]
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
def test_every_word_stands_out_from_its_background(
    line: Line, decided_unit: str, chromium: Browser, theme: Any
) -> None:
    context = chromium.new_context(viewport={"width": 1280, "height": 800}, color_scheme=theme)
    page = context.new_page()
    opened(page, line.screen)
    page.locator(".sc-chip").first.wait_for()
    scan(page, "LOT:nowhere")
    page.get_by_text("is not in the registry").first.wait_for()
    assert page.evaluate(CONTRAST) == []
    scan(page, decided_unit)
    page.get_by_role("button", name="Yes, again").wait_for()
    assert page.evaluate(CONTRAST) == []
    page.keyboard.press("F6")
    context.close()
