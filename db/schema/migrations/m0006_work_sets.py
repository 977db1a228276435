"""Work items belong to a set: what is asked for together, under the same settings."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Make the table anew. It holds work under way and no history, and no version before this one used it."""
    op.drop_table("work_items")
    op.create_table(
        "work_items",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("work_set", sa.String(length=64), nullable=False),
        sa.Column("input_sha256", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=8), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("owner", sa.Text(), nullable=True),
        sa.Column("lease_until", sa.DateTime(timezone=True), nullable=True),
        sa.Column("result", sa.Text(), nullable=True),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("state IN ('queued', 'claimed', 'done', 'failed')", name="ck_work_items_state"),
        sa.PrimaryKeyConstraint("id", name="pk_work_items"),
    )
    op.create_index(
        "uq_work_items_item", "work_items", ["lot_id", "kind", "serial", "work_set", "input_sha256"], unique=True
    )
    op.create_index(
        "ix_work_items_set_state", "work_items", ["lot_id", "kind", "work_set", "state", "id"], unique=False
    )
    op.create_index("ix_work_items_owner", "work_items", ["owner", "state"], unique=False)
