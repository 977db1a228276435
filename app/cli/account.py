"""`softcal account`: people and roles, for a server without a screen."""

import argparse
import sys
from getpass import getpass
from pathlib import Path

from softcal.app.cli.options import actions_of, add_shared, answer, registry_of
from softcal.app.output import echo, print_table
from softcal.core.errors import InputError
from softcal.db.entries import ROLES, User

EXAMPLES = """examples:
  softcal account set "Mina Park" --role quality --reason "first account of line 3"     asks for the PIN
  softcal account set MES --role engineer --reason "MES of hall 3" --pin-file pin.txt   or - for standard input
  softcal account set "Jo Kim" --inactive --reason "left the company"
  softcal account list

Operators need no account. The page People shows and changes the same accounts.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Make, change and list accounts. Every change lands in the audit trail with its reason."""
    action = actions_of(parser)
    change = action("set", "make an account, or change its role, its PIN or whether it is active", _set)
    add = change.add_argument
    add("name", metavar="NAME")
    add("--role", choices=ROLES, help="needed for a new account")
    add_shared(change, "reason")
    add("--pin-file", metavar="FILE", help="the new PIN is its first line; - for standard input")
    add("--new-pin", action="store_true", help="ask for a new PIN of an account that is there")
    active = change.add_mutually_exclusive_group()
    active.add_argument("--inactive", action="store_true", help="may no longer sign in")
    active.add_argument("--active", action="store_true", help="may sign in again")
    listing = action("list", "every account with its role", _list)
    add_shared(listing, "csv")
    for each in (change, listing):
        add_shared(each, "registry", "json")


def _set(options: argparse.Namespace) -> None:
    name = options.name.strip()
    with registry_of(options) as registry:
        existing = next((user for user in registry.people.all() if user.name == name), None)
        if existing is None and options.role is None:
            raise InputError(f"{name!r} has no account yet; --role says what it may: {', '.join(ROLES)}")
        pin = _pin(options) if existing is None or options.new_pin or options.pin_file else None
        is_active = options.active or (not options.inactive and (existing is None or existing.is_active))
        user = registry.people.set(
            name,
            options.role or existing.role,  # type: ignore[union-attr]
            pin,
            actor=registry.settings.actor,
            reason=options.reason,
            is_active=is_active,
            version=0 if existing is None else existing.version,
        )
    state = "may sign in" if user.is_active else "may not sign in"
    echo(f"{user.name}: {user.role}, {state}")
    answer(options, "account/1", _account(user))


def _pin(options: argparse.Namespace) -> str:
    """Return the new PIN: never out of an option, which every process of the machine may read."""
    from softcal.app.ui.pins import check_pin

    if options.pin_file is not None:
        try:
            text = sys.stdin.read() if options.pin_file == "-" else Path(options.pin_file).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{options.pin_file}: the PIN cannot be read: {error}") from error
        pin = again = (text.splitlines() or [""])[0].strip()
    elif sys.stdin.isatty():
        pin, again = getpass("PIN: "), getpass("again: ")
    else:
        raise InputError("there is no terminal to ask for the PIN at; give --pin-file FILE, or - for standard input")
    check_pin(pin, again)
    return pin


def _list(options: argparse.Namespace) -> None:
    with registry_of(options) as registry:
        users = registry.people.all()
    answer(options, "accounts/1", {"accounts": [_account(user) for user in users]})
    print_table(("name", "role", "may sign in"), [[u.name, u.role, "yes" if u.is_active else "no"] for u in users])


def _account(user: User) -> dict[str, object]:
    return {"name": user.name, "role": user.role, "is_active": user.is_active}
