"""A recording is found by its output alone, whatever serial it stands under."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """Add the hash of the output; recordings from before have none."""
    op.add_column("recordings", sa.Column("output_sha256", sa.String(length=64), nullable=True))
    op.create_index("ix_recordings_output_sha256", "recordings", ["output_sha256"], unique=False)
