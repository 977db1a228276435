"""Least privilege on PostgreSQL: rights of a line, a manager and readers, as SQL to run.

Only the owner of the tables can upgrade them and drop the triggers, no role that calibrates.
"""

import re

from softcal.core.errors import InputError
from softcal.db.schema.tables import APPEND_ONLY, metadata

CHANGING = {
    "users": "UPDATE (failures, locked_until)",
    "work_items": "INSERT, UPDATE, DELETE",
    "orders": "INSERT, UPDATE",
    "heartbeats": "INSERT, UPDATE",
    "run_signals": "INSERT, DELETE",
    "jobs": "INSERT, UPDATE",
    "line_places": "INSERT, UPDATE",
    "deliveries": "INSERT, UPDATE",
}
"""Tables whose rows change at the line, and how. Of people it may count wrong PINs and pause."""

DECIDED_ELSEWHERE = ("limits", "line_rules", "certificates", "network_releases", "confirmed_audits", "laboratories")
"""What the line goes by and must not set: its account reads it, the managing one adds to it."""

ROLE = re.compile(r"[a-z_][a-z0-9_]{0,62}")


def grant_statements(line: str, reader: str, manager: str) -> list[str]:
    """Return the SQL that grants each role the rights that it needs, and no others.

    Args:
        line: calibrates and adds to the history; cannot change what others decide.
        reader: reads everything but the PINs.
        manager: the rights of the line, and people, limits, rules and certificates.

    Raises:
        InputError: a name that is no plain PostgreSQL role.
    """
    for role in (line, reader, manager):
        if not ROLE.fullmatch(role):
            raise InputError(f"role {role!r}: lower-case letters, digits and '_' are allowed")
    names = ["alembic_version", *(table.name for table in metadata.sorted_tables)]
    # PINs are hashed, yet a hash of four digits is soon guessed: readers do not see them.
    grown = [name for name in APPEND_ONLY if name not in DECIDED_ELSEWHERE]
    readable = [name for name in names if name not in ("users", "tokens")]
    return [
        f"REVOKE ALL ON {', '.join(names)} FROM PUBLIC, {line}, {manager}, {reader};",
        f"REVOKE UPDATE (failures, locked_until) ON users FROM {line}, {manager};",
        f"GRANT SELECT ON {', '.join(names)} TO {line}, {manager};",
        f"GRANT SELECT ON {', '.join(readable)} TO {reader};",
        f"GRANT INSERT ON {', '.join(grown)} TO {line};",
        f"GRANT INSERT ON {', '.join(APPEND_ONLY)} TO {manager};",
        *(f"GRANT {rights} ON {name} TO {line}, {manager};" for name, rights in CHANGING.items()),
        f"GRANT INSERT, UPDATE ON users, tokens TO {manager};",
        f"GRANT USAGE ON SEQUENCE work_items_id_seq TO {line}, {manager};",
    ]
