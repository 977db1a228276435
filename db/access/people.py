"""People with a role and a PIN. PINs are kept as Argon2id hashes and never leave this module."""

import hashlib
from contextlib import suppress
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING

from sqlalchemy import RowMapping, func, insert, select, update

from softcal.core.errors import ChangedMeanwhile, InputError, SignInRefused
from softcal.core.words.reason import Reason
from softcal.db.entries import ROLES, User
from softcal.db.schema.database import Database
from softcal.db.schema.tables import users
from softcal.db.truth.registry_base import RegistryBase

if TYPE_CHECKING:
    from argon2 import PasswordHasher

SHORTEST_PIN = 4
MOST_FAILURES = 5
LOCKED_FOR = timedelta(minutes=5)
"""A four-digit PIN would fall to 10,000 guesses; after five wrong ones there is a pause."""

PERMISSIONS = {
    "operator": frozenset({"calibrate", "look"}),
    "engineer": frozenset({"calibrate", "look", "set_limit", "rollback", "override", "set_up", "release"}),
    "quality": frozenset({"look", "set_limit", "rollback", "override", "people", "audit", "release"}),
}


@cache
def _hasher() -> "PasswordHasher":
    # Only who signs in or sets a PIN pays for it.
    from argon2 import PasswordHasher

    return PasswordHasher()


@cache
def _nobody() -> str:
    """Return a hash that no PIN has; not at import: it takes a quarter of a second."""
    return _hasher().hash("nobody has this PIN")


class People(RegistryBase):
    """Accounts with role and PIN."""

    def set(
        self,
        name: str,
        role: str,
        pin: str | None = None,
        *,
        actor: str,
        reason: str = "",
        is_active: bool = True,
        version: int = 0,
    ) -> User:
        """Add a person (version 0), or change the version that was looked at; without a `pin` the old one stays.

        `InputError`: no such role, a PIN too short, or another change since `version`.
        """
        if not name.strip():
            raise InputError(Reason("account.no_name"))
        if role not in ROLES:
            raise InputError(Reason("account.role", {"role": repr(role), "known": ", ".join(ROLES)}))
        if pin is not None and (len(pin) < SHORTEST_PIN or not pin.isdigit()):
            raise InputError(Reason("account.pin_short", {"digits": SHORTEST_PIN}))
        named = select(users).where(users.c.name == name)
        with self.database.writing():
            known = self.database.row(named)
            current = known["version"] if known else 0
            if current != version:
                raise ChangedMeanwhile(
                    Reason("account.changed", {"name": repr(name), "found": current, "version": version})
                )
            if known is None and pin is None:
                raise InputError(Reason("account.needs_pin", {"name": repr(name)}))
            values = {"name": name, "role": role, "is_active": is_active, "version": version + 1}
            values |= {"failures": 0, "locked_until": None, "changed_at": self.settings.clock()}
            if pin is not None:
                values["pin_hash"] = _hasher().hash(pin)
            statement = insert(users) if known is None else update(users).where(users.c.name == name)
            self.database.change(statement.values(**values))
            row = self.database.rows(named)[0]
            before = people_as_told(known) if known else None
            self._tell("set_user", "users", (name,), actor, after=people_as_told(row), before=before, reason=reason)
            return user_of(self.database, row)

    def all(self) -> list[User]:
        with self.database.reading():
            return [user_of(self.database, row) for row in self.database.rows(select(users).order_by(users.c.name))]

    def sign_in(self, name: str, pin: str) -> User:
        """Return the person (`InputError`: wrong name or PIN, not active, or a pause after wrong ones)."""
        from argon2.exceptions import InvalidHashError, VerificationError

        with self.database.writing():
            row = self.database.row(select(users).where(users.c.name == name))
            now = self.settings.clock()
            is_locked = row is not None and row["locked_until"] is not None and row["locked_until"] > now
            # The hash is checked even for an unknown name, so that the time it takes says nothing.
            is_right = False
            with suppress(VerificationError, InvalidHashError):
                is_right = _hasher().verify(row["pin_hash"] if row else _nobody(), pin)
            if row is not None and not is_locked:
                failures = 0 if is_right else row["failures"] + 1
                pause = now + LOCKED_FOR if failures >= MOST_FAILURES else None
                values = {"failures": 0 if pause else failures, "locked_until": pause}
                self.database.change(update(users).where(users.c.name == name).values(**values))
                if pause:
                    self._tell("lock", "users", (name,), name, after={"until": pause})
            user = None if row is None else user_of(self.database, row)
        if is_locked:
            raise SignInRefused(Reason("account.locked", {"minutes": LOCKED_FOR.seconds // 60}))
        if user is None or not is_right:
            raise SignInRefused(Reason("account.wrong_pin"))
        if not user.is_active:
            raise SignInRefused(Reason("account.inactive"))
        return user


def permissions(user: User) -> frozenset[str]:
    """Return what a person may do: what the role allows; everything while alone.

    Who decides about people could make a second account anyway.
    """
    if not user.is_active:
        return frozenset()
    return frozenset().union(*PERMISSIONS.values()) if user.is_alone else PERMISSIONS[user.role]


def may(user: User, action: str) -> bool:
    """Whether a person may do an action of `PERMISSIONS`."""
    return action in permissions(user)


def user_of(database: Database, row: RowMapping) -> User:
    """Return the person of a row that has name, role, is_active and version."""
    is_alone = "people" in PERMISSIONS[row["role"]] and database.value(select(func.count()).select_from(users)) == 1
    return User(row["name"], row["role"], row["is_active"], row["version"], is_alone)


def people_as_told(row: RowMapping) -> dict[str, object]:
    """Return a person as the audit trail tells of one: of the PIN's hash only a hash."""
    content = {name: row[name] for name in ("name", "role", "is_active", "version")}
    return content | {"pin_sha256": hashlib.sha256(row["pin_hash"].encode()).hexdigest()}
