"""Jobs: long computations that a page asks for and another process does."""

import sqlalchemy as sa
from alembic import op

from softcal.db.schema.columns import make_table

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Make the tables of this step."""
    make_table(
        "jobs",
        "job_id 32*, kind 32, request text, actor text, created time, state 16, fraction double, "
        "message text, trace text, result text, blob_sha256 64?>blobs.sha256, "
        "is_cancel_wanted bool, beaten_at time",
        sa.CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="ck_jobs_state"),
    )
    op.create_index("ix_jobs_kind", "jobs", ["kind", "created"], unique=False)
