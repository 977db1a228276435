"""Is a registry whole: pages, references, tables, triggers, rows, blobs, its audit trail."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence

from sqlalchemy import Boolean, Date, and_, func, inspect, select, text, type_coerce
from sqlalchemy.exc import DBAPIError
from sqlalchemy.types import NullType

from softcal.core.errors import RegistryError
from softcal.db.access.people import person_in_trail
from softcal.db.access.tokens import token_in_trail
from softcal.db.entries import Anchor, Heads
from softcal.db.repositories import history
from softcal.db.schema import append_only, tables
from softcal.db.schema.arrays import ARRAY, ARRAYS, parts_of
from softcal.db.schema.column_types import CanonicalJson, UtcTime, canonical_json
from softcal.db.schema.database import Database, first_line, is_denied
from softcal.db.schema.tables import AUDITED, audit, blobs, metadata, registry_info, tokens, users

ROWS_OF_QUICK = 200
MULTIFORM_TYPES = (UtcTime, CanonicalJson, Boolean, Date)
"""Types that a database may keep in more than one form."""

PERSON_ACTIONS = ("set_user", "state")

BLOB_KINDS = (ARRAYS, ARRAY, "document", "job")
KINDS_OF = {"certificates": ("document",)}
"""Kind of the blobs that a table's rows name; all others name arrays."""


def faults(
    database: Database,
    *,
    is_quick: bool = False,
    anchors: Sequence[Anchor] = (),
    on_step: Callable[[str], None] = lambda _: None,
) -> Iterator[str]:
    """Yield one line for every page, row, blob, trigger or link that differs from what softcal wrote.

    `is_quick` leaves out what reads every page and blob; `anchors` were written down of the chains elsewhere.
    """
    origin = str(database.value(select(registry_info.c.value).where(registry_info.c.key == "origin")))
    pages = [("pages and indices", page_faults(database)), ("tables", schema_faults(database))]
    quick_checks = [
        ("foreign tables", alien_tables(database)),
        ("triggers", trigger_faults(database)),
        ("origin", origin_faults(database)),
        ("people", people_faults(database, origin)),
        ("tokens", token_faults(database)),
        *(("what was written down elsewhere", anchor_faults(database, one.heads, one.where)) for one in anchors),
    ]
    newest = [("rows", count_faults(database)), ("audit trail", newest_faults(database))]
    content = [
        ("references", reference_faults(database)),
        ("audit trail", history.chain_faults(history.rows(database))),
        ("rows", _row_faults(database)),
        ("values", form_faults(database)),
        ("recordings, networks and maps", _blob_faults(database)),
    ]
    for name, check in (*quick_checks, *newest) if is_quick else (*pages, *quick_checks, *content):
        on_step(name)
        try:
            # A query that fails ends a transaction of PostgreSQL; later checks go on.
            with database.reading() as connection, connection.begin_nested():
                problems = list(check)
            yield from problems
        except (ValueError, TypeError, KeyError, RegistryError, DBAPIError) as error:
            if is_denied(error):
                raise
            # A damaged value may not even be read: that is what was to be found out.
            yield f"{name}: cannot be read: {first_line(error)[:160]}"


def _row_faults(database: Database) -> Iterator[str]:
    # Two registries may have registered the same thing: the row is the one or the other.
    entries: dict[tuple[str, str], set[str]] = {}
    for entry in history.rows(database):
        if entry.entity in AUDITED and entry.after is not None:
            entries.setdefault((entry.entity, entry.key), set()).add(_sha256(entry.after))
    for name in AUDITED:
        table = metadata.tables[name]
        for row in database.stream(select(table)):
            key = canonical_json(history.row_key(table, dict(row)))
            expected = entries.pop((name, key), None)
            if expected is None:
                yield f"{name} {key}: was put in without an entry in the audit trail"
            elif _sha256(canonical_json(history.audited_values(table, dict(row)))) not in expected:
                yield f"{name} {key}: was changed after it was written"
    for name, key in entries:
        yield f"{name} {key}: is in the audit trail but was removed"


def _blob_faults(database: Database) -> Iterator[str]:
    stored, parts = dict[str, str](), dict[str, str]()
    for row in database.stream(select(blobs), 50):
        stored[row.sha256] = row.kind
        if row.size != len(row.data) or row.kind not in BLOB_KINDS:
            yield f"blob {row.sha256[:12]}: its size or kind was changed"
        if hashlib.sha256(row.data).hexdigest() != row.sha256:
            yield f"blob {row.sha256[:12]}: its bytes were changed"
        elif row.kind == ARRAYS:
            try:
                parts |= dict.fromkeys(parts_of(row.data).values(), row.sha256)
            except RegistryError as error:
                yield f"blob {row.sha256[:12]}: {error}"
    for part, sha256 in parts.items():
        if part not in stored:
            yield f"blob {part[:12]} of blob {sha256[:12]}: is missing"
        elif stored[part] != ARRAY:
            yield f"blob {part[:12]}: its size or kind was changed"
    for table in (table for table in metadata.sorted_tables if "blob_sha256" in table.columns):
        for sha256 in database.values(select(table.c.blob_sha256)):
            if sha256 is not None and sha256 not in stored:
                yield f"blob {sha256[:12]} of {table.name}: is missing"
            elif sha256 is not None and stored[sha256] not in KINDS_OF.get(table.name, (ARRAYS,)):
                yield f"blob {sha256[:12]}: its size or kind was changed"


