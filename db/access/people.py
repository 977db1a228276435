"""People with a role and a PIN. PINs are stored as Argon2id hashes and never leave this module."""

import hashlib
import hmac
import secrets
import threading
from contextlib import suppress
from datetime import datetime
from functools import cache, cached_property
from typing import TYPE_CHECKING

from sqlalchemy import RowMapping, func, insert, select, update

from softcal.core.errors import ChangedMeanwhile, InputError, SignInRefused
from softcal.core.messages.reason import Reason
from softcal.db.access.tries import MAX_PAUSE, Tries, minutes_until, pause_after
from softcal.db.entries import ROLES, User
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.database import Database
from softcal.db.schema.deadline import has_passed
from softcal.db.schema.tables import users

if TYPE_CHECKING:
    from argon2 import PasswordHasher

MIN_PIN_DIGITS = 4
MACHINE_TOKEN_LENGTH = 200
VERIFY_WITHIN_S = 10.0
VERIFYING = threading.BoundedSemaphore(1)
"""One PIN at a time is checked in a process: each takes a core and 64 MiB for a tenth of a second, for whoever asks."""

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
    """Return a hash that no PIN has; computed on demand, as it takes a quarter of a second."""
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

        What is so already is no change: no row of it is written. A PIN is hashed outside any transaction.

        `InputError`: no such role, a PIN too short, or another change since `version`.
        """
        if not name.strip():
            raise InputError(Reason("account.no_name"))
        if role not in ROLES:
            raise InputError(Reason("account.role", {"role": repr(role), "known": ", ".join(ROLES)}))
        if pin is not None and (len(pin) < MIN_PIN_DIGITS or not pin.isdigit()):
            raise InputError(Reason("account.pin_short", {"digits": MIN_PIN_DIGITS}))
        query = select(users).where(users.c.name == name)
        with self.database.reading():
            before = self.database.row(query)
        is_same_pin = pin is None or (before is not None and _is_pin(before, pin))
        pin_hash = None if pin is None or is_same_pin else _hasher().hash(pin)
        with self.database.writing():
            stored = self.database.row(query)
            current = stored["version"] if stored else 0
            if current != version:
                raise ChangedMeanwhile(
                    Reason("account.changed", {"name": repr(name), "found": current, "version": version})
                )
            if stored is None and pin is None:
                raise InputError(Reason("account.needs_pin", {"name": repr(name)}))
            requested = {"role": role, "is_active": is_active, "failures": 0, "locked_until": None}
            if stored is not None and is_same_pin and all(stored[field] == value for field, value in requested.items()):
                return user_of(self.database, stored)
            values = requested | {"name": name, "version": version + 1, "changed_at": self.settings.clock()}
            if pin_hash is not None:
                values["pin_hash"] = pin_hash
            statement = insert(users) if stored is None else update(users).where(users.c.name == name)
            self.database.change(statement.values(**values))
            row = self.database.rows(query)[0]
            earlier = person_in_trail(stored) if stored else None
            self._write_audit_row(
                "set_user", "users", (name,), actor, after=person_in_trail(row), before=earlier, reason=reason
            )
            return user_of(self.database, row)

    def all(self) -> list[User]:
        with self.database.reading():
            return [user_of(self.database, row) for row in self.database.rows(select(users).order_by(users.c.name))]

    def sign_in(self, name: str, pin: str, machine: str = "") -> User:
        """Return the person (`InputError`: wrong name or PIN, not active, or a pause after wrong ones).

        With the `machine_token` of an earlier sign-in, wrong tries are counted for that machine alone: who guesses
        elsewhere does not lock the owner out there. A PIN is checked outside any transaction.
        """
        if not VERIFYING.acquire(timeout=VERIFY_WITHIN_S):
            raise SignInRefused(Reason("account.locked", {"minutes": 1}))
        try:
            return self._sign_in(name, pin, machine)
        finally:
            VERIFYING.release()

    def machine_token(self, name: str) -> str:
        """Return the token of a trusted machine for a person after sign-in; raise `InputError` for an unknown person.

        It says that this machine was there before, and nothing else; it ends with the PIN.
        """
        row = self.database.row(select(users).where(users.c.name == name))
        if row is None:
            raise SignInRefused(Reason("account.wrong_pin"))
        nonce = secrets.token_hex(16)
        return f"{nonce}.{_machine_sha256(row, nonce)}"

    def _sign_in(self, name: str, pin: str, machine: str) -> User:
        now, query = self.settings.clock(), select(users).where(users.c.name == name)
        row = self.database.row(query)
        in_memory = _memory_key(row, name, machine)
        failures, until = self._tries.read(in_memory)
        if row is not None and not in_memory:
            failures, until = row["failures"], row["locked_until"]
        if not has_passed(until, now, MAX_PAUSE):
            raise SignInRefused(Reason("account.locked", {"minutes": minutes_until(until, now)}))
        is_right = _is_pin(row, pin)
        if in_memory:
            self._tries.note(in_memory, is_right, now)
        elif is_right and failures:
            self.database.change(update(users).where(users.c.name == name).values(failures=0, locked_until=None))
        elif not is_right:
            self._note_failure(name, now)
        if row is None or not is_right:
            raise SignInRefused(Reason("account.wrong_pin"))
        user = user_of(self.database, row)
        if not user.is_active:
            raise SignInRefused(Reason("account.inactive"))
        return user

    def _note_failure(self, name: str, now: datetime) -> None:
        """Count a failed sign-in in a separate transaction, as other processes may count at the same time."""
        is_person = users.c.name == name
        with self.database.writing():
            self.database.change(update(users).where(is_person).values(failures=users.c.failures + 1))
            failures = int(self.database.value(select(users.c.failures).where(is_person)))
            if pause := pause_after(failures):
                self.database.change(update(users).where(is_person).values(locked_until=now + pause))
                self._write_audit_row("lock", "users", (name,), name, after={"until": now + pause})

    @cached_property
    def _tries(self) -> Tries:
        return Tries()


def _is_pin(row: RowMapping | None, pin: str) -> bool:
    """Return whether a PIN is right; an unknown name takes the same time, by a check against a dummy hash."""
    from argon2.exceptions import InvalidHashError, VerificationError

    with suppress(VerificationError, InvalidHashError):
        return _hasher().verify(row["pin_hash"] if row else _nobody(), pin) and row is not None
    return False


def _memory_key(row: RowMapping | None, name: str, machine: str) -> str:
    """Return under which key tries are counted in memory; "" where the account itself counts them."""
    if row is None:
        return f"nobody {name[:120]}"
    nonce, _, digest = machine[:MACHINE_TOKEN_LENGTH].partition(".")
    is_same_machine = hmac.compare_digest(digest.encode(), _machine_sha256(row, nonce).encode())
    return f"machine {nonce}" if is_same_machine else ""


def _machine_sha256(row: RowMapping, nonce: str) -> str:
    # The hash of a PIN is as secret as a key, and new with every PIN.
    return hmac.new(row["pin_hash"].encode(), f"{row['name']}\n{nonce}".encode(), "sha256").hexdigest()


def permissions(user: User) -> frozenset[str]:
    """Return the rights of a person: those of the role; all rights while no other account exists.

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


def person_in_trail(row: RowMapping) -> dict[str, object]:
    """Return a person as JSON of the audit trail, with a hash of the PIN's hash."""
    content = {name: row[name] for name in ("name", "role", "is_active", "version")}
    return content | {"pin_sha256": hashlib.sha256(row["pin_hash"].encode()).hexdigest()}
