"""Triggers that refuse every change of an existing row, created by migrations."""

import hashlib

BODY = "BEGIN RAISE EXCEPTION '% is append-only: a correction is a new row', TG_TABLE_NAME; END"
FUNCTION = f"""
CREATE OR REPLACE FUNCTION softcal_append_only() RETURNS trigger LANGUAGE plpgsql AS
$$ {BODY} $$
"""
BEFORE_STATEMENT_ON_CHANGES = 2 + 8 + 16 + 32
"""`tgtype` of `pg_trigger`: before DELETE, UPDATE and TRUNCATE, once a statement (PostgreSQL, pg_trigger.h)."""


def forbid_changes(table: str) -> None:  # noqa: V103
    """Make UPDATE, DELETE and TRUNCATE of a table fail. Who rebuilds a table calls this again."""
    # Alembic takes half a second to import: only migrations pay.
    from alembic import op

    if op.get_bind().dialect.name == "sqlite":
        for definition in triggers_of(table, "sqlite").values():
            op.execute(definition)
    else:
        op.execute(FUNCTION)
        op.execute(
            f"CREATE TRIGGER {table}_append_only BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
            "FOR EACH STATEMENT EXECUTE FUNCTION softcal_append_only()"
        )


def triggers_of(table: str, dialect: str) -> dict[str, str]:
    """Return the triggers of a table by name, as the checks of the registry read them back.

    Args:
        dialect: `sqlite`, where it is the whole statement, or `postgresql`, where it is table, function, kind, state
            and a hash of the function's body.
    """
    if dialect == "sqlite":
        return {
            f"{table}_no_{action.lower()}": f"CREATE TRIGGER {table}_no_{action.lower()} BEFORE {action} ON {table} "
            f"BEGIN SELECT RAISE(ABORT, '{table} is append-only: a correction is a new row'); END"
            for action in ("UPDATE", "DELETE")
        }
    body = hashlib.md5(f" {BODY} ".encode(), usedforsecurity=False).hexdigest()
    kind = f"{table} softcal_append_only {BEFORE_STATEMENT_ON_CHANGES} O {body}"
    return {f"{table}_append_only": kind}
