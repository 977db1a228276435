"""How tables and migrations write their columns: `name type`, one after the other, with commas between them.

A type is a name of `PLAIN`, or a number: a text of so many characters. Behind it stands `*` for a part of the primary
key, `?` where a value may be missing, and `>table.column` for what it refers to.
"""

import re
from collections.abc import Mapping
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Constraint,
    Date,
    DateTime,
    Double,
    ForeignKey,
    Integer,
    LargeBinary,
    PrimaryKeyConstraint,
    String,
    Text,
)

PLAIN: Mapping[str, Any] = {
    "text": Text(),
    "json": Text(),
    "time": DateTime(timezone=True),
    "date": Date(),
    "int": Integer(),
    "big": BigInteger(),
    "number": BigInteger().with_variant(Integer(), "sqlite"),
    "double": Double(),
    "bool": Boolean(),
    "bytes": LargeBinary(),
}
"""Types as a database knows them; `number` counts rows up by itself."""


def columns(page: str, types: Mapping[str, Any] = PLAIN, table: str = "") -> list[Column[Any]]:
    """Return the columns of a page.

    Args:
        table: what they belong to, where no naming convention names what they refer to.
    """
    made = []
    for one in page.split(","):
        name, kind, key, to = re.fullmatch(r"\s*(\w+) (\w+)([*?]?)(?:>(\S+))?\s*", one).groups()  # type: ignore[union-attr]
        named = f"fk_{table}_{name}_{to.split('.')[0]}" if table and to else None
        refers = [ForeignKey(to, name=named)] if to else []
        type_ = String(int(kind)) if kind.isdigit() else types[kind]
        made.append(Column(name, type_, *refers, primary_key=key == "*", nullable=key == "?"))
    return made


def make_table(name: str, page: str, *rest: Constraint) -> None:
    """Make a table in a migration; `rest` are constraints with their names."""
    # Alembic takes half a second to import: only migrations pay.
    from alembic import op

    made = columns(page, table=name)
    keys = PrimaryKeyConstraint(*(column.name for column in made if column.primary_key), name=f"pk_{name}")
    op.create_table(name, *made, *rest, keys)
