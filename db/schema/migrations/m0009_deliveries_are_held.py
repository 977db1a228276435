"""A destination is served by one process at a time."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Add who serves a destination, and until when."""
    op.add_column("deliveries", sa.Column("holder", sa.String(length=128), nullable=True))
    op.add_column("deliveries", sa.Column("held_until", sa.DateTime(timezone=True), nullable=True))
