"""People sign in with a PIN that nobody can read, and guessing does not pay."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import select

from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.db.access import people
from softcal.db.access.people import PERMISSIONS, may
from softcal.db.access.tries import LOCKED_FOR, MAX_FAILURES
from softcal.db.connection import open_registry
from softcal.db.repositories.registry_base import RegistrySettings
from softcal.db.schema.tables import users


def test_the_right_pin_gives_the_person_and_the_role(registry):
    user = registry.people.set("kim", "engineer", "2580", actor="admin")
    assert registry.people.sign_in("kim", "2580") == user
    assert may(user, "set_limit") and not may(user, "people")


@pytest.mark.parametrize(("name", "pin"), [("kim", "2581"), ("lee", "2580"), ("kim", "")])
def test_a_wrong_name_and_a_wrong_pin_read_the_same(registry, name, pin):
    registry.people.set("kim", "operator", "2580", actor="admin")
    with pytest.raises(InputError) as refused:
        registry.people.sign_in(name, pin)
    assert (refused.value.reason.code, refused.value.reason.values) == ("account.wrong_pin", {})


def test_no_pin_is_stored_or_logged(registry):
    # As long as no hash or time of a trail holds it by chance.
    pin = "2580147036914725"
    registry.people.set("kim", "operator", pin, actor="admin")
    with registry.database.reading() as connection:
        assert connection.execute(select(users.c.pin_hash)).scalar_one().startswith("$argon2id$")
    trail_text = " ".join(str(vars(row)) for row in registry.trail.rows())
    assert "set_user" in trail_text and pin not in trail_text and "argon2" not in trail_text


def test_a_stolen_hash_costs_who_guesses_as_much_as_rfc_9106_asks_for(real_hasher):
    # Its second recommended option: 3 passes over 64 MiB in 4 lanes.
    assert "$m=65536,t=3,p=4$" in real_hasher().hash("2580")


def test_guessing_leads_to_a_pause_even_for_the_right_pin(registry_url):
    now = [datetime(2026, 5, 4, tzinfo=UTC)]
    with open_registry(registry_url, RegistrySettings(clock=lambda: now[0])) as registry:
        registry.people.set("kim", "operator", "2580", actor="admin")
        for _ in range(MAX_FAILURES):
            with pytest.raises(InputError):
                registry.people.sign_in("kim", "0000")
        with pytest.raises(InputError, match=r"\b5 min"):
            registry.people.sign_in("kim", "2580")
        now[0] += LOCKED_FOR + timedelta(seconds=1)
        assert registry.people.sign_in("kim", "2580").name == "kim"


def waits_of(registry, now: list[datetime], name: str, tries: int) -> list[float]:
    """Seconds that each wrong try had to wait before it was taken."""
    waits, waited_s = [], 0.0
    while len(waits) < tries:
        with pytest.raises(InputError) as refused:
            registry.people.sign_in(name, "0000")
        if refused.value.reason.code == "account.locked":
            now[0] += timedelta(seconds=60)
            waited_s += 60
        else:
            waits.append(waited_s)
            waited_s = 0.0
    return waits


def test_each_pause_is_longer_and_the_same_for_a_name_that_nobody_has(registry_url):
    now = [datetime(2026, 5, 4, tzinfo=UTC)]
    with open_registry(registry_url, RegistrySettings(clock=lambda: now[0])) as registry:
        registry.people.set("kim", "operator", "2580", actor="admin")
        known_waits = waits_of(registry, now, "kim", 10)
        unknown = waits_of(registry, now, "lee", 10)
    grown = [wait for wait in known_waits if wait]
    assert known_waits == unknown and grown == sorted(set(grown)) and len(grown) > 2 and grown[-1] > 3600


def test_a_guess_holds_no_writer(registry_url, monkeypatch):
    class Slow:
        def hash(self, pin: str) -> str:
            return "hash"

        def verify(self, stored_hash: str, pin: str) -> bool:
            checking.set()
            assert go_on.wait(30)
            return False

    checking, go_on = threading.Event(), threading.Event()
    with open_registry(registry_url) as registry, ThreadPoolExecutor(1) as pool:
        registry.people.set("kim", "operator", "2580", actor="admin")
        monkeypatch.setattr(people, "_hasher", Slow)
        for name in ("kim", "nobody"):
            checking.clear()
            go_on.clear()
            guess = pool.submit(registry.people.sign_in, name, "0000")
            assert checking.wait(30)
            begun_s = time.monotonic()
            registry.lots.add(Lot(f"while {name}", "S0", 50.0))
            took_s = time.monotonic() - begun_s
            go_on.set()
            with pytest.raises(InputError):
                guess.result(30)
            assert took_s < 3


def test_who_guesses_from_elsewhere_does_not_lock_the_owner_out_at_a_known_machine(registry):
    registry.people.set("quinn", "quality", "7391", actor="admin")
    registry.people.sign_in("quinn", "7391")
    machine = registry.people.machine_token("quinn")
    for _ in range(50):
        with pytest.raises(InputError):
            registry.people.sign_in("quinn", "0000")
    with pytest.raises(InputError):
        registry.people.sign_in("quinn", "7391")
    assert registry.people.sign_in("quinn", "7391", machine).name == "quinn"
    # What was guessed elsewhere is still being paced.
    with pytest.raises(InputError):
        registry.people.sign_in("quinn", "7391")


def test_a_known_machine_is_paced_by_itself_and_known_for_one_account_and_pin(registry):
    first = registry.people.set("quinn", "quality", "7391", actor="admin")
    registry.people.set("kim", "operator", "2580", actor="admin")
    machine = registry.people.machine_token("quinn")
    for _ in range(MAX_FAILURES):
        with pytest.raises(InputError):
            registry.people.sign_in("quinn", "0000", machine)
    with pytest.raises(InputError):
        registry.people.sign_in("quinn", "7391", machine)
    # Wrong tries there lock nobody elsewhere.
    assert registry.people.sign_in("quinn", "7391").name == "quinn"
    other = registry.people.machine_token("quinn")
    for _ in range(MAX_FAILURES):
        with pytest.raises(InputError):
            registry.people.sign_in("kim", "0000", other)
    with pytest.raises(InputError):
        registry.people.sign_in("kim", "2580", other)
    registry.people.set("quinn", "quality", "8642", actor="admin", version=first.version)
    for _ in range(MAX_FAILURES):
        with pytest.raises(InputError):
            registry.people.sign_in("quinn", "0000")
    with pytest.raises(InputError):
        registry.people.sign_in("quinn", "8642", other)


@pytest.mark.parametrize("machine", ["", ".", "a.b", "x" * 10_000, "\0.é"])
def test_a_token_of_a_machine_that_is_none_is_no_error(registry, machine):
    registry.people.set("kim", "operator", "2580", actor="admin")
    assert registry.people.sign_in("kim", "2580", machine).name == "kim"


def test_what_is_so_already_is_no_change(registry):
    user = registry.people.set("kim", "operator", "2580", actor="admin")
    rows = len(registry.trail.rows())
    for pin in (None, "2580"):
        assert registry.people.set("kim", "operator", pin, actor="admin", version=user.version) == user
    assert len(registry.trail.rows()) == rows
    assert registry.people.set("kim", "operator", "2581", actor="admin", version=user.version).version > user.version
    assert registry.people.sign_in("kim", "2581")


def test_two_editors_do_not_overwrite_each_other(registry):
    first = registry.people.set("kim", "operator", "2580", actor="admin")
    registry.people.set("kim", "engineer", actor="anna", version=first.version)
    with pytest.raises(InputError):
        registry.people.set("kim", "quality", actor="ben", version=first.version)
    assert registry.people.all()[0].role == "engineer" and registry.people.sign_in("kim", "2580")


def test_who_left_cannot_sign_in(registry):
    registry.people.set("kim", "operator", "2580", actor="admin")
    registry.people.set("kim", "operator", actor="admin", is_active=False, version=1)
    with pytest.raises(InputError):
        registry.people.sign_in("kim", "2580")


@pytest.mark.parametrize(
    ("role", "pin"), [("boss", "2580"), ("operator", "12"), ("operator", "abcd"), ("operator", None)]
)
def test_a_senseless_person_is_refused(registry, role, pin):
    with pytest.raises(InputError):
        registry.people.set("kim", role, pin, actor="admin")
    assert registry.people.all() == []


def test_who_is_alone_may_do_everything_until_a_second_account_exists(registry):
    everything = frozenset().union(*PERMISSIONS.values())
    first = registry.people.set("quinn", "quality", "7391", actor="quinn")
    _, secret = registry.tokens.add("quinn", "trial", 1, actor="quinn")
    for alone in (
        first,
        registry.people.sign_in("quinn", "7391"),
        *registry.people.all(),
        registry.tokens.user_of(secret),
    ):
        assert {action for action in everything if may(alone, action)} == everything
    registry.people.set("kim", "operator", "2580", actor="quinn")
    users = (registry.people.sign_in("quinn", "7391"), registry.people.all()[1], registry.tokens.user_of(secret))
    for quality in users:
        assert {action for action in everything if may(quality, action)} == PERMISSIONS["quality"]
    # Who may not sign in any more was somebody: duties that were parted stay so.
    registry.people.set("kim", "operator", actor="quinn", is_active=False, version=1)
    assert not may(registry.people.sign_in("quinn", "7391"), "set_up")


def test_an_only_account_that_may_not_make_others_gets_nothing_more(registry):
    operator = registry.people.set("kim", "operator", "2580", actor="admin")
    assert not may(operator, "people") and not may(operator, "set_up")