def page_faults(database: Database) -> Iterator[str]:
    """Yield a line for every damaged page, and every index that disagrees with its table."""
    if database.is_sqlite:
        for line in database.values(text("PRAGMA integrity_check(100)")):
            if line != "ok":
                yield f"database: {line}"
        return
    if database.row(text("SELECT 1 FROM pg_extension WHERE extname = 'amcheck'")) is None:
        return
    indices = text(
        "SELECT c.oid, c.relname FROM pg_index i JOIN pg_class c ON c.oid = i.indexrelid JOIN pg_am a ON a.oid = "
        "c.relam JOIN pg_namespace n ON n.oid = c.relnamespace WHERE a.amname = 'btree' AND n.nspname = 'public'"
    )
    for oid, name in database.tuples(indices):
        try:
            with database.reading() as connection, connection.begin_nested():
                connection.execute(text("SELECT bt_index_check(CAST(:oid AS regclass), true)"), {"oid": oid})
        except DBAPIError as error:
            yield f"index {name}: {str(error.orig).splitlines()[0]}"


def reference_faults(database: Database) -> Iterator[str]:
    """Yield a line for every table with rows that refer to missing rows."""
    for table in metadata.sorted_tables:
        for constraint in table.foreign_key_constraints:
            parent = constraint.referred_table.alias()
            pairs = [(element.parent, parent.c[element.column.name]) for element in constraint.elements]
            parent_row = select(pairs[0][1]).where(*(child == column for child, column in pairs)).correlate(table)
            is_set = and_(*(child.is_not(None) for child, _ in pairs))
            dangling = select(func.count()).select_from(table).where(is_set, ~parent_row.exists())
            if count := database.value(dangling):
                yield f"{table.name}: {count} rows refer to {constraint.referred_table.name} that are not there"


def form_faults(database: Database) -> Iterator[str]:
    """Yield a line for every value in another notation than softcal's, as it sorts differently.

    Python reads times, JSON and truth values in more than one form.
    """
    dialect = database.engine.dialect
    with database.reading() as connection:
        for table in (*(metadata.tables[name] for name in AUDITED), audit, users):
            read = [column for column in table.columns if isinstance(column.type, MULTIFORM_TYPES)]
            if not read:
                continue
            key = list(table.primary_key.columns)
            writers = [column.type.dialect_impl(dialect).bind_processor(dialect) for column in read]
            in_order = {"yield_per": 1000}
            stored = select(*key, *(type_coerce(column, NullType()) for column in read)).order_by(*key)
            values = connection.execute(select(*read).order_by(*key), execution_options=in_order)
            for row, parsed in zip(connection.execute(stored, execution_options=in_order), values, strict=True):
                for column, stored_value, write, value in zip(read, row[len(key) :], writers, parsed, strict=True):
                    if stored_value != (value if write is None else write(value)):
                        row_key = history.row_key(table, {part.name: row[k] for k, part in enumerate(key)})
                        problem = f"{column.name} is not as softcal writes it: {str(stored_value)[:60]!r}"
                        yield f"{table.name} {canonical_json(row_key)}: {problem}"


def schema_faults(database: Database) -> Iterator[str]:
    """Yield a line for every difference of the schema from the migrations."""
    # Alembic takes half a second to import: only the whole check pays.
    from alembic.autogenerate import compare_metadata
    from alembic.runtime.migration import MigrationContext

    with database.reading() as connection:
        differences = compare_metadata(MigrationContext.configure(connection), metadata)
    for difference in differences:
        change = difference if isinstance(difference, tuple) else difference[0]
        yield f"schema: {' '.join(str(part) for part in change[:3])[:160]} is not as this version makes it"


TRIGGERS = {
    "sqlite": "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'",
    "postgresql": "SELECT t.tgname, c.relname || ' ' || p.proname || ' ' || t.tgtype || ' ' || "
    "CAST(t.tgenabled AS text) || ' ' || "
    "md5(regexp_replace(p.prosrc, '\\s+', ' ', 'g')) FROM pg_trigger t JOIN pg_class c ON c.oid = t.tgrelid "
    "JOIN pg_proc p ON p.oid = t.tgfoid JOIN pg_namespace n ON n.oid = c.relnamespace "
    "WHERE NOT t.tgisinternal AND n.nspname = 'public'",
}
"""Names of triggers with what they do, by database."""


