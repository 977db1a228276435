"""The calibration in use of each unit, as a sequence of statements.

A unit is a serial of a lot. The newest statement holds. Two registries that were apart may both
have made one. Where they name different maps nobody can say which is right, and a person has to.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import RowMapping, and_, bindparam, func, select

from softcal.core.errors import MapsConflict
from softcal.core.messages.reason import Reason, reason
from softcal.db.entries import LimitEntry
from softcal.db.repositories import history
from softcal.db.repositories.registry_base import RegistryBase, damage_error, entry_from_row
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database, equality_conditions, parts
from softcal.db.schema.tables import calibrations, in_use, limits, lots, methods, refusals

NEWEST_STATEMENT = (in_use.c.made_at.desc(), in_use.c.number.desc(), in_use.c.origin.desc())
OF_STATEMENT = and_(
    calibrations.c.serial == in_use.c.serial,
    calibrations.c.revision == in_use.c.revision,
    calibrations.c.origin == in_use.c.made_by,
)
NEWEST_FIRST = (calibrations.c.made_at.desc(), calibrations.c.revision.desc(), calibrations.c.origin.desc())
"""No registry writes a revision older than the one before; the newest need not be in use."""

STALE = (LIMIT_IS_OTHER, LIMIT_IS_WITHDRAWN) = ("stale_limit", "stale_limit_open")
"""Codes of the reasons why a verdict does not stand any more."""


ROW_QUERIES = {
    in_use: select(in_use).where(in_use.c.lot_id == bindparam("lot")).order_by(*NEWEST_STATEMENT),
    refusals: select(refusals.c.serial, refusals.c.made_at)
    .where(refusals.c.lot_id == bindparam("lot"))
    .order_by(refusals.c.made_at.desc()),
    calibrations: select(
        *(calibrations.c[name] for name in ("lot_id", "serial", "revision", "origin", "made_at")),
        *(calibrations.c[name] for name in ("fit_sha256", "state_sha256", "input_sha256")),
    ).order_by(*NEWEST_FIRST),
}
LIMIT_IN_FORCE = (
    select(lots.c.reference_unit, limits.c.rmse)
    .outerjoin_from(lots, limits, limits.c.lot_id == lots.c.id)
    .where(lots.c.id == bindparam("lot"))
    .order_by(limits.c.made_at.desc(), limits.c.origin.desc())
    .limit(1)
)
ROWS_OF_UNIT = {table: query.where(table.c.serial == bindparam("unit")) for table, query in ROW_QUERIES.items()}
"""Built once, for every unit of a batch: to build a statement takes longer than to run it."""


class InUseTable(RegistryBase):
    """The part of the registry that knows which calibration is in use."""

    def put_in_use(
        self,
        lot_id: str,
        serial: str,
        input_sha256: str,
        decided_by: str,
        *,
        work_sha256: str | None = None,
        actor: str | None = None,
    ) -> bool:
        """Put the stored calibration of an input into use again, by batch or line; return False without one.

        What a person decided since the same input stays: nothing new was asked. So does a conflict.

        Args:
            work_sha256: hash of the files and settings that ask.
        """
        c = calibrations.c
        with self.database.writing():
            query = select(calibrations).where(c.lot_id == lot_id, c.serial == serial, c.input_sha256 == input_sha256)
            calibration = self.database.row(query.order_by(*NEWEST_FIRST).limit(1))
            if calibration is None:
                return False
            heads = heads_of(self.database, lot_id, serial)
            if names_several(self.database, heads):
                return True
            statements, refused = (rows_of(self.database, table, lot_id, serial) for table in (in_use, refusals))
            newest_request = next((row for row in statements if row["input_sha256"] is not None), None)
            statement = {"revision": calibration["revision"], "made_by": calibration["origin"]}
            if newest_request is not None and newest_request["input_sha256"] == input_sha256:
                if not refused or refused[0]["made_at"] < newest_request["made_at"]:
                    if work_sha256 in (None, newest_request["work_sha256"]):
                        return True
                    statement = dict(heads[0])
            content = {"work_sha256": work_sha256, "input_sha256": input_sha256, "decided_by": decided_by}
            self._write_statement(lot_id, serial, statement, content, actor, "the same input again")
            return True

    def decided_works(self, lot_id: str, serials: Sequence[str]) -> dict[str, str]:
        """Return the work that each unit's newest result answers, by serial.

        A refusal that may pass (a worker that died, a disk that was away) answers no work.
        """
        newest: dict[str, tuple[datetime, str | None]] = {}
        for part in parts(serials):
            u, r = in_use.c, refusals.c
            requests = select(u.serial, u.made_at, u.work_sha256).where(u.lot_id == lot_id, u.serial.in_(part))
            refused = select(r.serial, r.made_at, r.work_sha256).where(r.lot_id == lot_id, r.serial.in_(part))
            with self.database.reading():
                for query in (requests.where(u.input_sha256.is_not(None)), refused):
                    for serial, made_at, work in self.database.tuples(query):
                        if serial not in newest or made_at > newest[serial][0]:
                            newest[serial] = made_at, work
        return {serial: work for serial, (_, work) in newest.items() if work is not None}

    def inputs_of_works(self, lot_id: str, works: Mapping[str, str]) -> dict[str, str]:
        """Return the input from which each work was once calibrated, by serial."""
        u = in_use.c
        columns = select(u.serial, u.work_sha256, u.input_sha256).where(u.lot_id == lot_id)
        rows = [row for part in parts(list(works)) for row in self.database.rows(columns.where(u.serial.in_(part)))]
        return {row["serial"]: row["input_sha256"] for row in rows if works[row["serial"]] == row["work_sha256"]}

    def was_decided_by(self, decided_by: str, lot_id: str, serial: str) -> bool:
        """Return whether a trim, a release or a rollback ever put a unit's calibration into use."""
        return any(row["decided_by"] == decided_by for row in rows_of(self.database, in_use, lot_id, serial))

    def read_ahead(self, lot_id: str, serials: Sequence[str]) -> None:
        """Read at once what puts calibrations of units of a lot into use, for the rest of a write transaction."""
        for part in parts(serials):
            for table, query in ROW_QUERIES.items():
                rows: dict[str, list[RowMapping]] = {serial: [] for serial in part}
                for row in self.database.rows(query.where(table.c.serial.in_(part)), {"lot": lot_id}):
                    rows[row["serial"]].append(row)
                lot = "" if table is calibrations else lot_id
                self.database.cache.rows.update({(table.name, lot, serial): of for serial, of in rows.items()})

    def passed_once(self, lot_id: str) -> frozenset[str]:
        """Return the serials of a lot for which a calibration that passed was ever in use."""
        query = select(in_use.c.serial).distinct().join(calibrations, OF_STATEMENT)
        query = query.where(in_use.c.lot_id == lot_id, calibrations.c.verdict == "pass")
        return frozenset(self.database.values(query))

    def _in_use(self, lot_id: str, serial: str) -> RowMapping | None:
        """Return the newest statement of a unit, or None before the first.

        `InputError`: two registries put different maps into use. `RegistryError`: the trail tells of one not found.
        """
        heads = heads_of(self.database, lot_id, serial)
        # A damaged index hides rows without a word; the audit trail is found by another one.
        u = in_use.c
        query = select(u.origin, func.max(u.number), func.count()).where(u.lot_id == lot_id, u.serial == serial)
        last = {origin: (number, count) for origin, number, count in self.database.tuples(query.group_by(u.origin))}
        if any(number != count for number, count in last.values()):
            raise damage_error(f"unit {serial} of lot {lot_id}: a statement of what is in use was not found")
        names = sorted({*history.origins(self.database), *last})
        following = [(lot_id, serial, name, last.get(name, (0, 0))[0] + 1) for name in names]
        self._check_hidden(in_use, following)
        for head in heads:
            self._check_row(in_use, head)
        if names_several(self.database, heads):
            raise MapsConflict(conflict_line(self.database, lot_id, serial))
        return heads[0] if heads else None

    def _write_statement(
        self,
        lot_id: str,
        serial: str,
        statement: Mapping[str, Any],
        content: Mapping[str, Any],
        actor: str | None,
        reason: str,
        made_at: datetime | None = None,
    ) -> None:
        """Write a statement behind every statement without a successor, so that no conflict remains.

        `statement` has `revision` and `made_by` of the calibration, `content` the actor and the reason.
        """
        heads = heads_of(self.database, lot_id, serial)
        at = made_at or self._after(newest_of_unit(self.database, lot_id, serial))
        statements = rows_of(self.database, in_use, lot_id, serial)
        number = max((row["number"] for row in statements if row["origin"] == self.origin), default=0)
        for head in (*heads,) or (None,):
            number += 1
            values = {"lot_id": lot_id, "serial": serial, "origin": self.origin, "number": number}
            values |= {name: statement[name] for name in ("revision", "made_by")}
            values |= {"follows_origin": head and head["origin"], "follows_number": head and head["number"]}
            values |= {"work_sha256": None, "input_sha256": None, **content}
            values |= {"made_at": at, "actor": self._actor(actor), "reason": reason}
            before = None if head is None else {name: head[name] for name in ("revision", "made_by")}
            self._store(in_use, values, "put_in_use", actor, reason, before)


