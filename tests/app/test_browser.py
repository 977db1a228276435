"""The application in a real browser: its pages, who may open them, and that nobody outside this machine is asked."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from softcal.app.texts.catalogue import text

pytestmark = pytest.mark.long

QUALITY_ONLY = "audit_trail"


@pytest.fixture(scope="module")
def office(
    small_calibrated: Path, tmp_path_factory: pytest.TempPathFactory, serve: Callable, add_everybody: Callable
) -> Iterator[str]:
    """The address of the application on a registry with one calibrated lot and one person of each role."""
    file = tmp_path_factory.mktemp("desk") / "desk.db"
    file.write_bytes(small_calibrated.read_bytes())
    add_everybody(f"sqlite:///{file}")
    with serve(f"sqlite:///{file}") as screen:
        yield screen.address


def test_a_lot_and_a_unit_are_shown(office: str, page: Page) -> None:
    page.goto(f"{office}/lot")
    page.get_by_role("heading", name=text("en", "lot.distribution")).wait_for()
    page.goto(f"{office}/unit?unit=A2")
    page.get_by_role("heading", name=text("en", "unit.why")).wait_for()
    page.get_by_role("tab", name=text("en", "tab.history")).click()
    page.wait_for_url("**tab=history*")


def test_an_address_that_was_leads_on_and_asks_for_the_role_it_needs(office: str, page: Page) -> None:
    page.goto(f"{office}/{QUALITY_ONLY}")
    page.wait_for_url("**/settings?tab=audit_trail")
    page.get_by_label(text("en", "sign_in.pin"), exact=True).fill("7777")
    page.get_by_label(text("en", "sign_in.name"), exact=True).fill("Quinn")
    page.keyboard.press("Enter")
    page.get_by_test_id("stDataFrame").wait_for()
    page.goto(f"{office}/wall?lot=small")
    page.locator(".sw-tile").first.wait_for()


def test_the_bar_fits_a_narrow_window_and_its_search_opens_a_unit(office: str, page: Page) -> None:
    page.set_viewport_size({"width": 820, "height": 900})
    page.goto(f"{office}/lots")
    for name in ("line", "lots", "gap", "station", "settings"):
        expect(page.get_by_role("link", name=text("en", f"page.{name}"), exact=True)).to_be_in_viewport()
    person = page.get_by_role("button", name=text("en", "sign_in"))
    expect(person).to_be_in_viewport()
    field = page.get_by_label(text("en", "bar.search.what"))
    field.fill("A2")
    field.press("Enter")
    page.wait_for_url("**/unit?unit=small%2FA2")
    page.get_by_role("heading", name="A2").wait_for()


def test_a_serial_in_a_table_opens_in_a_new_tab(office: str, page: Page) -> None:
    page.goto(f"{office}/lots")
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="small", exact=True).click()
    opened.value.wait_for_url("**/lot?lot=small")


def test_a_sign_in_outlives_a_reload_and_ends_with_the_sign_out(office: str, page: Page, sign_in: Callable) -> None:
    sign_in(office, "quality")
    page.goto(f"{office}/{QUALITY_ONLY}")
    page.get_by_test_id("stDataFrame").wait_for()
    page.get_by_role("button", name="Quinn").click()
    page.get_by_role("button", name=text("en", "sign_in.leave")).click()
    page.get_by_role("heading", name=text("en", "sign_in")).wait_for()
    page.goto(f"{office}/{QUALITY_ONLY}")
    page.get_by_label(text("en", "sign_in.pin"), exact=True).wait_for()


def test_the_language_is_taken_from_the_address(office: str, page: Page) -> None:
    page.goto(f"{office}/lot?lang=ko")
    page.get_by_role("heading", name=text("ko", "lot.distribution")).wait_for()


def test_a_chosen_language_outlives_a_reload(office: str, page: Page, remembered: Callable) -> None:
    page.goto(f"{office}/sign_in")
    page.get_by_role("combobox").first.click()
    page.get_by_role("option", name="한국어").click()
    page.get_by_role("heading", name=text("ko", "sign_in")).wait_for()
    remembered(page, "lang")
    page.reload()
    page.get_by_role("heading", name=text("ko", "sign_in")).wait_for()


def test_a_pin_that_is_left_with_the_tab_key_reaches_the_registry(office: str, page: Page, sign_in: Callable) -> None:
    sign_in(office, "quality")
    page.goto(f"{office}/people")
    page.get_by_label(text("en", "sign_in.name"), exact=True).fill("Nam")
    fields = {"sign_in.new_pin": "2580", "sign_in.pin_again": "2580", "column.reason": "works on the line"}
    for label, typed in fields.items():
        page.get_by_label(text("en", label)).fill(typed)
        page.keyboard.press("Tab")
    page.get_by_role("button", name=text("en", "people.save")).click()
    page.get_by_text(text("en", "people.saved", name="Nam")).wait_for()
