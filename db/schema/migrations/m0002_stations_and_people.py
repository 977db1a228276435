"""Stations, adaptations and people: orders with their progress, heartbeats, certificates, golden runs, users."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes
from softcal.db.schema.columns import make_table

revision = "0002"
down_revision = "0001"

APPEND_ONLY = ("adaptations", "certificates", "golden_runs")


def upgrade() -> None:
    """Make the tables of this step."""
    make_table(
        "adaptations",
        "serial 64*, number int*, origin 32*, revision int, stream text, sample int, made_at time, entry text",
        sa.CheckConstraint("number >= 1", name="ck_adaptations_number"),
    )
    make_table(
        "golden_runs",
        "station 64*, serial 64*, made_at time*, origin 32*, value double, unit text, "
        "passed bool, reasons text, actor text, recording_sha256 64?",
    )
    make_table("heartbeats", "station 64*, state 16, at time, reasons text, process text, order_id 64")
    make_table(
        "orders",
        "order_id 64*, station 64, kind 16, serial 64, lot_id 64, actor text, reason text, "
        "created time, state 16, phase text, fraction double, remaining_s double, code text, "
        "message text, recording_sha256 text, changed_at time",
        sa.CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="ck_orders_state"),
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
    make_table(
        "users",
        "name 64*, role 16, pin_hash text, is_active bool, failures int, locked_until time?, "
        "version int, changed_at time",
        sa.CheckConstraint("role IN ('operator', 'engineer', 'quality')", name="ck_users_role"),
    )
    make_table(
        "certificates",
        "cell_serial 64*, issued_on date*, origin 32*, due_on date, number text, laboratory text, "
        "capacity_N double, uncertainty_N double, blob_sha256 64?>blobs.sha256, added_at time",
        sa.CheckConstraint("due_on > issued_on", name="ck_certificates_due_on"),
    )
    make_table("run_signals", "order_id 64*>orders.order_id, signal text")
    for table in APPEND_ONLY:
        forbid_changes(table)