def rows_of(database: Database, table: sa.Table, lot_id: str, serial: str) -> Sequence[RowMapping]:
    """Return the statements or refusals of a unit of a lot, or the revisions of a serial in all (lot ""), newest first.

    A transaction has those that were read ahead, and the revisions: these are read only to write the next one.
    """
    stored, key = database.cache.rows, (table.name, lot_id, serial)
    rows = stored[key] if key in stored else database.rows(ROWS_OF_UNIT[table], {"lot": lot_id, "unit": serial})
    if table is calibrations:
        stored[key] = rows
    return rows


def heads_of(database: Database, lot_id: str, serial: str) -> list[RowMapping]:
    """Return the statements of a unit that nothing follows, newest first; several once histories parted."""
    rows = rows_of(database, in_use, lot_id, serial)
    followed = {(row["follows_origin"], row["follows_number"]) for row in rows}
    return [row for row in rows if (row["origin"], row["number"]) not in followed]


def names_several(database: Database, heads: Sequence[RowMapping]) -> bool:
    """Whether statements name calibrations that differ in map or verdict."""
    if len({(head["revision"], head["made_by"]) for head in heads}) < 2:
        return False
    c = calibrations.c
    maps = set()
    for head in heads:
        condition = (c.serial == head["serial"], c.revision == head["revision"], c.origin == head["made_by"])
        maps.add(tuple(database.tuples(select(c.map_sha256, c.verdict).where(*condition))[0]))
    return len(maps) > 1


