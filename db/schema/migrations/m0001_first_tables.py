"""The first tables: lots, units, recordings, networks, calibrations, limits, work items and the audit trail."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes

revision = "0001"
down_revision = None

APPEND_ONLY = ("audit", "blobs", "calibrations", "limits", "lots", "networks", "recordings", "refusals", "units")


def upgrade() -> None:
    """Make the tables of this step."""
    op.create_table(
        "audit",
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("seq", sa.Integer(), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("action", sa.String(length=32), nullable=False),
        sa.Column("entity", sa.String(length=32), nullable=False),
        sa.Column("key", sa.Text(), nullable=False),
        sa.Column("before", sa.Text(), nullable=True),
        sa.Column("after", sa.Text(), nullable=True),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("prev_hash", sa.String(length=64), nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.PrimaryKeyConstraint("origin", "seq", name="pk_audit"),
    )
    op.create_index("ix_audit_entity_key", "audit", ["entity", "key"], unique=False)
    op.create_table(
        "blobs",
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("size", sa.Integer(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("sha256", name="pk_blobs"),
    )
    op.create_table(
        "lots",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("source", sa.String(length=64), nullable=False),
        sa.Column("sample_rate_Hz", sa.Double(), nullable=False),
        sa.Column("sensor_model", sa.Text(), nullable=False),
        sa.Column("reference_quantity", sa.Text(), nullable=False),
        sa.Column("reference_unit", sa.Text(), nullable=False),
        sa.Column("output_unit", sa.Text(), nullable=False),
        sa.Column("added_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_lots"),
    )
    op.create_table(
        "registry_info",
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("value", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("key", name="pk_registry_info"),
    )
    op.create_table(
        "work_items",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
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
    op.create_index("ix_work_items_lot_id_state", "work_items", ["lot_id", "state", "id"], unique=False)
    op.create_index("uq_work_items_item", "work_items", ["lot_id", "kind", "serial", "input_sha256"], unique=True)
    op.create_table(
        "limits",
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("rmse", sa.Double(), nullable=True),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.CheckConstraint("version >= 1", name="ck_limits_version"),
        sa.ForeignKeyConstraint(["lot_id"], ["lots.id"], name="fk_limits_lot_id_lots"),
        sa.PrimaryKeyConstraint("lot_id", "version", "origin", name="pk_limits"),
    )
    op.create_table(
        "networks",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("input_sha256", sa.String(length=64), nullable=False),
        sa.Column("settings", sa.Text(), nullable=False),
        sa.Column("training", sa.Text(), nullable=False),
        sa.Column("metrics", sa.Text(), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        sa.Column("added_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name="fk_networks_blob_sha256_blobs"),
        sa.ForeignKeyConstraint(["lot_id"], ["lots.id"], name="fk_networks_lot_id_lots"),
        sa.PrimaryKeyConstraint("id", name="pk_networks"),
    )
    op.create_index("ix_networks_input_sha256", "networks", ["input_sha256"], unique=False)
    op.create_table(
        "units",
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("role", sa.String(length=8), nullable=False),
        sa.Column("added_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("role IN ('source', 'target')", name="ck_units_role"),
        sa.ForeignKeyConstraint(["lot_id"], ["lots.id"], name="fk_units_lot_id_lots"),
        sa.PrimaryKeyConstraint("lot_id", "serial", name="pk_units"),
    )
    op.create_index("ix_units_serial", "units", ["serial"], unique=False)
    op.create_table(
        "calibrations",
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("rolled_back_to", sa.Integer(), nullable=True),
        sa.Column("network_id", sa.String(length=64), nullable=False),
        sa.Column("family", sa.Text(), nullable=False),
        sa.Column("map_sha256", sa.String(length=64), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        sa.Column("settings", sa.Text(), nullable=False),
        sa.Column("predicted_rmse", sa.Double(), nullable=True),
        sa.Column("before_rmse", sa.Double(), nullable=True),
        sa.Column("after_rmse", sa.Double(), nullable=True),
        sa.Column("own_rmse", sa.Double(), nullable=True),
        sa.Column("fit_s", sa.Double(), nullable=True),
        sa.Column("verdict", sa.String(length=16), nullable=False),
        sa.Column("reasons", sa.Text(), nullable=False),
        sa.Column("evidence", sa.Text(), nullable=False),
        sa.Column("input_sha256", sa.String(length=64), nullable=False),
        sa.Column("recording_sha256", sa.String(length=64), nullable=False),
        sa.CheckConstraint("verdict IN ('pass', 'conditional', 'fail', 'retest')", name="ck_calibrations_verdict"),
        sa.CheckConstraint("revision >= 1", name="ck_calibrations_revision"),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name="fk_calibrations_blob_sha256_blobs"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_calibrations_lot_id_serial_units"
        ),
        sa.ForeignKeyConstraint(["network_id"], ["networks.id"], name="fk_calibrations_network_id_networks"),
        sa.PrimaryKeyConstraint("serial", "revision", "origin", name="pk_calibrations"),
    )
    op.create_index("ix_calibrations_lot_id_serial", "calibrations", ["lot_id", "serial", "made_at"], unique=False)
    op.create_index("ix_calibrations_serial_input", "calibrations", ["serial", "input_sha256"], unique=False)
    op.create_table(
        "recordings",
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=8), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("samples", sa.Integer(), nullable=False),
        sa.Column("sample_rate_Hz", sa.Double(), nullable=False),
        sa.Column("output_unit", sa.Text(), nullable=False),
        sa.Column("reference_unit", sa.Text(), nullable=True),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        sa.Column("added_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("kind IN ('source', 'unit', 'audit')", name="ck_recordings_kind"),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name="fk_recordings_blob_sha256_blobs"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_recordings_lot_id_serial_units"
        ),
        sa.PrimaryKeyConstraint("sha256", "lot_id", "kind", name="pk_recordings"),
    )
    op.create_index("ix_recordings_lot_id_serial", "recordings", ["lot_id", "serial"], unique=False)
    op.create_table(
        "refusals",
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("verdict", sa.String(length=16), nullable=False),
        sa.Column("reasons", sa.Text(), nullable=False),
        sa.CheckConstraint("verdict IN ('fail', 'retest')", name="ck_refusals_verdict"),
        sa.ForeignKeyConstraint(
            ["lot_id", "serial"], ["units.lot_id", "units.serial"], name="fk_refusals_lot_id_serial_units"
        ),
        sa.PrimaryKeyConstraint("lot_id", "serial", "made_at", "origin", name="pk_refusals"),
    )
    for table in APPEND_ONLY:
        forbid_changes(table)
