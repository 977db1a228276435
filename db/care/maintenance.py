"""Create and upgrade the schema, and check that nothing in a registry was damaged or edited."""

import hashlib
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from sqlalchemy import Connection, insert, inspect, select, text
from sqlalchemy.exc import DBAPIError

from softcal.core.errors import RegistryError
from softcal.db.care import checks
from softcal.db.care.adoption import adopt
from softcal.db.entries import Anchor
from softcal.db.schema import tables
from softcal.db.schema.arrays import ARRAY, ARRAYS, parts_of
from softcal.db.schema.database import Database, schema_of
from softcal.db.schema.tables import AUDITED, blobs, canonical_json, metadata
from softcal.db.truth import history

BLOB_KINDS = (ARRAYS, ARRAY, "document", "job")
KINDS_OF = {"certificates": ("document",)}
"""Kind of the blobs that a table's rows name; all others name arrays."""

MIGRATIONS = Path(__file__).parents[1] / "schema" / "migrations"

IN_USE_IS_STATED = "0007"
"""From this schema on a registry states which map is in use, and the audit trail tells of every person's PIN."""


def migrate(database: Database, to: str = "head") -> str:
    """Bring an empty or older database to the newest schema in one transaction; return its revision.

    Args:
        to: an older revision, for tests of the upgrade itself.
    """
    # Alembic takes half a second to import: only those who migrate pay.
    from alembic.operations import Operations
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory

    scripts = ScriptDirectory(str(MIGRATIONS), version_locations=[str(MIGRATIONS)])
    with database.writing() as connection:
        is_new = "alembic_version" not in inspect(connection).get_table_names()
        version = text("SELECT version_num FROM alembic_version")
        before = None if is_new else connection.execute(version).scalar_one_or_none()
        context = MigrationContext.configure(
            connection,
            opts={"fn": lambda revision, _: scripts._upgrade_revs(to, revision), "transactional_ddl": True},
        )
        with Operations.context(context):
            context.run_migrations()
        info = tables.registry_info
        if connection.execute(select(info.c.value).where(info.c.key == "origin")).first() is None:
            connection.execute(insert(info).values(key="origin", value=uuid.uuid4().hex[:12]))
        if connection.execute(select(info.c.value).where(info.c.key == "origin_sha256")).first() is None:
            origin = connection.execute(select(info.c.value).where(info.c.key == "origin")).scalar_one()
            connection.execute(insert(info).values(key="origin_sha256", value=checks.origin_sha256(origin)))
        if to == "head" and before is not None and before < IN_USE_IS_STATED:
            adopt(database, f"upgraded from schema {before}")
    return str(schema_of(database))


def faults(
    connection: Connection,
    *,
    is_quick: bool = False,
    anchors: Sequence[Anchor] = (),
    on_step: Callable[[str], None] = lambda _: None,
) -> Iterator[str]:
    """Give one line for every page, row, blob, trigger or link of the audit chain that is not what was written.

    Args:
        is_quick: leave out what reads every page and every blob.
        anchors: what was written down of the chains elsewhere.
        on_step: told what is checked next.
    """
    for name, check in _checks(connection, is_quick, anchors):
        on_step(name)
        try:
            # A query that fails ends a transaction of PostgreSQL; the checks after it go on in what is left.
            with connection.begin_nested():
                found = list(check)
            yield from found
        except (ValueError, TypeError, KeyError, RegistryError, DBAPIError) as error:
            # A damaged value may not even be read: that is what was to be found out.
            cause = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
            yield f"{name}: cannot be read: {(str(cause).splitlines() or [type(cause).__name__])[0][:160]}"


def _checks(connection: Connection, is_quick: bool, anchors: Sequence[Anchor]) -> Iterator[tuple[str, Iterator[str]]]:
    info = tables.registry_info.c
    origin = str(connection.execute(select(info.value).where(info.key == "origin")).scalar_one_or_none())
    if not is_quick:
        yield "pages and indices", checks.page_faults(connection)
        yield "tables", checks.schema_faults(connection)
    yield "foreign tables", checks.alien_tables(connection)
    yield "triggers", checks.trigger_faults(connection)
    yield "origin", checks.origin_faults(connection)
    yield "people", checks.people_faults(connection, origin)
    yield "tokens", checks.token_faults(connection)
    for anchor in anchors:
        yield "what was written down elsewhere", checks.anchor_faults(connection, anchor.heads, anchor.where)
    if is_quick:
        yield "rows", checks.count_faults(connection)
        yield "audit trail", checks.newest_faults(connection)
        return
    yield "references", checks.reference_faults(connection)
    yield "audit trail", history.chain_faults(history.rows(connection))
    yield "rows", _row_faults(connection)
    yield "values", checks.form_faults(connection)
    yield "recordings, networks and maps", _blob_faults(connection)


def _row_faults(connection: Connection) -> Iterator[str]:
    # Two registries may have registered the same thing: the row is the one or the other.
    told: dict[tuple[str, str], set[str]] = {}
    for entry in history.rows(connection):
        if entry.entity in AUDITED and entry.after is not None:
            told.setdefault((entry.entity, entry.key), set()).add(hashlib.sha256(entry.after.encode()).hexdigest())
    for name in AUDITED:
        table = metadata.tables[name]
        for row in connection.execute(select(table), execution_options={"yield_per": 1000}).mappings():
            key = canonical_json(history.row_key(table, dict(row)))
            expected = told.pop((name, key), None)
            if expected is None:
                yield f"{name} {key}: was put in without an entry in the audit trail"
            elif expected.isdisjoint(
                hashlib.sha256(form.encode()).hexdigest() for form in history.forms(table, dict(row))
            ):
                yield f"{name} {key}: was changed after it was written"
    for name, key in told:
        yield f"{name} {key}: is in the audit trail but was removed"


def _blob_faults(connection: Connection) -> Iterator[str]:
    stored, parts = dict[str, str](), dict[str, str]()
    for row in connection.execute(select(blobs), execution_options={"yield_per": 50}):
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
        for sha256 in connection.execute(select(table.c.blob_sha256)).scalars():
            if sha256 is not None and sha256 not in stored:
                yield f"blob {sha256[:12]} of {table.name}: is missing"
            elif sha256 is not None and stored[sha256] not in KINDS_OF.get(table.name, (ARRAYS,)):
                yield f"blob {sha256[:12]}: its size or kind was changed"
