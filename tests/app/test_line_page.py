"""The operator's page drawn in process: buttons and keys order what they say, and a lost registry is no stack trace."""

from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.line.line import take_scan
from softcal.app.line.status import Screen
from softcal.app.texts.catalogue import LANGUAGES, text
from softcal.app.ui import server_cache
from softcal.core.errors import RegistryError
from softcal.core.orders import Heartbeat, OrderKind, StationState
from softcal.db.connection import open_registry


@pytest.fixture
def station(calibrated):
    """The URL of a registry in which a station says that it is ready."""
    with open_registry(calibrated) as registry:
        # As far ahead as clocks may be: a slow machine must not let it grow silent meanwhile.
        at = datetime.now(UTC) + timedelta(seconds=25)
        registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, at, (), "host:1"))
    return calibrated


def html_of(screen) -> str:
    return " ".join(element.proto.body for element in screen.get("html"))


def scanned(url: str, screen, *codes: str):
    """Scan at another screen of the line, and draw this one."""
    with open_registry(url) as registry:
        for code in codes:
            take_scan(registry, Screen(tab="scanner"), code)
    return screen.run()


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_ready_line_asks_for_a_scan(station, show, language):
    html = html_of(show(station, "line", role=None, lang=language))
    assert 'data-state="ready"' in html and text(language, "line.ready.do") in html


def test_the_start_button_orders_the_scanned_unit_for_the_operator(station, show):
    screen = scanned(station, show(station, "line", role=None), "BADGE:Kim", "A9")
    assert 'data-state="armed"' in html_of(screen)
    screen.button(key="line-START").click().run()
    with open_registry(station) as registry:
        order, _ = registry.order_queue.active("line-1")
    assert (order.kind, order.serial, order.lot_id, order.actor) == (OrderKind.UNIT, "A9", "small", "Kim (badge)")


@pytest.mark.parametrize(("role", "is_led"), [("engineer", True), (None, False)])
def test_a_line_without_a_station_leads_to_one_who_may_start_it(calibrated, show, role, is_led):
    screen = show(calibrated, "line", role=role)
    assert 'data-state="no_station"' in html_of(screen)
    assert ("line-to-station" in {button.key for button in screen.button}) is is_led


def test_the_line_asks_whoever_may_not_press_units_to_sign_in(calibrated, show):
    screen = show(calibrated, "line", role="quality")
    assert not screen.exception and screen.info and "data-state" not in html_of(screen)


def test_a_unit_with_a_result_is_asked_for(station, show):
    screen = scanned(station, show(station, "line", role=None), "A1")
    assert 'data-state="ask"' in html_of(screen)
    screen.button(key="line-OK").click().run()
    assert 'data-state="armed"' in html_of(screen)
    with open_registry(station) as registry:
        assert registry.order_queue.active("line-1") is None


def test_an_empty_registry_says_that_there_is_no_station(tmp_path, show):
    assert 'data-state="no_station"' in html_of(show(f"sqlite:///{tmp_path / 'new.db'}", "line", role=None))


def test_a_lost_registry_is_no_stack_trace(station, show, monkeypatch):
    screen = show(station, "line", role=None)

    def away(*arguments):
        raise RegistryError("the registry does not answer")

    monkeypatch.setattr(type(server_cache.registry()), "order_queue", property(away))
    screen.run()
    assert 'data-state="away"' in html_of(screen) and not screen.exception
