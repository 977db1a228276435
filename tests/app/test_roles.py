"""Who may open and change what, drawn in process: the first person, a wrong PIN, a change with its reason."""

from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.texts.catalogue import text
from softcal.app.ui import account as identity
from softcal.app.ui import browser_memory
from softcal.app.ui.pages import PAGES
from softcal.core.orders import Heartbeat, StationState
from softcal.db.access.tries import MAX_FAILURES
from softcal.db.connection import open_registry
from softcal.db.entries import User


@pytest.fixture
def new_registry(tmp_path) -> str:
    return f"sqlite:///{tmp_path / 'new.db'}"


def opened_to(user: User) -> set[str]:
    return {tab.name for page in PAGES for tab in page.tabs if tab.is_open_to(user)}


@pytest.mark.parametrize("role", ["operator", "engineer"])
def test_the_pages_of_quality_are_closed_to_others(role) -> None:
    assert not {"audit_trail", "people"} & opened_to(User("x", role, True, 1))


def test_who_may_no_longer_sign_in_may_open_what_everybody_may() -> None:
    assert opened_to(User("x", "quality", False, 1)) == {"account"}


def first_person(screen, code: str, pin: str = "7391", again: str = "7391"):
    for key, value in (("code", code), ("name", "Quinn"), ("pin", pin), ("again", again)):
        screen.text_input(key=f"first-{key}").set_value(value)
    return screen.button[0].click().run()


def people_of(url: str) -> list[tuple[str, str]]:
    with open_registry(url) as registry:
        return [(user.name, user.role) for user in registry.people.all()]


def test_the_first_person_becomes_quality_by_the_code_that_the_server_printed(new_registry, show, capfd) -> None:
    identity.first_code.clear()
    screen = show(new_registry, "settings", tab="account", role=None)
    code = identity.first_code()
    assert capfd.readouterr().out.count(code) == 1
    first_person(screen, code.replace("-", " "))
    assert people_of(new_registry) == [("Quinn", "quality")]


def test_the_first_person_may_open_every_page_and_has_the_rights_of_the_role_after_the_second(
    new_registry, show
) -> None:
    first_person(show(new_registry, "settings", tab="account", role=None), identity.first_code())

    def opened() -> set[str]:
        with open_registry(new_registry) as registry:
            return opened_to(registry.people.sign_in("Quinn", "7391"))

    assert opened() == {tab.name for page in PAGES for tab in page.tabs}
    identity._sign_ins()["alone"] = identity.SignIn("Quinn", datetime.now(UTC) + timedelta(hours=1))

    def as_quinn(page: str, **query: str):
        screen = show(new_registry, page, role=None, **query)
        screen.session_state[browser_memory.STATE] = {identity.SESSION: "alone"}
        return screen.run()

    assert {"start-files", "start-station"} <= {button.key for button in as_quinn("lots").button}
    people = as_quinn("settings", tab="people")
    assert not people.info
    people.text_input(key="people-name--0").set_value("Erin")
    people.selectbox(key="people-role--0").set_value("engineer")
    for field in ("pin", "again"):
        people.text_input(key=f"people-{field}--0").set_value("2583")
    people.text_input(key="reason-text-people--0").set_value("second colleague")
    people.button[0].click().run()
    assert len(people.info) == 1
    assert "rig" not in opened() and "people" in opened()


def test_nobody_becomes_the_first_person_without_the_code(new_registry, show) -> None:
    identity._failed_codes.clear()
    screen = show(new_registry, "settings", tab="account", role=None)
    for _ in range(MAX_FAILURES):
        assert first_person(screen, "0000-000").error
    # Even the right code has to wait now.
    assert first_person(screen, identity.first_code()).error
    assert people_of(new_registry) == []
    identity._failed_codes.clear()


@pytest.mark.parametrize(
    ("pin", "again"), [("7391", "7392"), ("0000", "0000"), ("1234", "1234"), ("8765", "8765"), ("1212", "1212")]
)
def test_a_pin_that_was_mistyped_or_is_soon_guessed_makes_nobody(new_registry, show, pin, again) -> None:
    screen = first_person(show(new_registry, "settings", tab="account", role=None), identity.first_code(), pin, again)
    assert len(screen.error) == 1 and people_of(new_registry) == []


def test_a_wrong_pin_is_refused(calibrated, show, add_everybody) -> None:
    add_everybody(calibrated)
    screen = show(calibrated, "settings", tab="account", role=None)
    screen.text_input(key="sign-in-name").set_value("Quinn")
    screen.text_input(key="sign-in-pin").set_value("0000")
    screen.button[0].click().run()
    assert len(screen.error) == 1


