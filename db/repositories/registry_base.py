"""Base of all repositories: writers, transactions, and rows with an entry in the audit trail."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime, timedelta
from functools import wraps
from types import FunctionType
from typing import Any, TypeVar

from sqlalchemy import Double, RowMapping, Table, bindparam, insert, select

from softcal.core.errors import NoSuchLot, NoSuchUnit, RegistryDamaged, RegistryError
from softcal.core.messages.reason import reason
from softcal.db.entries import AuditRow
from softcal.db.repositories import history
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database
from softcal.db.schema.tables import AUDITED, audit, in_use, lots, metadata, recordings, refusals, registry_info, units
from softcal.db.schema.transaction_cache import HAS_AUDIT_ROWS

Entry = TypeVar("Entry")
TICK = timedelta(microseconds=1)
SELECT_LOT = select(lots).where(lots.c.id == bindparam("lot"))
SELECT_UNIT = select(units.c.role).where(units.c.lot_id == bindparam("lot"), units.c.serial == bindparam("unit"))
INSERT_AUDIT = insert(audit)
INSERTS = {name: insert(metadata.tables[name]) for name in AUDITED}
NUMBERS = {
    name: [one.name for one in metadata.tables[name].columns if isinstance(one.type, Double)] for name in AUDITED
}
OF_UNITS = frozenset(table.name for table in (recordings, in_use, refusals))
"""Tables whose rows belong to a unit of a lot: of one that was not registered there can be none."""


def utc_now() -> datetime:
    """Return the machine's time in UTC."""
    return datetime.now(UTC)


@dataclass(frozen=True)
class RegistrySettings:
    """Default actor and clock of the writers."""

    actor: str = "softcal"
    clock: Callable[[], datetime] = utc_now


def damage_error(damage: str) -> RegistryDamaged:
    """Return the error for what softcal has never written."""
    return RegistryDamaged(f"{damage}; the registry is damaged; run `softcal registry verify` and go back to a backup")


