"""The engineer's desk in a real browser: small and dark panels, one click to a unit, a training that can be stopped."""

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Browser, Page, expect

from softcal.app.texts.catalogue import LANGUAGES, text
from softcal.db.connection import open_registry

pytestmark = pytest.mark.long

CONTRAST = Path(__file__).with_name("contrast.js").read_text()
FADING_S = 10.0
"""So long what is drawn anew may be pale: it is shown again at full strength when the page is complete."""

TRANSLATE = partial(text, "en")
OFFICE_PAGES = {
    "lots": TRANSLATE("page.lots"),
    "lot?lot=small": TRANSLATE("lot.distribution"),
    "lot?lot=small&tab=units": TRANSLATE("lot.process"),
    "lot?lot=small&tab=audit": TRANSLATE("audit.units"),
    "lot?lot=small&tab=release": TRANSLATE("release.archive"),
    "lot?lot=small&tab=networks": TRANSLATE("networks.compare"),
    "lot?lot=small&tab=limits": TRANSLATE("limits.versions"),
    "lot?lot=small&tab=known_loads": TRANSLATE("known_loads.bring"),
    "unit?unit=A2": TRANSLATE("unit.why"),
    "unit?unit=A2&tab=recording": TRANSLATE("unit.map"),
    "unit?unit=A2&tab=compare": TRANSLATE("compare.interval"),
    "lots?tab=rig&lot=small": f"3 · {TRANSLATE('source.step.3')}",
    "gap": TRANSLATE("page.gap"),
    "station": TRANSLATE("station.setup"),
    "station?tab=cells": TRANSLATE("golden.title"),
    "settings?tab=laboratory": TRANSLATE("laboratory.title"),
}


@pytest.fixture(scope="module")
def office(
    small_calibrated: Path, tmp_path_factory: pytest.TempPathFactory, serve: Callable, add_everybody: Callable
) -> Iterator[tuple[str, str]]:
    """The address of the application and the URL of its registry."""
    folder = tmp_path_factory.mktemp("desk")
    file = folder / "desk.db"
    file.write_bytes(small_calibrated.read_bytes())
    url = f"sqlite:///{file}"
    add_everybody(url)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(folder))
        with serve(url) as screen:
            yield screen.address, url


@pytest.fixture
def panel(chromium: Browser) -> Iterator[Page]:
    """A panel of 1024 × 768 in the dark."""
    context = chromium.new_context(viewport={"width": 1024, "height": 768}, color_scheme="dark")
    tab = context.new_page()
    tab.set_default_timeout(120_000)
    yield tab
    context.close()


def _sign_in(page: Page, address: str, remembered: Callable) -> None:
    page.goto(f"{address}/sign_in")
    page.get_by_label(TRANSLATE("sign_in.name")).fill("Erin")
    page.get_by_label(TRANSLATE("sign_in.pin")).fill("2580")
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="Erin").wait_for()
    remembered(page, "session")


def test_every_page_fits_a_small_panel_and_shows_no_error(
    office: tuple[str, str], panel: Page, remembered: Callable
) -> None:
    address, _ = office
    _sign_in(panel, address, remembered)
    for path, heading in OFFICE_PAGES.items():
        panel.goto(f"{address}/{path}")
        panel.get_by_role("heading", name=heading, exact=True).wait_for()
        assert panel.get_by_test_id("stException").count() == 0, path
        _fits(panel)


CUT_OFF = """() => [...document.querySelectorAll('[data-testid=stMetric] *')]
    .filter(part => part.scrollWidth > part.clientWidth + 1 && part.clientWidth).map(part => part.innerText)"""
"""Words and numbers of a tile that it has no room for."""


def _fits(page: Page) -> None:
    assert page.evaluate(CUT_OFF) == [], page.url
    width, window_width = page.evaluate("() => [document.documentElement.scrollWidth, window.innerWidth]")
    assert width <= window_width, page.url
    assert page.get_by_test_id("stAlertContentError").count() == 0, page.url


def _weak(page: Page) -> list[str]:
    """Return the texts that stay too pale on their ground."""
    deadline_s = time.monotonic() + FADING_S
    while (weak_texts := page.evaluate(CONTRAST)) and time.monotonic() < deadline_s:
        page.wait_for_timeout(250)
    return list(weak_texts)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_text_stands_out_from_its_background(
    office: tuple[str, str], chromium: Browser, theme: Literal["light", "dark"], remembered: Callable
) -> None:
    address, _ = office
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, color_scheme=theme)
    page = context.new_page()
    page.set_default_timeout(120_000)
    _sign_in(page, address, remembered)
    paths = {"sign_in": "Erin", **OFFICE_PAGES}
    weak = {}
    for path, heading in paths.items():
        page.goto(f"{address}/{path}")
        page.get_by_role("heading", name=heading, exact=True).wait_for()
        weak[path] = _weak(page)
    page.goto(f"{address}/line")
    page.locator(".sc-word").wait_for()
    weak["line"] = _weak(page)
    context.close()
    assert {path: weak_texts for path, weak_texts in weak.items() if weak_texts} == {}


