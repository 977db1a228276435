"""Schema 1: the tables of `tables.py`, frozen in this module once a second schema exists."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.append_only import forbid_changes
from softcal.db.schema.tables import APPEND_ONLY, metadata

revision = "1"
down_revision = None


def upgrade() -> None:
    """Make every table of an empty database, with its indices and triggers."""
    metadata.create_all(op.get_bind())
    active = sa.text("state IN ('queued', 'running') AND kind IN ('source', 'unit', 'golden', 'check')")
    op.drop_index("uq_orders_active", "orders")
    op.create_index(
        "uq_orders_active", "orders", ["station"], unique=True, sqlite_where=active, postgresql_where=active
    )
    for table in APPEND_ONLY:
        forbid_changes(table)
