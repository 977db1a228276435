"""Declarations of people and files about lots, units and stations: the newest row of a key is in force."""

from collections.abc import Collection, Mapping
from typing import Any

from sqlalchemy import RowMapping, Table, select

from softcal.core.quality.audit_plan import AuditConfig, AuditPlan
from softcal.db.entries import Draw
from softcal.db.repositories.history import plain
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import equality_conditions, parts
from softcal.db.schema.tables import LISTS, drawn_units, draws, metadata

WRITE_COLUMNS = {"made_at", "origin", "actor", "reason"}


class DeclarationTables(RegistryBase):
    """Declarations of every kind, and the draws of samples."""

    def declare(
        self,
        name: str,
        *rows: Mapping[str, Any],
        action: str = "declare",
        actor: str | None = None,
        reason: str = "",
    ) -> int:
        """Store the rows of one owner that change a declaration, all or none; return how many.

        The list of a declaration stands under `listed`, one row per entry.
        """
        if not rows:
            return 0
        table = metadata.tables[name]
        owner = rows[0][next(iter(table.c)).name]
        serials = {row["serial"] for row in rows} if "serial" in rows[0] else None
        with self.database.writing():
            before = {_key(table, row): row for row in self.in_force(name, owner, serials)}
            new = [row for row in rows if _values(before.get(_key(table, row), {})) != _values(row)]
            for row in new:
                newest = before.get(_key(table, row), {})
                write_values = {"made_at": self._after(newest.get("made_at")), "origin": self.origin}
                write_values |= {"actor": self._actor(actor), "reason": reason}
                values = {**row, **write_values}
                listed = values.pop("listed", [])
                self._store(table, values, action, actor, reason)
                key = {column.name: values[column.name] for column in table.primary_key}
                for one in listed:
                    self._store(LISTS[name], {**key, **one}, action, actor, reason)
            return len(new)

    def in_force(
        self, name: str, owner: str | None = None, serials: Collection[str] | None = None
    ) -> list[dict[str, Any]]:
        """Return the newest row of each key, in time order: of one lot or station, of some of its units, or of all."""
        table, rows = metadata.tables[name], list[dict[str, Any]]()
        of_owner = select(table).where(*equality_conditions((next(iter(table.c)), owner)))
        with self.database.reading():
            for part in [None] if serials is None else parts(sorted(serials)):
                query = of_owner if part is None else of_owner.where(table.c.serial.in_(part))
                rows += map(dict, self.database.rows(query))
        rows.sort(key=lambda row: (row["made_at"], row["origin"]))
        newest = {_key(table, row): row for row in rows}
        rows = [row for row in rows if newest[_key(table, row)] is row]
        if name not in LISTS:
            return rows
        listed = self._listed(name, owner, serials)
        return [row | {"listed": listed.get(tuple(row[one.name] for one in table.primary_key), [])} for row in rows]

    def _listed(
        self, name: str, owner: str | None, serials: Collection[str] | None
    ) -> Mapping[tuple[Any, ...], list[dict[str, Any]]]:
        """Return what declarations of a kind list, by the key of each."""
        table, above = LISTS[name], [column.name for column in metadata.tables[name].primary_key]
        of_owner = select(table).where(*equality_conditions((next(iter(table.c)), owner))).order_by(*table.primary_key)
        listed: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
        for part in [None] if serials is None or "serial" not in above else parts(sorted(serials)):
            query = of_owner if part is None else of_owner.where(table.c.serial.in_(part))
            for row in self.database.rows(query):
                values = {column: value for column, value in row.items() if column not in above}
                listed.setdefault(tuple(row[column] for column in above), []).append(values)
        return listed

    def newest(self, name: str, owner: str) -> dict[str, Any] | None:
        """Return the declaration in force of one lot or station, or None."""
        return next(iter(self.in_force(name, owner)), None)

    def add_draw(
        self,
        lot_id: str,
        plan: AuditPlan,
        forecasts: Mapping[str, float],
        config: AuditConfig,
        *,
        actor: str | None = None,
        reason: str = "",
    ) -> None:
        """Store a draw with its units, and the forecasts of these; its time is the registry's."""
        newest = self.newest("draws", lot_id) or {}
        with self.database.writing():
            key = {"lot_id": lot_id, "made_at": self._after(newest.get("made_at")), "origin": self.origin}
            values: dict[str, Any] = {"population": plan.population, "allowed_share": plan.allowed_share}
            values |= {"seed": config.seed}
            write_values = {"actor": self._actor(actor), "reason": reason}
            self._store(draws, {**key, **write_values, **values}, "draw", actor, reason)
            for serial in plan.serials:
                unit = {"serial": serial, "is_random": serial in plan.random, "predicted_rmse": forecasts[serial]}
                self._store(drawn_units, {**key, **unit}, "draw", actor, reason)

    def draws(self, lot_id: str) -> list[Draw]:
        """Return every draw of a lot, oldest first."""
        with self.database.reading():
            query = select(draws).where(draws.c.lot_id == lot_id).order_by(draws.c.made_at, draws.c.origin)
            units = self.database.rows(select(drawn_units).where(drawn_units.c.lot_id == lot_id))
            return [_draw(row, units) for row in self.database.rows(query)]


def _draw(row: RowMapping, units: Collection[RowMapping]) -> Draw:
    sampled = [one for one in units if (one["made_at"], one["origin"]) == (row["made_at"], row["origin"])]
    doubtful = sorted((-one["predicted_rmse"], one["serial"]) for one in sampled if not one["is_random"])
    random = tuple(sorted(one["serial"] for one in sampled if one["is_random"]))
    plan = AuditPlan(tuple(serial for _, serial in doubtful), random, row["population"], row["allowed_share"])
    forecasts = {one["serial"]: one["predicted_rmse"] for one in sampled}
    return Draw(row["lot_id"], plan, forecasts, row["made_at"])


def _key(table: Table, row: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(row[column.name] for column in table.primary_key if column.name not in WRITE_COLUMNS)


def _values(row: Mapping[str, Any]) -> str:
    return canonical_json(plain({name: value for name, value in row.items() if name not in WRITE_COLUMNS}))