def conflicts_of(
    database: Database, lot_id: str | None = None, serials: Sequence[str] | None = None
) -> list[tuple[str, str]]:
    """Return lot and serial of the units, of a lot or of some, for which registries put different maps into use."""
    if len(history.origins(database)) < 2:
        return []
    u, follower = in_use.c, in_use.alias()
    # Counted, not `EXISTS`: PostgreSQL would join that, and compare all units of a lot that was just written with all.
    followers = select(func.count()).where(
        follower.c.lot_id == u.lot_id,
        follower.c.serial == u.serial,
        follower.c.follows_origin == u.origin,
        follower.c.follows_number == u.number,
    )
    differ = sa.or_(
        func.min(calibrations.c.map_sha256) != func.max(calibrations.c.map_sha256),
        func.min(calibrations.c.verdict) != func.max(calibrations.c.verdict),
    )
    query = select(u.lot_id, u.serial).select_from(in_use).join(calibrations, OF_STATEMENT)
    is_head = followers.correlate(in_use).scalar_subquery() == 0
    query = query.where(is_head).group_by(u.lot_id, u.serial).having(differ)
    query = query.where(*equality_conditions((u.lot_id, lot_id), (u.serial, serials)))
    return [(lot, name) for lot, name in database.tuples(query.order_by(u.lot_id, u.serial))]


@dataclass(frozen=True)
class LimitInForce:
    """The limit in force of a lot: `rmse` in `unit`; None for the source's own error."""

    rmse: float | None
    unit: str

    def stale_reason(self, decided_limit: float) -> Reason:
        """Return the reason why a verdict against another limit is no longer valid."""
        if self.rmse is None:
            return reason(LIMIT_IS_WITHDRAWN, judged=decided_limit, unit=self.unit)
        return reason(LIMIT_IS_OTHER, judged=decided_limit, limit=self.rmse, unit=self.unit)


def newest_limit(database: Database, lot_id: str) -> LimitEntry | None:
    """Return the newest version of a lot's limit, or None where none was ever stated."""
    of_lot = select(limits).where(limits.c.lot_id == lot_id)
    row = database.row(of_lot.order_by(limits.c.made_at.desc(), limits.c.origin.desc()).limit(1))
    return None if row is None else entry_from_row(LimitEntry, row)


def limit_in_force(database: Database, lot_id: str) -> LimitInForce:
    """Return the limit in force of a lot."""
    row = database.row(LIMIT_IN_FORCE, {"lot": lot_id})
    return LimitInForce(None, "") if row is None else LimitInForce(row["rmse"], row["reference_unit"])


def conflict_line(database: Database, lot_id: str, serial: str) -> str:
    """Return the sentence with the conflict that a person must decide, and the command for it."""
    sides = ", ".join(
        f"revision {head['revision']} of registry {head['made_by']} ({head['decided_by']}, "
        f"{head['made_at']:%Y-%m-%d %H:%M:%S} UTC)"
        for head in heads_of(database, lot_id, serial)
    )
    return (
        f"unit {serial} of lot {lot_id}: two registries put different maps into use: {sides}; decide by a rollback to "
        "one of them, with the reason"
    )


def newest_of_unit(database: Database, lot_id: str, serial: str) -> datetime | None:
    """Return the time of the newest statement or refusal of a unit."""
    newest = (rows_of(database, table, lot_id, serial)[:1] for table in (in_use, refusals))
    return max((row["made_at"] for rows in newest for row in rows), default=None)


def ids_of_this_method(database: Database) -> list[str]:
    """Return the ids of the stored methods equal to that of this version, with any map family."""
    ids = database.values(select(methods.c.id))
    for id_ in (one for one in ids if one not in _IS_OF_THIS_VERSION):
        numbers = database.value(select(methods.c.numbers).where(methods.c.id == id_))
        _IS_OF_THIS_VERSION[id_] = _is_of_this_version(numbers)
    return [one for one in ids if _IS_OF_THIS_VERSION[one]]


_IS_OF_THIS_VERSION: dict[str, bool] = {}
"""Whether a stored method is that of this version, by its id, which is a hash of its numbers."""


def _is_of_this_version(numbers: Any) -> bool:
    # Whoever lists units needs none of the numerics behind the families.
    from softcal.core.unit.method import Method

    current = Method().to_json()
    family = {**current["map"], "family": numbers["map"]["family"]}  # type: ignore[dict-item]
    return canonical_json({**current, "map": family}) == canonical_json(numbers)
