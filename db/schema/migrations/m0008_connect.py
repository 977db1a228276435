"""Programs sign in with tokens; what is sent elsewhere knows how far it is."""

from alembic import op

from softcal.db.schema.columns import make_table

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Make the tables of this step."""
    make_table(
        "tokens",
        "token_id 32*, sha256 64, account 64>users.name, purpose text, created time, ends_at time, is_withdrawn bool",
    )
    op.create_index("uq_tokens_sha256", "tokens", ["sha256"], unique=True)
    make_table(
        "deliveries",
        "destination 64*, cursor text, delivered big, failures int, not_before time?, error text, changed_at time",
    )
