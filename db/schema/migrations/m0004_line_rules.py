"""The rules of a lot at the line: how its serials look, how many units are planned, who may be pressed again."""

import sqlalchemy as sa

from softcal.db.schema.append_only import forbid_changes
from softcal.db.schema.columns import make_table

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Make the table of this step."""
    make_table(
        "line_rules",
        "lot_id 64*>lots.id, version int*, origin 32*, rules text, made_at time, actor text, reason text",
        sa.CheckConstraint("version >= 1", name="ck_line_rules_version"),
    )
    forbid_changes("line_rules")
