"""Work items belong to a set: what is asked for together, under the same settings."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.columns import make_table

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Make the table anew. It holds work under way and no history, and no version before this one used it."""
    op.drop_table("work_items")
    make_table(
        "work_items",
        "id number*, lot_id 64, serial 64, kind 32, work_set 64, input_sha256 64, state 8, "
        "attempts int, owner text?, lease_until time?, result text?, error text?, changed_at time",
        sa.CheckConstraint("state IN ('queued', 'claimed', 'done', 'failed')", name="ck_work_items_state"),
    )
    op.create_index(
        "uq_work_items_item", "work_items", ["lot_id", "kind", "serial", "work_set", "input_sha256"], unique=True
    )
    op.create_index(
        "ix_work_items_set_state", "work_items", ["lot_id", "kind", "work_set", "state", "id"], unique=False
    )
    op.create_index("ix_work_items_owner", "work_items", ["owner", "state"], unique=False)
