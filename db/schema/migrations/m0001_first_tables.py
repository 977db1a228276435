"""The first tables: lots, units, recordings, networks, calibrations, limits, work items and the audit trail."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes
from softcal.db.schema.columns import make_table

revision = "0001"
down_revision = None

APPEND_ONLY = ("audit", "blobs", "calibrations", "limits", "lots", "networks", "recordings", "refusals", "units")


def upgrade() -> None:
    """Make the tables of this step."""
    make_table(
        "audit",
        "origin 32*, seq int*, at time, actor text, action 32, entity 32, key text, before text?, "
        "after text?, reason text, prev_hash 64, hash 64",
    )
    op.create_index("ix_audit_entity_key", "audit", ["entity", "key"], unique=False)
    make_table("blobs", "sha256 64*, kind 16, size int, data bytes")
    make_table(
        "lots",
        "id 64*, source 64, sample_rate_Hz double, sensor_model text, reference_quantity text, "
        "reference_unit text, output_unit text, added_at time",
    )
    make_table("registry_info", "key 64*, value text")
    make_table(
        "work_items",
        "id int*, lot_id 64, serial 64, kind 32, input_sha256 64, state 8, attempts int, "
        "owner text?, lease_until time?, result text?, error text?, changed_at time",
        sa.CheckConstraint("state IN ('queued', 'claimed', 'done', 'failed')", name="ck_work_items_state"),
    )
    op.create_index("ix_work_items_lot_id_state", "work_items", ["lot_id", "state", "id"], unique=False)
    op.create_index("uq_work_items_item", "work_items", ["lot_id", "kind", "serial", "input_sha256"], unique=True)
    make_table(
        "limits",
        "lot_id 64*>lots.id, version int*, origin 32*, rmse double?, made_at time, actor text, reason text",
        sa.CheckConstraint("version >= 1", name="ck_limits_version"),
    )
    make_table(
        "networks",
        "id 64*, lot_id 64>lots.id, input_sha256 64, settings text, training text, metrics text, "
        "blob_sha256 64>blobs.sha256, added_at time",
    )
    op.create_index("ix_networks_input_sha256", "networks", ["input_sha256"], unique=False)
    make_table(
        "units",
        "lot_id 64*>lots.id, serial 64*, role 8, added_at time",
        sa.CheckConstraint("role IN ('source', 'target')", name="ck_units_role"),
    )
    op.create_index("ix_units_serial", "units", ["serial"], unique=False)
    make_table(
        "calibrations",
        "serial 64*, revision int*, origin 32*, lot_id 64, made_at time, actor text, reason text, "
        "rolled_back_to int?, network_id 64>networks.id, family text, map_sha256 64, "
        "blob_sha256 64>blobs.sha256, settings text, predicted_rmse double?, before_rmse double?, "
        "after_rmse double?, own_rmse double?, fit_s double?, verdict 16, reasons text, "
        "evidence text, input_sha256 64, recording_sha256 64",
        sa.CheckConstraint("verdict IN ('pass', 'conditional', 'fail', 'retest')", name="ck_calibrations_verdict"),
        sa.CheckConstraint("revision >= 1", name="ck_calibrations_revision"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_calibrations_lot_id_serial_units"
        ),
    )
    op.create_index("ix_calibrations_lot_id_serial", "calibrations", ["lot_id", "serial", "made_at"], unique=False)
    op.create_index("ix_calibrations_serial_input", "calibrations", ["serial", "input_sha256"], unique=False)
    make_table(
        "recordings",
        "sha256 64*, lot_id 64*, kind 8*, serial 64, samples int, sample_rate_Hz double, "
        "output_unit text, reference_unit text?, blob_sha256 64>blobs.sha256, added_at time",
        sa.CheckConstraint("kind IN ('source', 'unit', 'audit')", name="ck_recordings_kind"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_recordings_lot_id_serial_units"
        ),
    )
    op.create_index("ix_recordings_lot_id_serial", "recordings", ["lot_id", "serial"], unique=False)
    make_table(
        "refusals",
        "lot_id 64*, serial 64*, made_at time*, origin 32*, actor text, verdict 16, reasons text",
        sa.CheckConstraint("verdict IN ('fail', 'retest')", name="ck_refusals_verdict"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_refusals_lot_id_serial_units"
        ),
    )
    for table in APPEND_ONLY:
        forbid_changes(table)