def trigger_faults(database: Database) -> Iterator[str]:
    """Yield a line for every table with missing, disabled, or changed triggers."""
    dialect = database.engine.dialect.name
    rows = database.tuples(text(TRIGGERS[dialect]))
    definitions = {name: " ".join(str(definition).split()) for name, definition in rows}
    for table in tables.APPEND_ONLY:
        for name, definition in append_only.triggers_of(table, dialect).items():
            if name not in definitions:
                yield f"trigger {name}: is gone; rows of {table} can be changed"
            elif definitions.pop(name) != definition:
                yield f"trigger {name}: is not the one that was made; rows of {table} can be changed"
    for name in definitions:
        yield f"trigger {name}: was put in; softcal made no such trigger"


def origin_faults(database: Database) -> Iterator[str]:
    """Yield a line if the name under which this registry writes its chain was changed."""
    info = {key: value for key, value in database.tuples(select(registry_info.c.key, registry_info.c.value))}
    if info.get("origin_sha256") != origin_sha256(str(info.get("origin"))):
        yield f"registry_info: origin {info.get('origin')!r} is not the one this registry was made with"
    for key in sorted(info.keys() - {"origin", "origin_sha256"}):
        yield f"registry_info: {key!r} was put in; softcal keeps no such fact"


def origin_sha256(origin: str) -> str:
    """Return the hash stored with the origin, which reveals a change of the origin alone."""
    return _sha256(f"origin {origin}")


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def people_faults(database: Database, origin: str) -> Iterator[str]:
    """Yield a line for every person whose row differs from the last entry in the audit trail."""
    query = select(audit.c.key, audit.c.after).where(audit.c.entity == "users", audit.c.origin == origin)
    query = query.where(audit.c.action.in_(PERSON_ACTIONS)).order_by(audit.c.seq)
    entries = {key: after for key, after in database.tuples(query)}
    rows = database.rows(select(users))
    rows_by_key = {canonical_json((row["name"],)): canonical_json(person_in_trail(row)) for row in rows}
    yield from _trail_faults("users", rows_by_key, entries, "role, PIN or rights")
    for key in entries.keys() - rows_by_key.keys():
        yield f"users {key}: is in the audit trail but was removed"


def token_faults(database: Database) -> Iterator[str]:
    """Yield a line for every token whose row differs from the last entry in the audit trail."""
    query = select(audit.c.key, audit.c.after).where(audit.c.entity == "tokens").order_by(audit.c.at, audit.c.seq)
    entries = {key: after for key, after in database.tuples(query)}
    rows = database.rows(select(tokens))
    rows_by_key = {
        canonical_json((row["token_id"],)): canonical_json(history.plain(token_in_trail(row))) for row in rows
    }
    yield from _trail_faults("tokens", rows_by_key, entries, "account, purpose, end or secret")


def _trail_faults(
    table: str, rows_by_key: Mapping[str, str], audited_values: Mapping[str, str | None], changed: str
) -> Iterator[str]:
    for key, row in rows_by_key.items():
        if audited_values.get(key) is None:
            yield f"{table} {key}: was put in without an entry in the audit trail"
        elif audited_values[key] != row:
            yield f"{table} {key}: {changed} were changed behind the audit trail"


def count_faults(database: Database) -> Iterator[str]:
    """Yield a line for every table with more rows than in the trail, or fewer where one chain covers all."""
    is_alone = len(history.origins(database)) == 1
    query = select(audit.c.entity, func.count()).where(audit.c.entity.in_(AUDITED)).group_by(audit.c.entity)
    counts = {entity: count for entity, count in database.tuples(query)}
    for name in AUDITED:
        rows = database.value(select(func.count()).select_from(metadata.tables[name]))
        if rows > counts.get(name, 0) or (is_alone and rows < counts.get(name, 0)):
            yield f"{name}: {rows} rows, and the audit trail tells of {counts.get(name, 0)}"


def newest_faults(database: Database) -> Iterator[str]:
    """Yield a line for every fault of a chain among its newest rows."""
    for origin in history.origins(database):
        seq, _ = history.head(database, origin)
        first = max(0, seq - ROWS_OF_QUICK)
        rows = list(history.rows(database, origin, first))
        yield from history.chain_faults(iter(rows), first, rows[0].prev_hash if first and rows else history.FIRST_HASH)


def anchor_faults(database: Database, heads: Heads, where: str) -> Iterator[str]:
    """Yield a line for every chain without the row that an anchor recorded as its last."""
    for origin, (seq, sha256) in heads.items():
        stored = database.value(select(audit.c.hash).where(audit.c.origin == origin, audit.c.seq == seq))
        if stored != sha256:
            state = "is gone" if stored is None else "is another one"
            yield f"audit {origin} row {seq}: {state} than was written down {where}; the trail was cut or rewritten"


def alien_tables(database: Database) -> Iterator[str]:
    """Yield a line for every table that softcal did not create, as it may shadow one of softcal's."""
    expected = {table.name for table in metadata.sorted_tables} | {"alembic_version"}
    with database.reading() as connection:
        names = (*inspect(connection).get_table_names(), *inspect(connection).get_view_names())
    for name in names:
        if name not in expected:
            yield f"table {name}: was put in; softcal made no such table"