LONG = f"LOT-{'ABCDEFGHIJ' * 6}", f"SERIAL-{'0123456789' * 5}-XYZ-99"


@pytest.fixture(scope="module")
def long_names(office: tuple[str, str]) -> tuple[str, str, str]:
    """The address of the application, a lot and a unit of it, both with names of 64 characters."""
    address, url = office
    lot_id, serial = LONG
    with open_registry(url) as registry:
        lot, state = registry.lots.get("small"), registry.calibrations.get("A1").state
        registry.lots.add(replace(lot, id=lot_id))
        source = registry.recordings.get(registry.recordings.of_lot("small", kind="source")[-1].sha256)
        registry.recordings.add(lot_id, source, "source")
        registry.calibrations.add(lot_id, replace(state, fit=replace(state.fit, serial=serial)))
    return address, lot_id, serial


@pytest.mark.parametrize("size", [(1024, 768), (1024 * 4 // 5, 768 * 4 // 5)], ids=["panel", "125 %"])
def test_names_of_64_letters_are_read_in_full_on_a_small_panel(
    long_names: tuple[str, str, str], chromium: Browser, size: tuple[int, int]
) -> None:
    address, lot_id, serial = long_names
    context = chromium.new_context(viewport={"width": size[0], "height": size[1]})
    page = context.new_page()
    page.set_default_timeout(120_000)
    for path, name in ((f"lot?lot={lot_id}", lot_id), (f"unit?unit={serial}", serial)):
        page.goto(f"{address}/{path}")
        page.get_by_text(name, exact=True).first.wait_for()
        page.locator(".js-plotly-plot").first.wait_for()
        _fits(page)
    context.close()


def test_one_click_on_a_row_of_the_lot_opens_the_unit(office: tuple[str, str], page: Page) -> None:
    address, _ = office
    page.goto(f"{address}/lot?lot=small&tab=units")
    page.get_by_test_id("stDataFrame").last.wait_for()
    # The worst stands first: the unit that got no map.
    page.get_by_test_id("stDataFrame").last.click(position={"x": 18, "y": 55})
    page.get_by_role("heading", name="A4", exact=True).wait_for()
    page.get_by_text(TRANSLATE("empty.calibration")).wait_for()
    assert "unit=small%2FA4" in page.url


def test_a_row_of_the_lot_is_reached_and_opened_by_keyboard(office: tuple[str, str], page: Page) -> None:
    address, _ = office
    page.goto(f"{address}/lot?lot=small&tab=units")
    table = page.get_by_test_id("stDataFrame").last
    table.wait_for()
    table.get_by_test_id("data-grid-canvas").focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Shift+Space")
    page.get_by_role("heading", name=re.compile(r"^A\d$")).wait_for()
    assert "unit=small%2FA" in page.url


def test_a_training_goes_on_through_a_reload_and_can_be_stopped(
    office: tuple[str, str], page: Page, remembered: Callable
) -> None:
    address, url = office
    _sign_in(page, address, remembered)
    page.goto(f"{address}/networks?lot=small")
    page.get_by_label(TRANSLATE("networks.max_epochs")).fill("2000")
    page.get_by_label(TRANSLATE("networks.members")).fill("10")
    page.get_by_role("button", name=TRANSLATE("networks.train.do")).click()
    cancel = page.get_by_role("button", name=TRANSLATE("job.cancel"))
    cancel.wait_for()
    page.reload()
    page.get_by_test_id("stEChartsChart").first.wait_for()
    cancel.click()
    page.get_by_text(TRANSLATE("job.cancelled")).wait_for()
    with open_registry(url) as registry:
        assert [job.state for job in registry.job_board.jobs("train")] == ["cancelled"]
    expect(cancel).to_have_count(0)


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_field_for_files_speaks_the_language_of_its_page(
    office: tuple[str, str], panel: Page, remembered: Callable, english_in: Callable, language: str
) -> None:
    (address, _), prompt = office, text(language, "choose.files")
    _sign_in(panel, address, remembered)
    panel.goto(f"{address}/new_lot?lang={language}")
    zone = panel.get_by_test_id("stFileUploaderDropzone")
    expect(zone.get_by_role("button", name=prompt)).to_have_attribute("aria-label", prompt)
    # The icon is a letter font's ligature, and no word that is seen.
    zone.get_by_test_id("stIconMaterial").evaluate("(icon) => icon.remove()")
    html_text = zone.evaluate("(zone) => zone.innerText")
    css_text = zone.evaluate(
        "(zone) => [...zone.querySelectorAll('*')].map((e) => getComputedStyle(e, '::after').content).join(' ')"
    )
    assert prompt in css_text and "200" in css_text
    assert english_in(html_text) == [] and (language == "en" or english_in(css_text.replace("none", "")) == [])
