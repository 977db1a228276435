"""Who sits at the screen and what the role allows: nobody signed in, a PIN, or a company account.

A sign-in by PIN lives in this server's memory under a random token that the browser keeps in a cookie, so that it
survives a reload and a link, and ends with the shift, the browser or the server.
"""

import getpass
import hashlib
import os
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import streamlit as st

from softcal.app.jobs.launch import SIMULATED
from softcal.app.ui.browser_memory import recall, remember_secret
from softcal.app.ui.pins import is_code, new_code
from softcal.app.ui.server_cache import registry
from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason
from softcal.db.access.people import PERMISSIONS, may
from softcal.db.access.tries import MAX_PAUSE, Tries, minutes_until
from softcal.db.entries import ROLES, User
from softcal.db.schema.deadline import has_passed, is_silent

SHIFT = timedelta(hours=10)
"""A sign-in ends after this time, though Streamlit's cookie of a company account lives 30 days."""

SESSION = "session"
LOOPBACK = ("127.0.0.1", "::1", "localhost")
PROXY_HEADERS = ("X-Forwarded-For", "X-Forwarded-Host", "Forwarded")
ROLE_CLAIM_VARIABLE = "SOFTCAL_ROLE_CLAIM"
"""Environment variable: which claim of a company account names the role; usually `roles`."""


@dataclass(frozen=True)
class SignIn:
    """One sign-in by PIN: who, and until when."""

    name: str
    until: datetime


FIRST_ACCOUNT = "first account"
"""Key under which wrong codes are counted."""


@st.cache_resource(max_entries=1)
def _failed_codes() -> Tries:
    return Tries()


@st.cache_resource(max_entries=1)
def _sign_ins() -> dict[str, SignIn]:
    return {}


def person() -> User:
    """Return who is at the screen; without a sign-in the operator of the line."""
    claims = _claims()
    if role := role_of(claims, role_claim()):
        return User(_name_of(claims), role, True, 1)
    entry = _sign_ins().get(recall(SESSION))
    if entry is not None and not has_passed(entry.until, datetime.now(UTC), SHIFT):
        # Asked anew each time: who was made inactive, or has another role since, is so at once.
        for user in registry().people.all():
            if user.name == entry.name and user.is_active:
                return user
    if is_open_without_account():
        return User(system_user(), "quality", True, 0, is_alone=True)
    return User("", "operator", True, 0)


def is_open_without_account() -> bool:
    """Whether everything is open without an account: one person at their own machine, and no station yet.

    The server answers this machine alone, no proxy stands before it, and nobody has an account.
    """
    is_loopback = st.get_option("server.address") in LOOPBACK and not set(PROXY_HEADERS) & set(st.context.headers)
    if not is_loopback or has_company_accounts() or registry().people.all():
        return False
    return {heartbeat.station for heartbeat in registry().order_queue.stations()} <= {SIMULATED}


def system_user() -> str:
    """Return the name of the system's user, under which one person at their own machine works."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "operator"


def machine_cookie(name: str) -> str:
    """Return under which name a browser keeps that a person has signed in there before."""
    return f"machine_{hashlib.sha256(name.encode()).hexdigest()[:12]}"


def is_signed_in() -> bool:
    """Whether somebody has shown who they are; a badge is no proof."""
    return person().version != 0


def sign_in(name: str, pin: str) -> User:
    """Sign a person in; InputError for a wrong name or PIN, or too early after one."""
    name = name.strip()
    user = registry().people.sign_in(name, pin, recall(machine_cookie(name)))
    remember_secret(machine_cookie(name), registry().people.machine_token(name))
    token = secrets.token_urlsafe(24)
    now = datetime.now(UTC)
    sign_ins = _sign_ins()
    for old in [key for key, entry in sign_ins.items() if has_passed(entry.until, now, SHIFT)]:
        del sign_ins[old]
    sign_ins[token] = SignIn(user.name, now + SHIFT)
    remember_secret(SESSION, token)
    return user


def make_first_account(name: str, pin: str, code: str) -> User:
    """Make the first account of a registry, which decides about all others, and sign it in.

    Raises:
        InputError: the code is not what this server printed, a pause, or somebody was first.
    """
    now = datetime.now(UTC)
    _, until = _failed_codes().read(FIRST_ACCOUNT)
    if not has_passed(until, now, MAX_PAUSE):
        raise InputError(Reason("account.locked", {"minutes": minutes_until(until, now)}))
    is_right = is_code(code, first_code())
    _failed_codes().note(FIRST_ACCOUNT, is_right, now)
    if not is_right:
        raise InputError(Reason("account.no_code"))
    if registry().people.all():
        raise InputError(Reason("account.first_is_there"))
    registry().people.set(name, "quality", pin, actor=name, reason="the first account, by the code of the server")
    return sign_in(name, pin)


@st.cache_resource(max_entries=1)
def first_code() -> str:
    """Return the code for the first account; printed once, when it is asked for first."""
    code = new_code()
    print(f"softcal: the code for the first account of this registry is {code}", flush=True)
    return code


def sign_out() -> None:
    """End the sign-in of this browser; the screen is the operator's again."""
    _sign_ins().pop(recall(SESSION), None)
    remember_secret(SESSION, "")
    if st.user.get("is_logged_in"):
        st.logout()


def allows(action: str) -> bool:
    """Whether the role of who is at the screen allows an action of `PERMISSIONS`."""
    return may(person(), action)


def permit(action: str) -> User:
    """Return who is at the screen, or raise InputError; asked by every function that writes."""
    user = person()
    if not may(user, action):
        allowed = [role for role in ROLES if action in PERMISSIONS[role]]
        raise InputError(reason("account.may_not", role=user.role, roles=" or ".join(allowed)))
    return user


def actor() -> str:
    """Return the name for the audit trail."""
    return person().name or "operator"


def has_company_accounts() -> bool:
    """Whether this server was started with an identity provider (OIDC)."""
    try:
        return "auth" in st.secrets
    except FileNotFoundError:
        return False


def account_without_role() -> str:
    """Return the company account at this browser that names no role here; "" without."""
    claims = _claims()
    return _name_of(claims) if claims and role_of(claims, role_claim()) is None else ""


def role_claim() -> str:
    """Return which claim of a company account names the role."""
    return os.environ.get(ROLE_CLAIM_VARIABLE) or "roles"


def role_of(claims: dict[str, object], claim: str) -> str | None:
    """Return the highest role that the claims of a company account name, None where they name none.

    The claim holds it, or a list of roles or groups; a group may end in `/engineer`.
    """
    value = claims.get(claim)
    claimed = value if isinstance(value, list) else [value]
    role_names = {str(word).rpartition("/")[2].lower() for word in claimed if word}
    return next((role for role in ("quality", "engineer", "operator") if role in role_names), None)


def is_of_this_shift(claims: dict[str, object], now: datetime) -> bool:
    """Whether an identity token is less than a shift old (`iat`; OpenID Connect Core 1.0, 2)."""
    issued_s = claims.get("iat")
    if not isinstance(issued_s, int | float):
        return False
    return not is_silent(datetime.fromtimestamp(issued_s, UTC), now, SHIFT)


def _claims() -> dict[str, object]:
    """Return the claims of the company account at this browser; none after a shift."""
    if not st.user.get("is_logged_in"):
        return {}
    claims: dict[str, object] = {**st.user}
    return claims if is_of_this_shift(claims, datetime.now(UTC)) else {}


def _name_of(claims: dict[str, object]) -> str:
    return str(claims.get("email") or claims.get("name") or claims.get("sub"))
