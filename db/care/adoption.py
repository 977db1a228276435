"""What a registry states anew when it was upgraded or restored: maps and networks in use, and who may do what."""

from collections.abc import Mapping, Sequence

from sqlalchemy import and_, func, select

from softcal.db.access.people import people_as_told
from softcal.db.schema.database import Database
from softcal.db.schema.tables import calibrations, in_use, network_releases, networks, users
from softcal.db.truth.in_use import NEWEST_FIRST, InUseTable
from softcal.db.truth.registry_base import RegistrySettings


class Adoption(InUseTable):
    """Writes statements of a registry's own about rows that came from elsewhere or from an older schema."""

    def state_maps(self, reason: str) -> None:
        """State for every unit without a statement that its newest calibration is in use: the rule until then."""
        c, u = calibrations.c, in_use.c
        rank = func.row_number().over(partition_by=(c.lot_id, c.serial), order_by=NEWEST_FIRST).label("rank")
        is_stated = select(u.number).where(and_(u.lot_id == c.lot_id, u.serial == c.serial)).exists()
        columns = (c.lot_id, c.serial, c.revision, c.origin.label("made_by"), c.input_sha256, c.made_at, c.actor, rank)
        ranked = select(*columns).where(~is_stated).subquery()
        with self.database.writing() as connection:
            for row in self.database.rows(select(ranked).where(ranked.c.rank == 1)):
                told = {"decided_by": "upgrade", "input_sha256": row["input_sha256"]}
                self._state(
                    connection, row["lot_id"], row["serial"], dict(row), told, row["actor"], reason, row["made_at"]
                )

    def state_networks(self, reason: str) -> None:
        """State that the networks from before releases were known stay released, since when they were trained."""
        n, r = networks.c, network_releases.c
        is_decided = select(r.network_id).where(r.network_id == n.id).exists()
        with self.database.writing() as connection:
            for row in self.database.rows(select(networks).where(~is_decided).order_by(n.added_at, n.id)):
                values = {"network_id": row["id"], "made_at": row["added_at"], "origin": self.origin}
                told = {"lot_id": row["lot_id"], "state": "released", "actor": "softcal", "reason": reason}
                self._store(connection, network_releases, values | told, "release", "softcal", reason)

    def state_restored(self, heads: Mapping[str, Sequence[object]]) -> None:
        """Begin this registry's own chain with where it comes from: each chain's last row at that moment."""
        with self.database.writing() as connection:
            self._tell(connection, "restore", "registry", (self.origin,), after={"heads": heads})
        self.state_people("restored from a backup")

    def state_people(self, reason: str) -> None:
        """Tell of every person in this registry's own chain, so that `verify` can compare."""
        with self.database.writing() as connection:
            for row in self.database.rows(select(users).order_by(users.c.name)):
                self._tell(connection, "state", "users", (row["name"],), after=people_as_told(row), reason=reason)


def adopt(database: Database, reason: str) -> None:
    """Write what an upgraded or restored registry has to state."""
    adoption = Adoption(database, RegistrySettings())
    adoption.state_maps(reason)
    adoption.state_networks(reason)
    adoption.state_people(reason)
