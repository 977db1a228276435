"""The rules of a lot at the line: how its serials look, how many units are planned, who may be pressed again."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Make the table of this step."""
    op.create_table(
        "line_rules",
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("rules", sa.Text(), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.CheckConstraint("version >= 1", name="ck_line_rules_version"),
        sa.ForeignKeyConstraint(["lot_id"], ["lots.id"], name="fk_line_rules_lot_id_lots"),
        sa.PrimaryKeyConstraint("lot_id", "version", "origin", name="pk_line_rules"),
    )
    forbid_changes("line_rules")
