"""A line and its screen in a browser: what a person at it scans, presses and sees."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from playwright.sync_api import Locator, Page
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from softcal.app.line.line import take_scan
from softcal.app.line.status import LineStatus, Screen, read_line
from softcal.core.orders import Order, OrderKind
from tests.wait import wait_until

STATION, LOT = "line-1", "LOT-7"
SHORT = ("--speed", "4", "--unit-seconds", "12", "--source-seconds", "25", "--hidden", "12,6")
VERDICTS = ("pass", "conditional", "fail", "retest")


@dataclass
class Line:
    """A served station with a trained lot, and a screen that shows it."""

    registry: Any
    screen: Any
    station: Any
    url: str

    def order(self, kind: OrderKind, serial: str = "", reason: str = "") -> str:
        order_id = f"{kind}-{time.monotonic_ns()}"
        self.registry.order_queue.place(Order(order_id, STATION, kind, serial, LOT, "engineer", reason))
        return order_id

    @property
    def status(self) -> LineStatus:
        return read_line(self.registry, Screen(STATION))

    def until(self, is_so: Callable[[], bool], what: str) -> None:
        wait_until(is_so, lambda: f"{what}; {self.status}")

    def clear(self) -> None:
        """Nothing runs, nothing stands still and no unit waits, whatever other tests left here."""
        self.until(lambda: self.status.is_answering and self.status.active is None, "a run to end")
        for code in ("CMD:OK", "CMD:OK", "CMD:CANCEL"):
            take_scan(self.registry, Screen(STATION), code)
        self.until(lambda: not self.status.is_stopped and self.status.may_press, "the station to be ready")

    def runs(self) -> int:
        """How many runs this station was ever ordered."""
        return sum(order.kind.is_run for order, _ in self.registry.order_queue.runs(STATION, 10_000))

    def press(self, serial: str) -> None:
        """Order a run of a unit and wait for its end."""
        order_id = self.order(OrderKind.UNIT, serial)
        self.until(lambda: not self.registry.order_queue.progress(order_id).state.is_active, f"the run of {serial}")

    def verdict(self, serial: str) -> str | None:
        return {unit.serial: unit.verdict for unit in self.registry.lots.units(LOT)}.get(serial)


def card(page: Page, *states: str) -> Locator:
    return page.locator(", ".join(f".sc-card[data-state={state}]" for state in states))


def scan(page: Page, text: str, ending: str | None = "Enter") -> None:
    """Type as a scanner does: fast, and ended by a key or by nothing."""
    if ending is None:
        page.keyboard.insert_text(text)  # All at once: typed letters come slowly on a busy machine.
        return
    page.keyboard.type(text, delay=1)
    page.keyboard.press(ending)


def wait_for_card(page: Page, *states: str, serial: str = "") -> Locator:
    """Wait for the card in one of these states; where it never comes, say what stands there instead."""
    matching_card = card(page, *states).filter(has_text=serial)
    try:
        matching_card.wait_for()
    except PlaywrightTimeout:
        first_card = page.locator(".sc-card").first
        state, card_text = first_card.get_attribute("data-state"), first_card.inner_text()
        card_text += "".join(f"; note: {note}" for note in page.locator(".sc-note, [role=alert]").all_inner_texts())
        raise AssertionError(
            f"no {' or '.join(states)} of {serial or 'any unit'}; {state} stands there: {card_text}"
        ) from None
    return matching_card


def press(page: Page, key: str, *states: str, serial: str = "") -> None:
    """Press a key once and wait for what comes of it."""
    page.keyboard.press(key)
    wait_for_card(page, *states, serial=serial)


def verdict_of(page: Page, serial: str) -> str:
    return str(wait_for_card(page, *VERDICTS, serial=serial).get_attribute("data-state"))


FOCUS = "(document.activeElement.shadowRoot?.activeElement ?? document.activeElement).tagName"


def focus(page: Page) -> str:
    return str(page.evaluate(FOCUS))


def opened(page: Page, screen: Any) -> Page:
    """Open a screen; it listens from the moment it has the focus."""
    page.goto(screen.address)
    page.locator("input:focus").wait_for(state="attached")
    return page
