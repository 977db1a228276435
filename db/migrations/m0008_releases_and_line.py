"""Which network of a lot the line may use; and what stands at a line: the unit that waits, the note, the badge."""

from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op

from softcal.db.append_only import forbid_changes

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Make the tables. What a lot had before stays in use; of what it gets from now on, only what is released."""
    op.create_table(
        "network_releases",
        sa.Column("network_id", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.CheckConstraint("state IN ('released', 'withdrawn')", name="ck_network_releases_state"),
        sa.ForeignKeyConstraint(["network_id"], ["networks.id"], name="fk_network_releases_network_id_networks"),
        sa.ForeignKeyConstraint(["lot_id"], ["lots.id"], name="fk_network_releases_lot_id_lots"),
        sa.PrimaryKeyConstraint("network_id", "made_at", "origin", name="pk_network_releases"),
    )
    forbid_changes("network_releases")
    op.create_table(
        "line_places",
        sa.Column("station", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("place", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("station", name="pk_line_places"),
    )
    info = sa.table("registry_info", sa.column("key", sa.String), sa.column("value", sa.Text))
    op.execute(sa.insert(info).values(key="releases_since", value=datetime.now(UTC).isoformat()))
