"""Which calibration is in use is a statement of its own; so is which network the line may use, and what waits there.

The work queue keeps no results.
"""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Make the tables of this step. Work items hold work under way and no history, so their table is made anew."""
    op.create_table(
        "in_use",
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("made_by", sa.String(length=32), nullable=False),
        sa.Column("follows_origin", sa.String(length=32), nullable=True),
        sa.Column("follows_number", sa.Integer(), nullable=True),
        sa.Column("decided_by", sa.String(length=16), nullable=False),
        sa.Column("work_sha256", sa.String(length=64), nullable=True),
        sa.Column("input_sha256", sa.String(length=64), nullable=True),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.CheckConstraint("number >= 1", name="ck_in_use_number"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_in_use_lot_id_serial_units"
        ),
        sa.ForeignKeyConstraint(
            ["serial", "revision", "made_by"],
            ["calibrations.serial", "calibrations.revision", "calibrations.origin"],
            name="fk_in_use_serial_revision_made_by_calibrations",
        ),
        sa.PrimaryKeyConstraint("lot_id", "serial", "origin", "number", name="pk_in_use"),
    )
    op.create_index("ix_in_use_lot_id_serial", "in_use", ["lot_id", "serial", "made_at"], unique=False)
    op.create_index("ix_in_use_serial", "in_use", ["serial"], unique=False)
    forbid_changes("in_use")
    op.add_column("refusals", sa.Column("work_sha256", sa.String(length=64), nullable=True))
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
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("state IN ('queued', 'claimed', 'failed')", name="ck_work_items_state"),
        sa.PrimaryKeyConstraint("id", name="pk_work_items"),
    )
    op.create_index(
        "uq_work_items_item", "work_items", ["lot_id", "kind", "serial", "work_set", "input_sha256"], unique=True
    )
    op.create_index(
        "ix_work_items_set_state", "work_items", ["lot_id", "kind", "work_set", "state", "id"], unique=False
    )
    op.create_index("ix_work_items_owner", "work_items", ["owner", "state"], unique=False)
    _releases_and_line()


def _releases_and_line() -> None:
    """Make the tables. That what a lot had before stays in use is stated in the audit trail, by `db.care`."""
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
