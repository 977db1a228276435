"""A browser that comes for the first time is answered in its own language and time."""

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import pytest
import streamlit as st

from softcal.app.texts.catalogue import LANGUAGES, format_instant, make_translator, text
from softcal.app.texts.reasons import render_reason
from softcal.core.messages.reason import reason
from softcal.core.orders import Heartbeat, StationState
from softcal.db.connection import open_registry

SEOUL = "Asia/Seoul"
INSTANT = datetime(2026, 1, 31, 16, 5, 9, tzinfo=UTC)


def read(text: str) -> datetime:
    """Return the instant that a person reads."""
    at, _, offset = text.replace("\\", "").partition(" UTC")
    return datetime.fromisoformat(at + (offset or "+00:00"))


@pytest.fixture
def browser(monkeypatch: pytest.MonkeyPatch):
    """`browser(locale=..., timezone=...)`: what the browser says of itself."""

    def set_context(**settings: str) -> None:
        for name, value in settings.items():
            monkeypatch.setattr(type(st.context), name, property(lambda _, value=value: value))

    return set_context


@pytest.mark.parametrize(
    ("locale", "spoken"), [("ko-KR", "ko"), ("ko", "ko"), ("en-GB", "en"), ("de-DE", "en"), ("", "en")]
)
def test_the_first_visit_is_in_the_language_of_the_browser(tmp_path, browser, show, locale, spoken) -> None:
    browser(locale=locale)
    screen = show(f"sqlite:///{tmp_path / 'new.db'}", "lots", role=None)
    assert screen.title[0].value == text(spoken, "page.lots")
    assert show(f"sqlite:///{tmp_path / 'new.db'}", "settings", role=None).selectbox(key="language").value == spoken


@pytest.mark.parametrize("chosen", LANGUAGES)
def test_what_a_person_chose_stays_whatever_the_browser_speaks(tmp_path, browser, show, chosen) -> None:
    browser(locale="ko-KR")
    url = f"sqlite:///{tmp_path / 'new.db'}"
    assert show(url, "lots", role=None, lang=chosen).title[0].value == text(chosen, "page.lots")
    screen = show(url, "settings", role=None)
    screen.selectbox(key="language").set_value("en").run()
    screen.selectbox(key="language").set_value(chosen).run()
    assert screen.run().title[0].value == text(chosen, "page.settings")


@pytest.mark.parametrize(("zone", "hours"), [(SEOUL, 9), ("America/St_Johns", -3.5), ("UTC", 0)])
def test_an_instant_says_its_zone_and_is_the_same_instant(zone, hours) -> None:
    text = format_instant(INSTANT.astimezone(ZoneInfo(zone)))
    assert read(text) == INSTANT and read(text).utcoffset() == timedelta(hours=hours)
    assert text in make_translator("en", ZoneInfo(zone))("wall.drawn", at=INSTANT)


@pytest.mark.parametrize(("timezone", "hours"), [(SEOUL, 9), ("Nowhere/Else", None), (None, None)])
def test_pages_show_times_in_the_zone_of_the_browser(calibrated, browser, show, timezone, hours) -> None:
    # A browser whose zone nobody knows is shown the zone of this machine.
    browser(timezone=timezone)
    with open_registry(calibrated) as registry:
        added_at = registry.networks.states("small")[0].network.added_at
    offset = timedelta(hours=hours) if hours else datetime.now().astimezone().utcoffset()
    (table,) = (table.value for table in show(calibrated, "lot", tab="networks", lot="small").table)
    times = [read(cell) for cell in table.astype(str).to_numpy().ravel() if " UTC" in cell]
    assert any(abs(at - added_at) < timedelta(seconds=2) and at.utcoffset() == offset for at in times)


def test_sentences_on_pages_show_times_in_the_zone_of_the_browser(calibrated, browser, show) -> None:
    browser(timezone=SEOUL)
    at = datetime.now(UTC) - timedelta(hours=1)
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, at, process="a:1"))
    screen = show(calibrated, "lot", lot="small")
    assert any(
        format_instant(at.astimezone(ZoneInfo(SEOUL))) in alert.value for alert in (*screen.warning, *screen.error)
    )


def test_a_reason_that_names_an_instant_is_rendered_in_the_zone_of_its_reader() -> None:
    why = reason("gate.golden", serial="G1", at=INSTANT.isoformat())
    assert format_instant(INSTANT.astimezone(ZoneInfo(SEOUL))) in render_reason(
        why, make_translator("ko", ZoneInfo(SEOUL))
    )
