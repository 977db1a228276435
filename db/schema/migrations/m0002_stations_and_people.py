"""Stations, adaptations and people: orders with their progress, heartbeats, certificates, golden runs, users."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes

revision = "0002"
down_revision = "0001"

APPEND_ONLY = ("adaptations", "certificates", "golden_runs")


def upgrade() -> None:
    """Make the tables of this step."""
    op.create_table(
        "adaptations",
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("stream", sa.Text(), nullable=False),
        sa.Column("sample", sa.Integer(), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("entry", sa.Text(), nullable=False),
        sa.CheckConstraint("number >= 1", name="ck_adaptations_number"),
        sa.PrimaryKeyConstraint("serial", "number", "origin", name="pk_adaptations"),
    )
    op.create_table(
        "golden_runs",
        sa.Column("station", sa.String(length=64), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("value", sa.Double(), nullable=False),
        sa.Column("unit", sa.Text(), nullable=False),
        sa.Column("passed", sa.Boolean(), nullable=False),
        sa.Column("reasons", sa.Text(), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("recording_sha256", sa.String(length=64), nullable=True),
        sa.PrimaryKeyConstraint("station", "serial", "made_at", "origin", name="pk_golden_runs"),
    )
    op.create_table(
        "heartbeats",
        sa.Column("station", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("reasons", sa.Text(), nullable=False),
        sa.Column("process", sa.Text(), nullable=False),
        sa.Column("order_id", sa.String(length=64), nullable=False),
        sa.PrimaryKeyConstraint("station", name="pk_heartbeats"),
    )
    op.create_table(
        "orders",
        sa.Column("order_id", sa.String(length=64), nullable=False),
        sa.Column("station", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("lot_id", sa.String(length=64), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("created", sa.DateTime(timezone=True), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("phase", sa.Text(), nullable=False),
        sa.Column("fraction", sa.Double(), nullable=False),
        sa.Column("remaining_s", sa.Double(), nullable=False),
        sa.Column("code", sa.Text(), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("recording_sha256", sa.Text(), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="ck_orders_state"),
        sa.PrimaryKeyConstraint("order_id", name="pk_orders"),
    )
    op.create_index("ix_orders_station", "orders", ["station", "created"], unique=False)
    op.create_index(
        "uq_orders_active",
        "orders",
        ["station"],
        unique=True,
        sqlite_where=sa.text("state IN ('queued', 'running') AND kind IN ('source', 'unit', 'golden', 'check')"),
        postgresql_where=sa.text("state IN ('queued', 'running') AND kind IN ('source', 'unit', 'golden', 'check')"),
    )
    op.create_table(
        "users",
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("pin_hash", sa.Text(), nullable=False),
        sa.Column("is_active", sa.Boolean(), nullable=False),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.Column("locked_until", sa.DateTime(timezone=True), nullable=True),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("role IN ('operator', 'engineer', 'quality')", name="ck_users_role"),
        sa.PrimaryKeyConstraint("name", name="pk_users"),
    )
    op.create_table(
        "certificates",
        sa.Column("cell_serial", sa.String(length=64), nullable=False),
        sa.Column("issued_on", sa.Date(), nullable=False),
        sa.Column("origin", sa.String(length=32), nullable=False),
        sa.Column("due_on", sa.Date(), nullable=False),
        sa.Column("number", sa.Text(), nullable=False),
        sa.Column("laboratory", sa.Text(), nullable=False),
        sa.Column("capacity_N", sa.Double(), nullable=False),
        sa.Column("uncertainty_N", sa.Double(), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=True),
        sa.Column("added_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("due_on > issued_on", name="ck_certificates_due_on"),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name="fk_certificates_blob_sha256_blobs"),
        sa.PrimaryKeyConstraint("cell_serial", "issued_on", "origin", name="pk_certificates"),
    )
    op.create_table(
        "run_signals",
        sa.Column("order_id", sa.String(length=64), nullable=False),
        sa.Column("signal", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["order_id"], ["orders.order_id"], name="fk_run_signals_order_id_orders"),
        sa.PrimaryKeyConstraint("order_id", name="pk_run_signals"),
    )
    for table in APPEND_ONLY:
        forbid_changes(table)
