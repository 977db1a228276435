"""Least privilege on PostgreSQL: what a line's programs and what readers may do with the tables, as SQL to run.

The owner of the tables alone can upgrade them and drop the triggers; nobody who calibrates should be the owner.
"""

import re

from softcal.core.errors import InputError
from softcal.db.tables import APPEND_ONLY, metadata

CHANGING = {"users": "INSERT, UPDATE", "work_items": "INSERT, UPDATE, DELETE", "orders": "INSERT, UPDATE",
            "heartbeats": "INSERT, UPDATE", "run_signals": "INSERT, DELETE",
            "jobs": "INSERT, UPDATE", "line_places": "INSERT, UPDATE"}  # fmt: skip
"""Tables whose rows change, and how; all the others only grow."""

ROLE = re.compile(r"[a-z_][a-z0-9_]{0,62}")


def grant_statements(line: str, reader: str) -> list[str]:
    """Return the SQL that gives a role of the line and a reading role what they need, and nothing else.

    Raises:
        InputError: a name that is no plain PostgreSQL role.
    """
    for role in (line, reader):
        if not ROLE.fullmatch(role):
            raise InputError(f"role {role!r}: lower-case letters, digits and '_' are allowed")
    names = ["alembic_version", *(table.name for table in metadata.sorted_tables)]
    # PINs are hashed, yet a hash of four digits is soon guessed: readers do not see them.
    shown = [name for name in names if name != "users"]
    return [
        f"REVOKE ALL ON {', '.join(names)} FROM PUBLIC, {line}, {reader};",
        f"GRANT SELECT ON {', '.join(names)} TO {line};",
        f"GRANT SELECT ON {', '.join(shown)} TO {reader};",
        f"GRANT INSERT ON {', '.join(APPEND_ONLY)} TO {line};",
        *(f"GRANT {rights} ON {name} TO {line};" for name, rights in CHANGING.items()),
        f"GRANT USAGE ON SEQUENCE work_items_id_seq TO {line};",
    ]
