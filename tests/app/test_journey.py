"""One unit through the screens in a real browser: pressed by an operator, looked at and released by who may."""

from collections.abc import Callable

from playwright.sync_api import Page

from tests.app.line_screen import LOT, Line, press, scan, verdict_of, wait_for_card


def test_a_unit_is_scanned_pressed_decided_and_looked_at(
    line: Line, panel: Page, add_everybody: Callable[[str], None], sign_in: Callable[[str, str], None]
) -> None:
    scan(panel, "A1")
    wait_for_card(panel, "armed", serial="A1")
    press(panel, "F2", "running", serial="A1")
    verdict = verdict_of(panel, "A1")
    assert line.verdict("A1") == verdict

    add_everybody(line.url)
    sign_in(line.screen.address, "engineer")
    panel.goto(f"{line.screen.address}/lot?lot={LOT}")
    panel.get_by_role("heading", name="Predicted error of the units").wait_for()
    panel.goto(f"{line.screen.address}/unit?unit=A1")
    panel.get_by_role("heading", name="Why this verdict").wait_for()
    panel.get_by_role("tab", name="History").wait_for()
