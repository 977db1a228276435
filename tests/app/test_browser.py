"""The application in a real browser: its pages, who may open them, and that nobody outside this machine is asked."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from softcal.app.texts.catalogue import text

pytestmark = pytest.mark.long

QUALITY_ONLY = "audit_trail"


@pytest.fixture(scope="module")
def desk(
    small_calibrated: Path, tmp_path_factory: pytest.TempPathFactory, serve: Callable, add_everybody: Callable
) -> Iterator[str]:
    """The address of the application on a registry with one calibrated lot and one person of each role."""
    file = tmp_path_factory.mktemp("desk") / "desk.db"
    file.write_bytes(small_calibrated.read_bytes())
    add_everybody(f"sqlite:///{file}")
    with serve(f"sqlite:///{file}") as screen:
        yield screen.address


def test_a_lot_and_a_unit_are_shown(desk: str, page: Page) -> None:
    page.goto(f"{desk}/lot")
    page.get_by_role("heading", name=text("en", "lot.look")).wait_for()
    page.goto(f"{desk}/unit?unit=A2")
    page.get_by_role("heading", name=text("en", "unit.why")).wait_for()
    page.get_by_role("tab", name=text("en", "unit.tab.history")).wait_for()


def test_a_page_a_role_may_not_open_is_neither_listed_nor_reached_by_its_address(desk: str, page: Page) -> None:
    page.goto(f"{desk}/{QUALITY_ONLY}")
    page.wait_for_url("**/lot*")
    expect(page.get_by_role("link", name=text("en", "page.audit_trail"))).to_have_count(0)


def test_a_sign_in_outlives_a_reload_and_ends_with_the_sign_out(desk: str, page: Page, sign_in: Callable) -> None:
    sign_in(desk, "quality")
    page.goto(f"{desk}/{QUALITY_ONLY}")
    page.get_by_role("link", name=text("en", "page.audit_trail")).wait_for()
    page.get_by_test_id("stDataFrame").wait_for()
    page.get_by_role("link", name="Quinn").click()
    page.get_by_role("button", name=text("en", "sign_in.leave")).click()
    page.get_by_role("heading", name=text("en", "page.sign_in")).wait_for()
    page.goto(f"{desk}/{QUALITY_ONLY}")
    page.wait_for_url("**/lot*")


def test_the_language_is_taken_from_the_address(desk: str, page: Page) -> None:
    page.goto(f"{desk}/lot?lang=ko")
    page.get_by_role("heading", name=text("ko", "lot.look")).wait_for()


def test_a_chosen_language_outlives_a_reload(desk: str, page: Page, remembered: Callable) -> None:
    page.goto(f"{desk}/sign_in")
    page.get_by_role("combobox").click()
    page.get_by_role("option", name="한국어").click()
    page.get_by_role("heading", name=text("ko", "page.sign_in")).wait_for()
    remembered(page, "lang")
    page.reload()
    page.get_by_role("heading", name=text("ko", "page.sign_in")).wait_for()


def test_a_pin_that_is_left_with_the_tab_key_reaches_the_registry(desk: str, page: Page, sign_in: Callable) -> None:
    sign_in(desk, "quality")
    page.goto(f"{desk}/people")
    page.get_by_label(text("en", "sign_in.name"), exact=True).fill("Nam")
    asked = {"sign_in.new_pin": "2580", "sign_in.pin_again": "2580", "column.reason": "works on the line"}
    for label, typed in asked.items():
        page.get_by_label(text("en", label)).fill(typed)
        page.keyboard.press("Tab")
    page.get_by_role("button", name=text("en", "people.save")).click()
    page.get_by_text(text("en", "people.saved", name="Nam")).wait_for()