def _person(screen, reason: str) -> None:
    for label, value in (("people.who", "Erin"), ("people.role", "quality")):
        next(field for field in screen.selectbox if field.label == text("en", label)).set_value(value).run()
    screen.text_input(key="reason-text-people-Erin-1").set_value(reason)
    screen.button[0].click().run()


def test_a_change_of_a_person_lands_in_the_audit_trail_with_its_reason(calibrated, show) -> None:
    screen = show(calibrated, "settings", tab="people", role="quality")
    _person(screen, "took over the lab")
    assert screen.success
    with open_registry(calibrated) as registry:
        row = registry.trail.rows()[-1]
    assert (row.actor, row.action, row.reason) == ("Quinn", "set_user", "took over the lab")


def test_a_change_without_a_reason_changes_nothing(calibrated, show) -> None:
    screen = show(calibrated, "settings", tab="people", role="quality")
    _person(screen, " ")
    assert screen.warning
    with open_registry(calibrated) as registry:
        assert {user.name: user.role for user in registry.people.all()}["Erin"] == "engineer"


def test_a_role_without_the_permission_gets_no_button(calibrated, show) -> None:
    screen = show(calibrated, "settings", tab="people", role="engineer")
    assert [button.label for button in screen.button] == [text("en", "sign_in.leave")]


@pytest.mark.parametrize(
    ("claims", "role"),
    [
        ({"roles": ["engineer"]}, "engineer"),
        ({"roles": ["/plant/line 3/Quality", "engineer"]}, "quality"),
        ({"roles": "operator"}, "operator"),
        ({"roles": ["bookkeeper"]}, None),
        ({}, None),
    ],
)
def test_a_company_account_has_the_highest_role_its_claims_name(claims, role) -> None:
    assert identity.role_of(claims, "roles") == role


@pytest.mark.parametrize(("hours", "holds"), [(0, True), (9.9, True), (10.1, False), (700, False)])
def test_a_company_account_is_signed_in_for_one_shift(hours: float, holds: bool) -> None:
    now = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)
    issued = now - timedelta(hours=hours)
    assert identity.is_of_this_shift({"iat": int(issued.timestamp())}, now) is holds


def test_an_account_that_does_not_say_when_it_signed_in_is_not_signed_in() -> None:
    assert not identity.is_of_this_shift({"sub": "4711"}, datetime(2026, 3, 2, tzinfo=UTC))


@pytest.fixture
def at_home(monkeypatch):
    """A server that answers this machine alone."""
    option = identity.st.get_option
    monkeypatch.setattr("streamlit.get_option", lambda name: "127.0.0.1" if name == "server.address" else option(name))
    monkeypatch.setattr("getpass.getuser", lambda: "kim")


def test_one_person_at_their_own_machine_needs_no_account(new_registry, show, at_home) -> None:
    screen = show(new_registry, "lots", role=None, tab="files")
    assert screen.get("file_uploader")
    screen = show(new_registry, "settings", role=None)
    assert {text("en", "tab.people"), text("en", "tab.audit_trail")} <= {tab.label for tab in screen.tabs}
    people = show(new_registry, "settings", role=None, tab="people")
    role = people.selectbox(key="people-role--0")
    assert len(role.options) == 1
    people.text_input(key="people-name--0").set_value("Kim")
    for field in ("pin", "again"):
        people.text_input(key=f"people-{field}--0").set_value("2583")
    people.text_input(key="reason-text-people--0").set_value("second person comes")
    next(button for button in people.button if button.label == text("en", "people.save")).click().run()
    assert people_of(new_registry) == [("Kim", "quality")]
    with open_registry(new_registry) as registry:
        assert registry.trail.rows()[-1].actor == "kim"
    # From now on it asks who is there.
    assert show(new_registry, "lots", role=None, tab="files").text_input(key="sign-in-pin")


@pytest.mark.parametrize("station", ["line-1", "simulated-1"])
def test_a_real_station_asks_for_an_account(new_registry, show, at_home, station) -> None:
    with open_registry(new_registry) as registry:
        registry.order_queue.write_heartbeat(Heartbeat(station, StationState.READY, datetime.now(UTC), process="a:1"))
    screen = show(new_registry, "lots", role=None, tab="files")
    assert bool(screen.get("file_uploader")) is (station == "simulated-1")


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.7", None])
def test_a_server_for_others_asks_for_an_account(new_registry, show, monkeypatch, address) -> None:
    monkeypatch.setattr("streamlit.get_option", lambda name: address if name == "server.address" else None)
    assert not show(new_registry, "lots", role=None, tab="files").get("file_uploader")


def test_a_proxy_asks_for_an_account(new_registry, show, at_home, monkeypatch) -> None:
    headers = property(lambda _: {"X-Forwarded-For": "10.0.0.9"})
    monkeypatch.setattr(type(identity.st.context), "headers", headers)
    assert not show(new_registry, "lots", role=None, tab="files").get("file_uploader")
