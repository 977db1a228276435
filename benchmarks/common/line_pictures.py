"""Pictures of the operator's screen: every state, light and dark. Run by screenshots.py.

The station is played by its rows, so that every state can be had; the signal is a simulated unit's.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path

from common.screens import (
    GOOD,
    LOT,
    STATION,
    THEMES,
    PlayedLine,
    Theme,
    gate_condition,
    pressed_signal,
    save_picture,
    served,
    statement,
)
from playwright.sync_api import Browser, Page, ViewportSize

from softcal.core.messages.reason import reason
from softcal.core.orders import Progress, RunState, StationState
from softcal.db.connection import open_registry

SIZE = ViewportSize(width=1280, height=800)
UNPLUGGED = reason("rig.silent.between", device="sensor readout (/dev/ttyACM1)", seconds=2.0)
CLIPPED = (
    reason("saturated", level=reason("part.level", level=1.62, unit="V"), share=0.081),
    statement(0.31, 0.22, 0.41, "above"),
)
NOISY = (reason("dead.noise", spread=0.004, unit="V", cure=reason("part.check_cable")),)
NEAR = (statement(0.118, 0.084, 0.16, "within_close"),)
LAST = ("pass", "pass", "conditional", "pass", "pass", "fail", "pass", "pass", "pass", "pass", "pass", "pass")


def serial(number: int) -> str:
    return f"{LOT}-{number:03d}"


def press_some(line: PlayedLine) -> None:
    for number, verdict in enumerate(LAST):
        line.press(serial(number + 1), verdict)


def run(line: PlayedLine) -> None:
    order = line.place_order(serial(40))
    line.write_heartbeat(StationState.RUNNING)
    line.queue.report(Progress(order.order_id, RunState.RUNNING, "pressing", 0.72, 11.0, signal=pressed_signal()))


def end_run(line: PlayedLine) -> None:
    order, _ = line.queue.active(STATION) or (line.place_order(serial(40)), None)
    line.end(order, "pass")
    line.write_heartbeat()


def stop(line: PlayedLine) -> None:
    line.press(serial(45), "", (), "E-SILENT", UNPLUGGED)
    line.write_heartbeat(StationState.STOPPED, why=UNPLUGGED)


def close(line: PlayedLine) -> None:
    line.write_heartbeat(StationState.CLOSED, gate=(*GOOD[:-1], gate_condition("golden", "no_golden", is_good=False)))


STATES: dict[str, tuple[str, Callable[[PlayedLine], None], str]] = {
    "ready": ("ready", lambda line: line.write_heartbeat(), ""),
    "scanned": ("armed", press_some, serial(40)),
    "running": ("running", run, ""),
    "pass": ("pass", end_run, ""),
    "check": ("conditional", lambda line: line.press(serial(42), "conditional", NEAR), ""),
    "fail": ("fail", lambda line: line.press(serial(43), "fail", CLIPPED), ""),
    "press-again": ("ask", lambda line: line.write_heartbeat(), serial(43)),
    "again": ("retest", lambda line: line.press(serial(44), "retest", NOISY), ""),
    "stopped": ("stopped", stop, ""),
    "not-ready": ("closed", close, serial(46)),
}
"""Name of the picture → state of the screen, what the station does before, and what is scanned."""


def opened(browser: Browser, address: str, theme: Theme) -> Page:
    """Open the screen in one theme, with an operator's badge."""
    page = browser.new_context(viewport=SIZE, color_scheme=theme).new_page()
    page.goto(address)
    page.locator("input:focus").wait_for(state="attached")
    scan(page, "BADGE:Kim Ji-woo")
    page.locator(".sc-cells").get_by_text("Kim Ji-woo").wait_for()
    return page


def scan(page: Page, text: str) -> None:
    page.keyboard.type(text, delay=1)
    page.keyboard.press("Enter")


def take(page: Page, state: str, scanned: str, path: Path) -> None:
    """Bring one screen into a state and take its picture."""
    if state not in ("ready", "running"):
        # Before the first run the greeting of the badge stays; in a run a key would be refused in words.
        scan(page, "CMD:CANCEL")
        page.locator(".sc-note").wait_for(state="detached")
    if scanned:
        scan(page, scanned)
    page.locator(f".sc-card[data-state={state}]").wait_for()
    if state == "running":
        page.locator("canvas").first.wait_for()
    page.locator("[data-test-script-state=notRunning]").wait_for(state="attached")
    page.wait_for_timeout(1000)
    save_picture(page, path)


def take_all(browser: Browser, out: Path, language: str) -> None:
    """Take the picture of every state in both themes."""
    with tempfile.TemporaryDirectory(prefix="softcal-shots-") as folder:
        url = f"sqlite:///{Path(folder) / 'registry.db'}"
        with open_registry(url) as registry, served(url) as (address, _):
            line = PlayedLine(registry)
            with line.alive():
                pages = {theme: opened(browser, f"{address}/?lang={language}", theme) for theme in THEMES}
                for name, (state, play, scanned) in STATES.items():
                    play(line)
                    for theme, page in pages.items():
                        take(page, state, scanned, out / f"line-{name}-{theme}.png")
