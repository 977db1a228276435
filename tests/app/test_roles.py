"""Who may open and change what, drawn in process: the first person, a wrong PIN, a change with its reason."""

from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.texts.catalogue import catalogue, text
from softcal.app.ui import account as identity
from softcal.app.ui import browser_memory
from softcal.app.ui.pages import PAGES, pages_for
from softcal.db.access.tries import MOST_FAILURES
from softcal.db.connection import open_registry
from softcal.db.entries import User


@pytest.fixture
def new_registry(tmp_path) -> str:
    return f"sqlite:///{tmp_path / 'new.db'}"


def test_every_page_has_a_title() -> None:
    assert all(f"page.{page.name}" in catalogue()["en"] for page in PAGES)


@pytest.mark.parametrize("role", ["operator", "engineer"])
def test_the_pages_of_quality_are_closed_to_others(role) -> None:
    assert not {"audit_trail", "people"} & {page.name for page in pages_for(User("x", role, True, 1))}


def test_who_may_no_longer_sign_in_may_open_what_everybody_may() -> None:
    assert {page.name for page in pages_for(User("x", "quality", False, 1))} == {"sign_in"}


def first_person(screen, code: str, pin: str = "7391", again: str = "7391"):
    for key, value in (("code", code), ("name", "Quinn"), ("pin", pin), ("again", again)):
        screen.text_input(key=f"first-{key}").set_value(value)
    return screen.button[0].click().run()


def people_of(url: str) -> list[tuple[str, str]]:
    with open_registry(url) as registry:
        return [(user.name, user.role) for user in registry.people.all()]


def test_the_first_person_becomes_quality_by_the_code_that_the_server_printed(new_registry, show, capfd) -> None:
    identity.first_code.clear()
    screen = show(new_registry, "sign_in", role=None)
    code = identity.first_code()
    assert capfd.readouterr().out.count(code) == 1
    first_person(screen, code.replace("-", " "))
    assert people_of(new_registry) == [("Quinn", "quality")]


def test_the_first_person_may_open_every_page_and_has_the_rights_of_the_role_after_the_second(
    new_registry, show, monkeypatch
) -> None:
    first_person(show(new_registry, "sign_in", role=None), identity.first_code())

    def opened() -> list[str]:
        with open_registry(new_registry) as registry:
            return [page.name for page in pages_for(registry.people.sign_in("Quinn", "7391"))]

    assert opened() == [page.name for page in PAGES]
    identity._sign_ins()["alone"] = identity.SignIn("Quinn", datetime.now(UTC) + timedelta(hours=1))

    def as_quinn(page: str):
        screen = show(new_registry, page, role=None)
        screen.session_state[browser_memory.STATE] = {identity.SESSION: "alone"}
        return screen.run()

    gone: list[str] = []
    monkeypatch.setattr("streamlit.switch_page", lambda page, **_: gone.append(page.url_path))
    as_quinn("sign_in").button(key="sign-in-go-on").click().run()
    assert gone == ["start"]
    assert {"start-files", "start-station"} <= {button.key for button in as_quinn("start").button}
    people = as_quinn("people")
    assert not people.info
    people.text_input(key="people-name--0").set_value("Erin")
    people.selectbox(key="people-role--0").set_value("engineer")
    for field in ("pin", "again"):
        people.text_input(key=f"people-{field}--0").set_value("2583")
    people.text_input(key="reason-text-people--0").set_value("second colleague")
    people.button[0].click().run()
    assert len(people.info) == 1
    assert "new_lot" not in opened() and "people" in opened()


def test_nobody_becomes_the_first_person_without_the_code(new_registry, show) -> None:
    identity._wrong_codes.clear()
    screen = show(new_registry, "sign_in", role=None)
    for _ in range(MOST_FAILURES):
        assert first_person(screen, "0000-000").error
    # Even the right code has to wait now.
    assert first_person(screen, identity.first_code()).error
    assert people_of(new_registry) == []
    identity._wrong_codes.clear()


@pytest.mark.parametrize(
    ("pin", "again"), [("7391", "7392"), ("0000", "0000"), ("1234", "1234"), ("8765", "8765"), ("1212", "1212")]
)
def test_a_pin_that_was_mistyped_or_is_soon_guessed_makes_nobody(new_registry, show, pin, again) -> None:
    screen = first_person(show(new_registry, "sign_in", role=None), identity.first_code(), pin, again)
    assert len(screen.error) == 1 and people_of(new_registry) == []


def test_a_wrong_pin_is_refused(calibrated, show, add_everybody) -> None:
    add_everybody(calibrated)
    screen = show(calibrated, "sign_in", role=None)
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
    screen = show(calibrated, "people", role="quality")
    _person(screen, "took over the lab")
    assert screen.success
    with open_registry(calibrated) as registry:
        row = registry.trail.rows()[-1]
    assert (row.actor, row.action, row.reason) == ("Quinn", "set_user", "took over the lab")


def test_a_change_without_a_reason_changes_nothing(calibrated, show) -> None:
    screen = show(calibrated, "people", role="quality")
    _person(screen, " ")
    assert screen.warning
    with open_registry(calibrated) as registry:
        assert {user.name: user.role for user in registry.people.all()}["Erin"] == "engineer"


def test_a_role_without_the_permission_gets_no_button(calibrated, show) -> None:
    screen = show(calibrated, "people", role="engineer")
    assert not screen.button


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
