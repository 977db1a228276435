"""Stations tell the verdict of what they pressed, and everything their gate looked at."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the columns of this step."""
    op.add_column("orders", sa.Column("verdict", sa.Text(), nullable=False, server_default=""))
    op.add_column("heartbeats", sa.Column("gate", sa.Text(), nullable=False, server_default="[]"))
    op.add_column("heartbeats", sa.Column("is_overridden", sa.Boolean(), nullable=False, server_default=sa.false()))