def _once_more(method: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(method)
    def retried(self: "RegistryBase", *arguments: Any, **options: Any) -> Any:
        return self.database.once_more(lambda: method(self, *arguments, **options))

    return retried


class RegistryBase:
    """A part of an open registry; a public method is tried again when its connection is cut.

    A method is whole transactions. Where it makes several, those that were kept must change nothing the second time.

    Args:
        origin: the name of this registry's chain; None reads it from the database.
    """

    def __init__(self, database: Database, settings: RegistrySettings, origin: str | None = None) -> None:
        self.database = database
        self.settings = settings
        query = select(registry_info.c.value).where(registry_info.c.key == "origin")
        self.origin = str(database.value(query)) if origin is None else origin

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, method in list(vars(cls).items()):
            if isinstance(method, FunctionType) and not name.startswith("_"):
                setattr(cls, name, _once_more(method))

    def _store(
        self,
        table: Table,
        values: Mapping[str, Any],
        action: str,
        actor: str | None,
        reason: str = "",
        before: Mapping[str, object] | None = None,
    ) -> None:
        """Insert one row together with its row in the audit trail."""
        # As databases give them back: a whole number is a float where one belongs, and a zero has no sign.
        numbers = {name: values[name] for name in NUMBERS[table.name] if values.get(name) is not None}
        values = {**values, **{name: float(value) + 0.0 for name, value in numbers.items()}}
        self.database.change(INSERTS[table.name], values)
        if "serial" in values:
            # A revision is numbered through all lots.
            lot_id = "" if table.name == "calibrations" else values["lot_id"]
            self.database.cache.rows.pop((table.name, lot_id, values["serial"]), None)
        key, after = history.row_key(table, values), history.audited_values(table, values)
        self._write_audit_row(action, table.name, key, actor, after=after, before=before, reason=reason)

    def _write_audit_row(
        self,
        action: str,
        entity: str,
        key: tuple[str | int, ...],
        actor: str | None = None,
        *,
        after: Mapping[str, object],
        before: Mapping[str, object] | None = None,
        reason: str = "",
    ) -> None:
        """Write the next row of this registry's chain, in the transaction of its change."""
        heads = self.database.cache.heads
        seq, prev_hash = heads.get(self.origin) or history.head(self.database, self.origin)
        old = None if before is None else canonical_json(history.plain(before))
        header = (self.origin, seq + 1, self.settings.clock(), self._actor(actor), action, entity, canonical_json(key))
        new = canonical_json(history.plain(after))
        row = AuditRow(*header, before=old, after=new, reason=reason, prev_hash=prev_hash, hash="")
        row = replace(row, hash=history.row_hash(row))
        self.database.change(INSERT_AUDIT, vars(row))
        with self.database.writing() as connection:
            connection.info[HAS_AUDIT_ROWS] = True
        heads[self.origin] = row.seq, row.hash

    def _check_row(self, table: Table, row: RowMapping) -> None:
        """Raise `RegistryError` if a row differs from its entry in the audit trail."""
        values = {column.name: row[column.name] for column in table.columns}
        key = canonical_json(history.row_key(table, values))
        query = select(audit.c.after).where(audit.c.entity == table.name, audit.c.key == key)
        audited = self.database.values(query)
        if canonical_json(history.audited_values(table, values)) not in audited:
            raise RegistryError(
                f"{table.name} {key} is not what the audit trail tells of it: it was damaged or changed; run "
                "`softcal registry verify` and go back to a backup"
            )

    def _check_hidden(self, table: Table, keys: Iterable[tuple[str | int, ...]]) -> None:
        """Raise `RegistryError` if an index hides a row that the audit trail contains."""
        audit_keys = [canonical_json(key) for key in keys]
        query = select(audit.c.key).where(audit.c.entity == table.name, audit.c.key.in_(audit_keys)).limit(1)
        hidden = self.database.value(query)
        if hidden is not None:
            raise damage_error(f"{table.name} {hidden} was not found")

    def _actor(self, actor: str | None) -> str:
        return actor or self.settings.actor

    def _after(self, previous: datetime | None) -> datetime:
        """Return the present time, but never before the preceding row, as a clock may have been set back."""
        now = self.settings.clock()
        return now if previous is None else max(now, previous + TICK)

    def _lot_row(self, lot_id: str) -> RowMapping:
        # A chunk of a batch asks for each unit; no lot changes inside a transaction.
        checked = self.database.cache.lots
        if lot_id not in checked:
            row = self.database.row(SELECT_LOT, {"lot": lot_id})
            if row is None:
                ids = self.database.values(select(lots.c.id).order_by(lots.c.id).limit(6))
                raise NoSuchLot(reason("name.no_such_lot", lot=repr(lot_id), known=_some(ids)))
            self._check_row(lots, row)
            checked[lot_id] = row
        return checked[lot_id]

    def _add_unit(self, lot_id: str, serial: str, role: str, actor: str | None) -> None:
        cache = self.database.cache
        if (lot_id, serial) in cache.units:
            return
        if self.database.row(SELECT_UNIT, {"lot": lot_id, "unit": serial}) is None:
            values = {"lot_id": lot_id, "serial": serial, "role": role, "added_at": self.settings.clock()}
            self._store(units, values, "add", actor)
            cache.without_fit.add((lot_id, serial))
            cache.rows.update({(table, lot_id, serial): () for table in OF_UNITS})
        cache.units.add((lot_id, serial))

    @_once_more
    def lots_of(self, serial: str) -> list[str]:
        """Return the lots of a serial."""
        query = select(units.c.lot_id).where(units.c.serial == serial).order_by(units.c.lot_id)
        return self.database.values(query)

    def _require_serial(self, serial: str) -> None:
        if self.database.row(select(units.c.serial).where(units.c.serial == serial).limit(1)) is None:
            serials = self.database.values(select(units.c.serial).distinct().order_by(units.c.serial).limit(6))
            raise NoSuchUnit(reason("name.no_such_serial", serial=repr(serial), known=_some(serials)))


def entry_from_row(kind: type[Entry], row: RowMapping, **others: Any) -> Entry:
    """Return a dataclass from the columns of a row, with further fields."""
    names = (one.name for one in fields(kind) if one.name in row)  # type: ignore[arg-type]
    return kind(**{name: row[name] for name in names} | others)


def _some(names: list[str]) -> str:
    if None in names:
        # No table takes a row without a name.
        raise damage_error("a row without a name was found")
    listed = ", ".join(names[:5]) or "nothing yet"
    return f"{listed}, ..." if len(names) > 5 else listed
