"""Triggers that refuse every change of a row that was written; used by migrations, on both databases."""

from alembic import op

FUNCTION = """
CREATE OR REPLACE FUNCTION softcal_append_only() RETURNS trigger LANGUAGE plpgsql AS
$$ BEGIN RAISE EXCEPTION '% is append-only: a correction is a new row', TG_TABLE_NAME; END $$
"""


def forbid_changes(table: str) -> None:
    """Make UPDATE, DELETE and TRUNCATE of a table fail. A migration that rebuilds a table must call this again."""
    if op.get_bind().dialect.name == "sqlite":
        for action in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER {table}_no_{action.lower()} BEFORE {action} ON {table} "
                f"BEGIN SELECT RAISE(ABORT, '{table} is append-only: a correction is a new row'); END"
            )
    else:
        op.execute(FUNCTION)
        op.execute(
            f"CREATE TRIGGER {table}_append_only BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
            "FOR EACH STATEMENT EXECUTE FUNCTION softcal_append_only()"
        )
