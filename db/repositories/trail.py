"""The audit trail: actions with actor, time and reason, read by kind, by entity and from its end."""

from collections.abc import Mapping

from sqlalchemy import ColumnElement, RowMapping, select

from softcal.db.entries import AuditRow, Heads
from softcal.db.repositories import history
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.tables import audit


class AuditTrail(RegistryBase):
    """Repository of the audit trail; other repositories write their entries themselves."""

    def add(
        self,
        action: str,
        entity: str,
        key: tuple[str | int, ...],
        values: Mapping[str, object],
        *,
        reason: str = "",
        actor: str | None = None,
    ) -> None:
        """Write an action that changes no table (an export, an override) into the audit trail."""
        with self.database.writing():
            self._write_audit_row(action, entity, key, actor, after=values, reason=reason)

    def list_rows(self, entity: str, key: tuple[str | int, ...]) -> list[AuditRow]:
        """Return the entries of one entity, in time order."""
        return self._of(audit.c.entity == entity, audit.c.key == canonical_json(key))

    def of_kind(self, entity: str) -> list[AuditRow]:
        """Return the entries of all entities of a kind, in time order."""
        return self._of(audit.c.entity == entity)

    def _of(self, *conditions: ColumnElement[bool]) -> list[AuditRow]:
        query = select(audit).where(*conditions).order_by(audit.c.at, audit.c.origin, audit.c.seq)
        return [AuditRow(**row) for row in self.database.rows(query)]

    def rows(self, origin: str | None = None) -> list[AuditRow]:
        """Return the audit trail of one registry, or of all, oldest first per origin."""
        return list(history.rows(self.database, origin))

    def newest(self, count: int) -> list[AuditRow]:
        """Return the newest rows of the audit trail by any actor, newest first."""
        newest: list[RowMapping] = []
        with self.database.reading():
            # The index finds the newest of each chain; sorted by time, all would be read.
            for origin in history.origins(self.database):
                chain = select(audit).where(audit.c.origin == origin)
                newest += self.database.rows(chain.order_by(audit.c.seq.desc()).limit(count))
        rows = sorted((AuditRow(**row) for row in newest), key=lambda row: (row.at, row.origin, row.seq), reverse=True)
        return rows[:count]

    def heads(self) -> Heads:
        """Return the last row of every chain of the audit trail: what to write down elsewhere."""
        with self.database.reading():
            return history.heads(self.database)
