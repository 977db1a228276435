"""The audit trail: append-only rows chained by hashes, one chain per registry that wrote them.

hash = SHA-256 of the canonical JSON of every field and of the hash before it, so that a row that was edited, removed
or put in between is found (after Schneier and Kelsey 1999, Secure audit logs, section 3).
"""

import hashlib
from collections.abc import Iterator, Mapping
from datetime import date, datetime

from sqlalchemy import Select, Table, bindparam, func, select

from softcal.core.errors import RegistryError
from softcal.db.entries import AuditRow, Heads
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database
from softcal.db.schema.tables import HASHED_COLUMNS, audit

FIRST_HASH = "0" * 64
Values = Mapping[str, object]
NEWEST = (
    select(audit.c.seq, audit.c.hash).where(audit.c.origin == bindparam("chain")).order_by(audit.c.seq.desc()).limit(1)
)
"""Built once, as every write needs it: building a statement takes longer than running it."""


def _select_origins() -> Select[tuple[str]]:
    # One look into the index per registry; DISTINCT would read the whole trail.
    first = select(func.min(audit.c.origin).label("origin")).cte("chain", recursive=True)
    following = select(func.min(audit.c.origin)).where(audit.c.origin > first.c.origin).scalar_subquery()
    chain = first.union_all(select(following).where(first.c.origin.is_not(None)))
    return select(chain.c.origin).where(chain.c.origin.is_not(None))


ORIGINS = _select_origins()


def row_hash(row: AuditRow) -> str:
    """Return the hash a row must have."""
    fields = {name: value for name, value in vars(row).items() if name != "hash"}
    return hashlib.sha256(canonical_json(plain(fields)).encode()).hexdigest()


def origins(database: Database) -> list[str]:
    """Return the registries whose chains are here."""
    return database.values(ORIGINS)


def rows(
    database: Database, origin: str | None = None, after_seq: int = 0, count: int | None = None
) -> Iterator[AuditRow]:
    """Yield the rows of one chain, or of all chains one after another, oldest first."""
    query = select(audit).where(audit.c.seq > after_seq).order_by(audit.c.origin, audit.c.seq).limit(count)
    if origin is not None:
        query = query.where(audit.c.origin == origin)
    for row in database.stream(query):
        yield AuditRow(**row)


def chain_faults(trail: Iterator[AuditRow], after_seq: int = 0, after_hash: str = FIRST_HASH) -> Iterator[str]:
    """Yield one line for every row that breaks its chain, behind the row `after_seq`, `after_hash`."""
    origin, seq, prev_hash = "", after_seq, after_hash
    for row in trail:
        if row.origin != origin:
            origin, seq, prev_hash = row.origin, after_seq, after_hash
        if row.seq != seq + 1:
            yield f"audit {origin}: rows {seq + 1} to {row.seq - 1} are missing"
        elif row.prev_hash != prev_hash:
            yield f"audit {origin} row {row.seq}: does not follow row {seq}"
        if row.hash != row_hash(row):
            yield f"audit {origin} row {row.seq}: was changed after it was written"
        seq, prev_hash = row.seq, row.hash


def head(database: Database, origin: str) -> tuple[int, str]:
    """Return number and hash of the newest row of a chain."""
    newest = database.row(NEWEST, {"chain": origin})
    return (0, FIRST_HASH) if newest is None else (newest.seq, newest.hash)


def heads(database: Database) -> Heads:
    """Return number and hash of the newest row of every chain."""
    return {origin: head(database, origin) for origin in origins(database)}


def row_key(table: Table, values: Values) -> tuple[str | int, ...]:
    """Return the primary key of a row in the notation of the audit trail."""
    key = [_plain(values[column.name]) for column in table.primary_key]
    return tuple(part if isinstance(part, int) else str(part) for part in key)


def audited_values(table: Table, values: Values) -> dict[str, object]:
    """Return a row in the notation of the audit trail."""
    hashed = HASHED_COLUMNS.get(table.name, ())
    return {
        name: hashlib.sha256(canonical_json(value).encode()).hexdigest() if name in hashed else value
        for name, value in plain(values).items()
    }


def plain(values: Values) -> dict[str, object]:
    """Return JSON values: instants and days as ISO text, other values unchanged."""
    return {name: _plain(value) for name, value in values.items()}


def _plain(value: object) -> object:
    if isinstance(value, datetime):
        return value.isoformat(timespec="microseconds")
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, bytes):
        raise RegistryError("bytes belong into a blob, not into the audit trail")
    return value
