"""Who may open and change what, drawn in process: the first person, a wrong PIN, a change with its reason."""

from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.texts.catalogue import catalogue
from softcal.app.ui import account as identity
from softcal.app.ui.pages import PAGES, pages_for
from softcal.app.ui.pins import FREE_FAILURES, Pauses
from softcal.core.errors import InputError
from softcal.db.connection import open_registry
from softcal.db.entries import User


@pytest.fixture
def new_registry(tmp_path) -> str:
    return f"sqlite:///{tmp_path / 'new.db'}"


def test_every_page_has_a_title() -> None:
    assert all(f"page.{page.name}" in catalogue()["en"] for page in PAGES)


@pytest.mark.parametrize(
    ("role", "closed"), [("operator", {"audit_trail", "people"}), ("engineer", {"audit_trail", "people"})]
)
def test_the_pages_of_quality_are_closed_to_others(role, closed) -> None:
    assert not closed & {page.name for page in pages_for(User("x", role, True, 1))}


def test_who_may_no_longer_sign_in_may_open_what_everybody_may() -> None:
    assert {page.name for page in pages_for(User("x", "quality", False, 1))} == {"sign_in"}


def _sign_in_page() -> None:
    from softcal.app.ui.app_pages import sign_in

    sign_in.render()


def _people_page() -> None:
    from softcal.app.ui.app_pages import people

    people.render()


def first_person(screen, code: str, pin: str = "7391", again: str = "7391"):
    for key, value in (("code", code), ("name", "Quinn"), ("pin", pin), ("again", again)):
        screen.text_input(key=f"first-{key}").set_value(value)
    return screen.button[0].click().run()


def people_of(url: str) -> list[tuple[str, str]]:
    with open_registry(url) as registry:
        return [(user.name, user.role) for user in registry.users()]


def test_the_first_person_becomes_quality_by_the_code_that_the_server_printed(new_registry, open_page, capfd) -> None:
    identity.first_code.clear()
    screen = open_page(new_registry, _sign_in_page)
    code = identity.first_code()
    assert capfd.readouterr().out.count(code) == 1
    first_person(screen, code.replace("-", " "))
    assert any("<h1>Quinn</h1>" in block.proto.body for block in screen.get("html"))
    assert people_of(new_registry) == [("Quinn", "quality")]


def test_nobody_becomes_the_first_person_without_the_code(new_registry, open_page) -> None:
    identity._pauses.clear()
    screen = open_page(new_registry, _sign_in_page)
    for _ in range(FREE_FAILURES + 1):
        assert "not the code" in first_person(screen, "0000-000").error[0].value
    assert "wait" in first_person(screen, identity.first_code()).error[0].value
    assert people_of(new_registry) == []
    identity._pauses.clear()


@pytest.mark.parametrize(
    ("pin", "again"), [("7391", "7392"), ("0000", "0000"), ("1234", "1234"), ("8765", "8765"), ("1212", "1212")]
)
def test_a_pin_that_was_mistyped_or_is_soon_guessed_makes_nobody(new_registry, open_page, pin, again) -> None:
    screen = first_person(open_page(new_registry, _sign_in_page), identity.first_code(), pin, again)
    assert len(screen.error) == 1 and people_of(new_registry) == []


@pytest.mark.parametrize("name", ["kim", "nobody has this name"])
def test_guessing_waits_longer_each_time_whether_the_name_exists_or_not(name) -> None:
    now = [datetime(2026, 3, 2, tzinfo=UTC)]
    pauses, waits = Pauses(lambda: now[0]), []
    for _ in range(FREE_FAILURES + 9):
        pauses.failed(name.upper())
        began = now[0]
        while True:
            try:
                pauses.check(name)
                break
            except InputError:
                now[0] += timedelta(seconds=1)
        waits.append((now[0] - began).total_seconds())
    assert waits == [0] * FREE_FAILURES + [2, 4, 8, 16, 32, 64, 128, 256, 300]
    pauses.succeeded(name)
    pauses.failed(name)
    pauses.check(name)


def test_a_wrong_pin_is_refused_in_words(calibrated, open_page, add_everybody) -> None:
    add_everybody(calibrated)
    screen = open_page(calibrated, _sign_in_page)
    screen.text_input(key="sign-in-name").set_value("Quinn")
    screen.text_input(key="sign-in-pin").set_value("0000")
    screen.button[0].click().run()
    assert [error.value for error in screen.error] == ["name or PIN is wrong"]


def _person(screen, reason: str) -> None:
    chosen = {field.label: field for field in screen.selectbox}
    chosen["Person"].set_value("Erin").run()
    next(field for field in screen.selectbox if field.label == "Role").set_value("quality")
    screen.text_input(key="reason-text-people-Erin-1").set_value(reason)
    screen.button[0].click().run()


def test_a_change_of_a_person_lands_in_the_audit_trail_with_its_reason(calibrated, open_page) -> None:
    screen = open_page(calibrated, _people_page, role="quality")
    _person(screen, "took over the lab")
    assert screen.success[0].value == "Erin was saved"
    with open_registry(calibrated) as registry:
        row = registry.audit_rows()[-1]
    assert (row.actor, row.action, row.reason) == ("Quinn", "set_user", "took over the lab")


def test_a_change_without_a_reason_changes_nothing(calibrated, open_page) -> None:
    screen = open_page(calibrated, _people_page, role="quality")
    _person(screen, " ")
    assert "Say in a few words why" in screen.warning[0].value
    with open_registry(calibrated) as registry:
        assert {user.name: user.role for user in registry.users()}["Erin"] == "engineer"


def test_a_role_without_the_permission_gets_no_button(calibrated, open_page) -> None:
    screen = open_page(calibrated, _people_page, role="engineer")
    assert not screen.button and "As Engineer" in screen.caption[-1].value


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
