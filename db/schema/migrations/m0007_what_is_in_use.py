"""Which calibration is in use is a statement of its own; so is which network the line may use, and what waits there.

The work queue keeps no results.
"""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes
from softcal.db.schema.columns import make_table

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Make the tables of this step. Work items hold work under way and no history, so their table is made anew."""
    make_table(
        "in_use",
        "lot_id 64*, serial 64*, origin 32*, number int*, revision int, made_by 32, "
        "follows_origin 32?, follows_number int?, decided_by 16, work_sha256 64?, "
        "input_sha256 64?, made_at time, actor text, reason text",
        sa.CheckConstraint("number >= 1", name="ck_in_use_number"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_in_use_lot_id_serial_units"
        ),
        sa.ForeignKeyConstraint(
            ["serial", "revision", "made_by"],
            ["calibrations.serial", "calibrations.revision", "calibrations.origin"],
            name="fk_in_use_serial_revision_made_by_calibrations",
        ),
    )
    op.create_index("ix_in_use_lot_id_serial", "in_use", ["lot_id", "serial", "made_at"], unique=False)
    op.create_index("ix_in_use_serial", "in_use", ["serial"], unique=False)
    forbid_changes("in_use")
    op.add_column("refusals", sa.Column("work_sha256", sa.String(length=64), nullable=True))
    op.drop_table("work_items")
    make_table(
        "work_items",
        "id number*, lot_id 64, serial 64, kind 32, work_set 64, input_sha256 64, state 8, "
        "attempts int, owner text?, lease_until time?, changed_at time",
        sa.CheckConstraint("state IN ('queued', 'claimed', 'failed')", name="ck_work_items_state"),
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
    make_table(
        "network_releases",
        "network_id 64*>networks.id, made_at time*, origin 32*, lot_id 64>lots.id, state 16, actor text, reason text",
        sa.CheckConstraint("state IN ('released', 'withdrawn')", name="ck_network_releases_state"),
    )
    forbid_changes("network_releases")
    make_table("line_places", "station 64*, version int, place text")
