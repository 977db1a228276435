"""The operator's page drawn in process: buttons and keys order what they say, and a lost registry is no stack trace."""

from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.line.facts import Screen
from softcal.app.line.line import take_scan
from softcal.app.ui import registry_of_server
from softcal.core.errors import RegistryError
from softcal.core.orders import Heartbeat, OrderKind, StationState
from softcal.db.connection import open_registry


def _line_page() -> None:
    from softcal.app.ui.app_pages import line

    line.render()


@pytest.fixture
def station(calibrated):
    """The URL of a registry in which a station says that it is ready."""
    with open_registry(calibrated) as registry:
        # A minute ahead: a slow machine must not let it grow silent meanwhile.
        at = datetime.now(UTC) + timedelta(minutes=1)
        registry.order_queue.beat(Heartbeat("line-1", StationState.READY, at, (), "host:1"))
    return calibrated


def html_of(screen) -> str:
    return " ".join(element.proto.body for element in screen.get("html"))


def scanned(url: str, screen, *codes: str):
    """Scan at another screen of the line, and draw this one."""
    with open_registry(url) as registry:
        for code in codes:
            take_scan(registry, Screen(tab="scanner"), code)
    return screen.run()


def test_a_ready_line_asks_for_a_scan_and_shows_the_lot(station, open_page):
    shown = html_of(open_page(station, _line_page))
    assert 'data-state="ready"' in shown and "Scan the serial" in shown and "4" in shown


def test_the_start_button_orders_the_scanned_unit_for_the_operator(station, open_page):
    screen = scanned(station, open_page(station, _line_page), "BADGE:Kim", "A9")
    assert 'data-state="armed"' in html_of(screen)
    screen.button(key="line-START").click().run()
    with open_registry(station) as registry:
        order, _ = registry.order_queue.active("line-1")
    assert (order.kind, order.serial, order.lot_id, order.actor) == (OrderKind.UNIT, "A9", "small", "Kim (badge)")


def test_a_unit_with_a_result_is_asked_for(station, open_page):
    screen = scanned(station, open_page(station, _line_page), "A1")
    assert 'data-state="ask"' in html_of(screen)
    screen.button(key="line-OK").click().run()
    assert 'data-state="armed"' in html_of(screen)
    with open_registry(station) as registry:
        assert registry.order_queue.active("line-1") is None


def test_the_line_speaks_korean(station, open_page):
    assert "다음 제품의 일련번호를 스캔하십시오" in html_of(open_page(station, _line_page, lang="ko"))


def test_an_empty_registry_says_that_there_is_no_station(tmp_path, open_page):
    assert 'data-state="no_station"' in html_of(open_page(f"sqlite:///{tmp_path / 'new.db'}", _line_page))


def test_a_lost_registry_is_said_in_words(station, open_page, monkeypatch):
    screen = open_page(station, _line_page)

    def away(*arguments):
        raise RegistryError("the registry does not answer")

    monkeypatch.setattr(type(registry_of_server.registry()), "order_queue", property(away))
    screen.run()
    assert 'data-state="away"' in html_of(screen) and not screen.exception
