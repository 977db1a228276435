"""Lots, their units, and versions of limits and rules with actor, time and reason."""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import RowMapping, Table, select

from softcal.core.errors import ChangedMeanwhile, InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import Reason
from softcal.core.quality.known_loads import MAX_LOADS, KnownLoad
from softcal.core.quality.line_rules import RETESTS, LineRules, rules_for
from softcal.db.entries import LimitEntry, LineRulesEntry, RunEntry, UnitEntry
from softcal.db.repositories.in_use import newest_limit
from softcal.db.repositories.lot_pages import units_with_status
from softcal.db.repositories.registry_base import RegistryBase, entry_from_row
from softcal.db.schema.database import equality_conditions
from softcal.db.schema.tables import calibrations, limits, line_rules, lots, refusals, units

DECLARED_WITH_LOT = "stated with the lot"
"""The reason of a version of the limit that came with `lot.toml`."""

PLAIN_RULES = ("serial_pattern", "letters", "target", "is_badge_needed")
"""Rules of a line that are a column each."""


class LotTables(RegistryBase):
    """Lots and their units, limits and rules."""

    def add(self, lot: Lot, *, actor: str | None = None) -> None:
        """Register a lot and its source unit; another limit than the lot stated before adds a version.

        `InputError`: a lot of this id with other facts is registered.
        """
        fields = {name: value for name, value in lot.settings().items() if name != "limit_rmse"}
        with self.database.writing():
            stored = self.database.row(select(lots).where(lots.c.id == lot.id))
            if stored is None:
                values = {"id": lot.id, **fields, "added_at": self.settings.clock()}
                self._store(lots, values, "add", actor)
            elif (name := next((name for name, value in fields.items() if stored[name] != value), None)) is not None:
                raise InputError(
                    f"lot {lot.id!r} is registered with {name} = {stored[name]!r}, now it is {fields[name]!r}; "
                    "correct lot.toml, or give the new lot an id of its own"
                )
            self._add_unit(lot.id, lot.source, "source", actor)
            versions = self.limit_versions(lot.id)
            declared = [entry.rmse for entry in versions if entry.reason == DECLARED_WITH_LOT]
            # A lot that was read from the registry states the limit in force; that is no new one.
            stored_limits = (declared[-1] if declared else None, versions[-1].rmse if versions else None)
            if lot.limit_rmse not in stored_limits:
                self.set_limit(lot.id, lot.limit_rmse, reason=DECLARED_WITH_LOT, actor=actor)

    def all(self) -> list[Lot]:
        """Return every lot by id, each with its newest limit."""
        with self.database.reading():
            return [self._lot(row) for row in self.database.rows(select(lots).order_by(lots.c.id))]

    def ids(self) -> list[str]:
        return self.database.values(select(lots.c.id).order_by(lots.c.id))

    def get(self, lot_id: str) -> Lot:
        """Return one lot; raise `InputError` with the existing lots if there is none."""
        with self.database.reading():
            return self._lot(self._lot_row(lot_id))

    def units(self, lot_id: str | None = None, serial: str | None = None) -> list[UnitEntry]:
        """Return units with their newest result, of a lot, of a serial, or all (`InputError`: unknown lot)."""
        with self.database.reading():
            if lot_id is not None:
                self._lot_row(lot_id)
            if serial is not None:
                self._require_serial(serial)
            lot_ids = self.ids() if serial is None else self.lots_of(serial)
            in_lots = lot_ids if lot_id is None else [lot_id]
            serials = None if serial is None else [serial]
            return [unit for name in in_lots for unit, _ in units_with_status(self.database, name, serials)]

    def serials(self, lot_id: str, role: str) -> list[str]:
        """Return the serials of a lot's units of one role in order (`InputError`: no such lot)."""
        with self.database.reading():
            self._lot_row(lot_id)
            query = select(units.c.serial).where(units.c.lot_id == lot_id, units.c.role == role)
            return self.database.values(query.order_by(units.c.serial))

    def runs(self, lot_id: str, serial: str | None = None) -> list[RunEntry]:
        """Return every result of a lot's units, or of one of them, in time order.

        One press is one result, with its first forecast and the newest verdict on its recording: an audit of other
        units, or a batch, may decide anew on it, and scales the forecasts of units that nobody measured. The last of a
        unit is as the unit stands now. Rollbacks are left out.
        """
        c, r = calibrations.c, refusals.c
        columns = (c.serial, c.made_at, c.verdict, c.reasons, c.predicted_rmse, c.recording_sha256)
        calibrated = select(*columns).where(
            c.rolled_back_to.is_(None), *equality_conditions((c.lot_id, lot_id), (c.serial, serial))
        )
        refused = select(r.serial, r.made_at, r.verdict, r.reasons)
        refused = refused.where(*equality_conditions((r.lot_id, lot_id), (r.serial, serial)))
        serials = None if serial is None else [serial]
        with self.database.reading():
            self._lot_row(lot_id)
            rows = [dict(row) for query in (calibrated, refused) for row in self.database.rows(query)]
            units = {unit.serial: unit for unit, _ in units_with_status(self.database, lot_id, serials)}
        presses: dict[object, dict[str, Any]] = {}
        for number, row in enumerate(sorted(rows, key=lambda row: (row["made_at"], row["serial"]))):
            press = (row["serial"], row.pop("recording_sha256", number))
            first = presses.get(press, row)
            presses[press] = row | {name: first.get(name) for name in ("made_at", "predicted_rmse")}
        last = {row["serial"]: key for key, row in presses.items()}
        for name, key in last.items():
            if (verdict := units[name].verdict) is not None:
                presses[key] |= {"verdict": verdict, "reasons": units[name].reasons}
        return [RunEntry(**row | {"reasons": tuple(map(Reason.parse, row["reasons"]))}) for row in presses.values()]

    def limit(self, lot_id: str) -> LimitEntry | None:
        """Return the newest version of a lot's limit, or None where none was ever stated."""
        return newest_limit(self.database, lot_id)

    def limit_versions(self, lot_id: str) -> list[LimitEntry]:
        """Return every version of a lot's limit, oldest first."""
        return [entry_from_row(LimitEntry, row) for row in self._versions(limits, lot_id)]

    def set_limit(
        self,
        lot_id: str,
        rmse: float | None,
        *,
        reason: str,
        actor: str | None = None,
        expected_version: int | None = None,
    ) -> LimitEntry:
        """Write the next version of a lot's limit; an equal limit with an equal reason is one version.

        Args:
            rmse: largest acceptable error in the lot's unit; None: the source's own error.
            expected_version: the version it was decided on (0: none yet); None: any.

        Raises:
            InputError: no positive number, no such lot, or not the expected version.
        """
        if rmse is not None and not 0 < rmse < float("inf"):
            raise InputError(f"limit {rmse}; a positive number was expected")
        with self.database.writing():
            newest = self.limit(lot_id)
            if newest and (newest.rmse, newest.reason, newest.actor) == (rmse, reason, self._actor(actor)):
                return newest
            changed = f"the limit of lot {lot_id!r} was changed to {newest and newest.rmse}"
            entry = LimitEntry(
                **self._next_version(lot_id, newest, expected_version, changed, actor, reason), rmse=rmse
            )
            values = {**vars(entry), "origin": self.origin}
            self._store(limits, values, "set_limit", actor, reason, vars(newest) if newest else None)
            return entry

    def line_rules(self, lot: Lot) -> LineRules:
        """Return the line rules in force of a lot, or the default rules."""
        versions = self.line_rules_versions(lot.id)
        return versions[-1].rules if versions else rules_for(lot)

    def line_rules_versions(self, lot_id: str) -> list[LineRulesEntry]:
        """Return every version of a lot's rules, oldest first."""
        rows = self._versions(line_rules, lot_id)
        return [entry_from_row(LineRulesEntry, row, rules=parse_rules(row)) for row in rows]

    def set_line_rules(
        self,
        lot_id: str,
        rules: LineRules,
        *,
        reason: str,
        actor: str | None = None,
        expected_version: int | None = None,
    ) -> LineRulesEntry:
        """Write the next version of a lot's rules, as `set_limit`.

        `InputError`: no reason, no such lot, or not the expected version.
        """
        if not reason.strip():
            raise InputError("a change of the line's rules needs a reason; nothing was changed")
        with self.database.writing():
            newest = next(iter(reversed(self.line_rules_versions(lot_id))), None)
            if newest and (newest.rules, newest.reason, newest.actor) == (rules, reason, self._actor(actor)):
                return newest
            changed = f"the rules of lot {lot_id!r} were changed"
            following = self._next_version(lot_id, newest, expected_version, changed, actor, reason)
            entry = LineRulesEntry(**following, rules=rules)
            values = {**following, **_rule_columns(rules), "origin": self.origin}
            before = {"version": newest.version, **_rule_columns(newest.rules)} if newest else None
            self._store(line_rules, values, "set_rules", actor, reason, before)
            return entry

    def _versions(self, table: Table, lot_id: str) -> Sequence[RowMapping]:
        query = select(table).where(table.c.lot_id == lot_id).order_by(table.c.made_at, table.c.origin)
        return self.database.rows(query)

    def _next_version(
        self,
        lot_id: str,
        newest: LimitEntry | LineRulesEntry | None,
        expected: int | None,
        changed: str,
        actor: str | None,
        reason: str,
    ) -> dict[str, Any]:
        """Return the columns of the version after the newest, which must be the expected version."""
        self._lot_row(lot_id)
        if newest is not None and expected not in (None, newest.version):
            raise ChangedMeanwhile(
                f"{changed} by {newest.actor} at {newest.made_at:%Y-%m-%d %H:%M} UTC; look at version "
                f"{newest.version} and decide again"
            )
        version, before = (newest.version + 1, newest.made_at) if newest else (1, None)
        write_values = {"made_at": self._after(before), "actor": self._actor(actor), "reason": reason}
        return {"lot_id": lot_id, "version": version, **write_values}

    def _lot(self, row: RowMapping) -> Lot:
        newest = self.limit(row["id"])
        fields = {name: value for name, value in row.items() if name not in ("id", "added_at")}
        return Lot.from_settings(row["id"], fields | {"limit_rmse": newest.rmse if newest else None})


def _rule_columns(rules: LineRules) -> dict[str, Any]:
    """Return rules of a line as the columns of their table."""
    values = {name: getattr(rules, name) for name in PLAIN_RULES}
    values |= {f"retests_{verdict}": rules.retests.get(verdict) for verdict in RETESTS}
    loads = [*rules.loads, *[None] * (MAX_LOADS - len(rules.loads))]
    for number, load in enumerate(loads, 1):
        values |= {f"load_{number}": load and load.value, f"load_{number}_expanded": load and load.expanded}
    return values


def parse_rules(row: Mapping[Any, Any]) -> LineRules:
    """Return the rules of `_rule_columns`."""
    retests = {verdict: times for verdict in RETESTS if (times := row[f"retests_{verdict}"]) is not None}
    numbers = [number for number in range(1, MAX_LOADS + 1) if row[f"load_{number}"] is not None]
    loads = tuple(KnownLoad(row[f"load_{number}"], row[f"load_{number}_expanded"]) for number in numbers)
    return LineRules(**{name: row[name] for name in PLAIN_RULES}, retests=retests, loads=loads)
