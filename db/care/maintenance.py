"""Create and upgrade the schema; what a registry states anew once upgraded or restored."""

import uuid
from pathlib import Path

from sqlalchemy import and_, func, insert, inspect, select, text

from softcal.db.access.people import people_as_told
from softcal.db.care import checks
from softcal.db.entries import Heads
from softcal.db.schema import tables
from softcal.db.schema.database import Database, schema_of
from softcal.db.schema.tables import calibrations, in_use, network_releases, networks, users
from softcal.db.truth.in_use import NEWEST_FIRST, InUseTable
from softcal.db.truth.registry_base import RegistrySettings

MIGRATIONS = Path(__file__).parents[1] / "schema" / "migrations"

IN_USE_IS_STATED = "0007"
"""From this schema on a registry states which map is in use, and the trail tells of every PIN."""


def migrate(database: Database, to: str = "head") -> str:
    """Bring an empty or older database up to a schema (`to`, for tests: an older one) at once; return its revision."""
    # Alembic takes half a second to import: only those who migrate pay.
    from alembic.operations import Operations
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory

    scripts = ScriptDirectory(str(MIGRATIONS), version_locations=[str(MIGRATIONS)])
    with database.writing() as connection:
        is_new = "alembic_version" not in inspect(connection).get_table_names()
        version = text("SELECT version_num FROM alembic_version")
        before = None if is_new else database.value(version)
        context = MigrationContext.configure(
            connection, opts={"fn": lambda revision, _: scripts._upgrade_revs(to, revision), "transactional_ddl": True}
        )
        with Operations.context(context):
            context.run_migrations()
        info = tables.registry_info
        if database.row(select(info.c.value).where(info.c.key == "origin")) is None:
            database.change(insert(info).values(key="origin", value=uuid.uuid4().hex[:12]))
        if database.row(select(info.c.value).where(info.c.key == "origin_sha256")) is None:
            origin = database.value(select(info.c.value).where(info.c.key == "origin"))
            database.change(insert(info).values(key="origin_sha256", value=checks.origin_sha256(origin)))
        if to == "head" and before is not None and before < IN_USE_IS_STATED:
            reason = f"upgraded from schema {before}"
            adoption = Adoption(database, RegistrySettings())
            adoption.state_maps(reason)
            adoption.state_networks(reason)
            adoption.state_people(reason)
    return str(schema_of(database))


class Adoption(InUseTable):
    """States in a registry's own chain what came from elsewhere or from an older schema."""

    def state_maps(self, reason: str) -> None:
        """State that the newest calibration of every other unit is in use: the rule until then."""
        c, u = calibrations.c, in_use.c
        rank = func.row_number().over(partition_by=(c.lot_id, c.serial), order_by=NEWEST_FIRST).label("rank")
        is_stated = select(u.number).where(and_(u.lot_id == c.lot_id, u.serial == c.serial)).exists()
        columns = (c.lot_id, c.serial, c.revision, c.origin.label("made_by"), c.input_sha256, c.made_at, c.actor, rank)
        ranked = select(*columns).where(~is_stated).subquery()
        with self.database.writing():
            for row in self.database.rows(select(ranked).where(ranked.c.rank == 1)):
                content = {"decided_by": "upgrade", "input_sha256": row["input_sha256"]}
                self._state(row["lot_id"], row["serial"], dict(row), content, row["actor"], reason, row["made_at"])

    def state_networks(self, reason: str) -> None:
        """State that networks from before releases were known stay released."""
        n, r = networks.c, network_releases.c
        is_decided = select(r.network_id).where(r.network_id == n.id).exists()
        with self.database.writing():
            for row in self.database.rows(select(networks).where(~is_decided).order_by(n.added_at, n.id)):
                values = {"network_id": row["id"], "made_at": row["added_at"], "origin": self.origin}
                content = {"lot_id": row["lot_id"], "state": "released", "actor": "softcal", "reason": reason}
                self._store(network_releases, values | content, "release", "softcal", reason)

    def state_restored(self, heads: Heads) -> None:
        """Begin this registry's own chain with the last row of each chain it comes from."""
        with self.database.writing():
            self._tell("restore", "registry", (self.origin,), after={"heads": heads})
        self.state_people("restored from a backup")

    def state_people(self, reason: str) -> None:
        """Tell of every person in this registry's own chain, so that `verify` can compare."""
        with self.database.writing():
            for row in self.database.rows(select(users).order_by(users.c.name)):
                self._tell("state", "users", (row["name"],), after=people_as_told(row), reason=reason)
