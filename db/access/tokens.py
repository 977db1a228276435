"""Tokens by which programs sign in: each belongs to an account, whose role gives the rights.

A token is 256 random bits: its SHA-256 cannot be guessed back. It is shown once.
"""

import hashlib
import secrets
import uuid
from datetime import timedelta
from typing import Any

from sqlalchemy import RowMapping, insert, select, update

from softcal.core.errors import InputError
from softcal.db.access.people import user_of
from softcal.db.entries import Token, User
from softcal.db.repositories import history
from softcal.db.repositories.registry_base import RegistryBase, damage_error, entry_from_row
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.tables import audit, tokens, users

PREFIX = "softcal_"
"""How a token begins, so that one that was published by mistake is found."""

MAX_DAYS = 3650
TRAIL_FIELDS = ("account", "purpose", "ends_at", "is_withdrawn")


class TokenTable(RegistryBase):
    """Tokens of programs that ask over REST."""

    def add(self, account: str, purpose: str, days: int, *, actor: str | None = None) -> tuple[Token, str]:
        """Create a token for an account; return it with the secret text, which is not stored.

        `InputError`: no such active account, no purpose, or an impossible number of days.
        """
        if not purpose.strip():
            raise InputError("a token needs a purpose: say which program it is for")
        if not 0 < days <= MAX_DAYS:
            raise InputError(f"a token holds for 1 to {MAX_DAYS} days, not {days}")
        secret, now = PREFIX + secrets.token_urlsafe(32), self.settings.clock()
        with self.database.writing():
            user = self.database.row(select(users).where(users.c.name == account))
            if user is None or not user["is_active"]:
                raise InputError(
                    f"there is no active account {account!r}; people with the role quality add one, on the page People"
                )
            values: dict[str, Any] = {"token_id": uuid.uuid4().hex[:12], "sha256": _sha256(secret), "account": account}
            values |= {"purpose": purpose, "created": now, "ends_at": now + timedelta(days=days), "is_withdrawn": False}
            self.database.change(insert(tokens).values(**values))
            row = self._row(values["token_id"])
            self._write_audit_row("add", "tokens", (row["token_id"],), actor, after=token_in_trail(row))
        return entry_from_row(Token, row), secret

    def withdraw(self, token_id: str, *, reason: str, actor: str | None = None) -> None:
        """Withdraw a token; raise `InputError` if it does not exist or is withdrawn already."""
        with self.database.writing():
            before = self._row(token_id)
            if before["is_withdrawn"]:
                raise InputError(f"token {token_id} was withdrawn already")
            self.database.change(update(tokens).where(tokens.c.token_id == token_id).values(is_withdrawn=True))
            content = {"before": token_in_trail(before), "after": token_in_trail(self._row(token_id))}
            self._write_audit_row("withdraw", "tokens", (token_id,), actor, reason=reason, **content)

    def all(self) -> list[Token]:
        """Return all tokens, the oldest first, without their secrets."""
        query = select(tokens).order_by(tokens.c.created, tokens.c.token_id)
        return [entry_from_row(Token, row) for row in self.database.rows(query)]

    def user_of(self, secret: str) -> User:
        """Return the account of a token, with its present role.

        `InputError`: unknown, ended, withdrawn, or an inactive account. `RegistryError`: not as the trail tells of it.
        """
        query = select(tokens, users.c.name, users.c.role, users.c.is_active, users.c.version).join(users)
        with self.database.reading():
            row = self.database.row(query.where(tokens.c.sha256 == _sha256(secret)))
            if row is None or row["is_withdrawn"] or not row["is_active"] or row["ends_at"] <= self.settings.clock():
                raise InputError("this token is unknown, has ended or was withdrawn, or its account is not active")
            of_token = select(audit.c.after).where(
                audit.c.entity == "tokens", audit.c.key == canonical_json((row["token_id"],))
            )
            newest = self.database.value(of_token.order_by(audit.c.at.desc(), audit.c.seq.desc()).limit(1))
            if newest != canonical_json(history.plain(token_in_trail(row))):
                raise damage_error(f"token {row['token_id']} is not what the audit trail tells of it")
            return user_of(self.database, row)

    def _row(self, token_id: str) -> RowMapping:
        row = self.database.row(select(tokens).where(tokens.c.token_id == token_id))
        if row is None:
            raise InputError(f"there is no token {token_id!r}; `softcal api token list` shows them")
        return row


def token_in_trail(row: RowMapping) -> dict[str, object]:
    """Return a token as JSON of the audit trail, with a hash of its hash."""
    return {name: row[name] for name in TRAIL_FIELDS} | {"token_sha256": _sha256(row["sha256"])}


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
