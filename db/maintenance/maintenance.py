"""Creation of the tables; statements of a registry after its restoration."""

import uuid
from pathlib import Path

from sqlalchemy import insert, select

from softcal.db.access.people import person_in_trail
from softcal.db.entries import Heads
from softcal.db.maintenance import checks
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.database import Database, schema_of
from softcal.db.schema.tables import registry_info, users

MIGRATIONS = Path(__file__).parents[1] / "schema" / "migrations"


def migrate(database: Database) -> str:
    """Make the tables of this version in an empty database at once; return the schema revision."""
    # Alembic takes half a second to import: only those who migrate pay.
    from alembic.operations import Operations
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory

    scripts = ScriptDirectory(str(MIGRATIONS), version_locations=[str(MIGRATIONS)])
    with database.writing() as connection:
        steps = {"fn": lambda revision, _: scripts._upgrade_revs("head", revision), "transactional_ddl": True}
        context = MigrationContext.configure(connection, opts=steps)
        with Operations.context(context):
            context.run_migrations()
        # Two processes may have found it empty.
        if database.row(select(registry_info)) is None:
            origin = uuid.uuid4().hex[:12]
            info = {"origin": origin, "origin_sha256": checks.origin_sha256(origin)}
            database.change(insert(registry_info), [{"key": key, "value": value} for key, value in info.items()])
    return str(schema_of(database))


class Adoption(RegistryBase):
    """Record in a registry's own chain what a backup brought into it."""

    def state_restored(self, heads: Heads) -> None:
        """Begin this registry's own chain with the last row of each chain that it continues."""
        with self.database.writing():
            self._write_audit_row("restore", "registry", (self.origin,), after={"heads": heads})
            # `verify` compares every person with what this registry's own chain told last.
            for row in self.database.rows(select(users).order_by(users.c.name)):
                person = person_in_trail(row)
                self._write_audit_row("state", "users", (row["name"],), after=person, reason="restored from a backup")
