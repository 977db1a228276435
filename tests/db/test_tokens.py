"""Tokens of programs: hashed, with the role of their account as it is now, every change in the audit trail."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import select, update

from softcal.core.errors import InputError, RegistryError
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.schema.tables import tokens


@pytest.fixture
def account(registry):
    registry.people.set("mes", "engineer", "2580", actor="admin")
    return registry


def test_a_token_signs_in_as_its_account_and_its_text_is_kept_nowhere(account):
    token, secret = account.tokens.add("mes", "line 3", 30, actor="admin")
    assert account.tokens.user_of(secret).role == "engineer"
    with account.database.reading() as connection:
        row = connection.execute(select(tokens)).mappings().one()
    stored_text = " ".join(map(str, row.values())) + " ".join(
        f"{r.before}{r.after}{r.reason}" for r in account.trail.rows()
    )
    assert secret not in stored_text and secret.removeprefix("softcal_") not in stored_text
    assert token in account.tokens.all()


@pytest.mark.parametrize("text_", ["", "softcal_", "softcal_" + "A" * 43])
def test_a_wrong_token_is_refused(account, text_):
    account.tokens.add("mes", "line 3", 30)
    with pytest.raises(InputError):
        account.tokens.user_of(text_)


def test_a_withdrawn_token_is_refused_and_the_trail_says_who_and_why(account):
    token, secret = account.tokens.add("mes", "line 3", 30)
    account.tokens.withdraw(token.token_id, reason="lost", actor="quinn")
    with pytest.raises(InputError):
        account.tokens.user_of(secret)
    last = account.trail.list_rows("tokens", (token.token_id,))[-1]
    assert (last.action, last.actor, last.reason) == ("withdraw", "quinn", "lost")
    with pytest.raises(InputError):
        account.tokens.withdraw(token.token_id, reason="again")


def test_a_token_ends_on_its_day(account):
    start = datetime(2026, 5, 4, tzinfo=UTC)
    account.tokens.settings = replace(account.settings, clock=lambda: start)
    _, secret = account.tokens.add("mes", "line 3", 30)
    account.tokens.settings = replace(account.settings, clock=lambda: start + timedelta(days=30, seconds=-1))
    assert account.tokens.user_of(secret).name == "mes"
    account.tokens.settings = replace(account.settings, clock=lambda: start + timedelta(days=30))
    with pytest.raises(InputError):
        account.tokens.user_of(secret)


def test_a_token_has_the_role_its_account_has_now(account):
    _, secret = account.tokens.add("mes", "line 3", 30)
    account.people.set("mes", "operator", actor="admin", version=1)
    assert account.tokens.user_of(secret).role == "operator"
    account.people.set("mes", "operator", actor="admin", version=2, is_active=False)
    with pytest.raises(InputError):
        account.tokens.user_of(secret)


@pytest.mark.parametrize(
    ("account_name", "purpose", "days"), [("nobody", "x", 1), ("mes", " ", 1), ("mes", "x", 0), ("mes", "x", 10**9)]
)
def test_an_impossible_token_is_refused(account, account_name, purpose, days):
    with pytest.raises(InputError):
        account.tokens.add(account_name, purpose, days)
    assert account.tokens.all() == []


@pytest.mark.parametrize("change", [{"account": "boss"}, {"token_id": "eve"}])
def test_a_token_that_was_changed_or_put_in_behind_the_trail_is_refused_and_found(account, change):
    account.people.set("boss", "quality", "7777", actor="admin")
    _, secret = account.tokens.add("mes", "line 3", 30)
    assert account.verify() == []
    with account.database.writing() as connection:
        connection.execute(update(tokens).values(**change))
    with pytest.raises(RegistryError):
        account.tokens.user_of(secret)
    assert any(fault.startswith("tokens") for fault in account.verify())


@pytest.mark.long
def test_a_restored_backup_holds_no_tokens_and_knows_how_far_its_destinations_were(account, new_url, tmp_path):
    token, secret = account.tokens.add("mes", "line 3", 30)
    account.outbox.begin("mes", account.outbox.end())
    back_up(account.database, tmp_path / "backup.db")
    restore(tmp_path / "backup.db", url := new_url())
    with open_registry(url) as restored:
        assert restored.tokens.all() == [] and restored.verify() == []
        with pytest.raises(InputError):
            restored.tokens.user_of(secret)
        assert [one.destination for one in restored.outbox.deliveries()] == ["mes"]
