"""Create and upgrade the schema, and check that nothing in a registry was damaged or edited."""

import hashlib
import uuid
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy import Connection, Table, insert, inspect, select, text

from softcal.core.errors import RegistryError
from softcal.db import history, tables
from softcal.db.adoption import adopt
from softcal.db.arrays import ARRAYS, parts_of
from softcal.db.database import Database, schema_of
from softcal.db.tables import AUDITED, blobs, canonical_json, metadata

MIGRATIONS = Path(__file__).with_name("migrations")

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
        before = _known_schema(connection)
        context = MigrationContext.configure(
            connection,
            opts={"fn": lambda revision, _: scripts._upgrade_revs(to, revision), "transactional_ddl": True},
        )
        with Operations.context(context):
            context.run_migrations()
        info = tables.registry_info
        if connection.execute(select(info.c.value).where(info.c.key == "origin")).first() is None:
            connection.execute(insert(info).values(key="origin", value=uuid.uuid4().hex[:12]))
        if to == "head" and before is not None and before < IN_USE_IS_STATED:
            adopt(database, f"upgraded from schema {before}")
    return str(schema_of(database))


def _known_schema(connection: Connection) -> str | None:
    if "alembic_version" not in inspect(connection).get_table_names():
        return None
    found: str | None = connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
    return found


def faults(connection: Connection) -> Iterator[str]:
    """Give one line for every blob, row or link of the audit chain that is not what was written."""
    yield from history.chain_faults(history.rows(connection))
    yield from _row_faults(connection)
    yield from _blob_faults(connection)


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
            elif not _forms(table, dict(row)) & expected:
                yield f"{name} {key}: was changed after it was written"
    for name, key in told:
        yield f"{name} {key}: is in the audit trail but was removed"


def _forms(table: Table, row: dict[str, object]) -> set[str]:
    """Return the hashes under which the audit trail may tell of a row: as it is, or as before later columns came."""
    told = history.told(table, row)
    later = [name for name in tables.LATER_COLUMNS.get(table.name, ()) if told[name] is None]
    older = {name: value for name, value in told.items() if name not in later}
    return {hashlib.sha256(canonical_json(form).encode()).hexdigest() for form in (told, older)}


def _blob_faults(connection: Connection) -> Iterator[str]:
    stored, parts = set(), dict[str, str]()
    for row in connection.execute(select(blobs), execution_options={"yield_per": 50}):
        stored.add(row.sha256)
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
    for table in _tables_with_blobs():
        for sha256 in connection.execute(select(table.c.blob_sha256)).scalars():
            if sha256 is not None and sha256 not in stored:
                yield f"blob {sha256[:12]} of {table.name}: is missing"


def _tables_with_blobs() -> list[Table]:
    return [table for table in metadata.sorted_tables if "blob_sha256" in table.columns]
