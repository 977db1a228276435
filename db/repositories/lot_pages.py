"""Status of the units of a lot: the calibration in use, a newer refusal, or a conflict.

One question in SQL says it for a unit, a page of a lot of any size, counts and reports.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import sqlalchemy as sa
from sqlalchemy import ColumnElement, and_, bindparam, case, func, select

from softcal.core.errors import InputError
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason, plain
from softcal.db.entries import UNDECIDED, UNIT_ERRORS, StoredCalibration, UnitEntry, UnitResult
from softcal.db.repositories import history
from softcal.db.repositories.in_use import (
    OF_STATEMENT,
    STALE,
    conflict_line,
    conflicts_of,
    ids_of_this_method,
    limit_in_force,
)
from softcal.db.repositories.registry_base import RegistryBase, damage_error, entry_from_row
from softcal.db.repositories.unit_states import read_parts, state_of
from softcal.db.schema.database import Database, equality_conditions, parts
from softcal.db.schema.tables import calibrations, in_use, refusals, units

SORTABLE = ("serial", "verdict", "made_at", "family", *UNIT_ERRORS)
CALIBRATION_FIELDS = ("revision", "family", "map_sha256", "state_sha256", *UNIT_ERRORS)

MAX_MATCHES = 50
"""So many serials a search offers."""

MAX_SERIALS = 30_000
"""A question takes no more values than that in SQLite (32,766 since 3.32)."""


@cache
def _severities() -> dict[str, int]:
    """Return verdicts, the worst first, with how they sort."""
    # Only who sorts or counts verdicts waits for the numerics behind them.
    from softcal.core.unit.verdict import Verdict

    return {str(verdict): -verdict.severity for verdict in sorted(Verdict, key=lambda v: -v.severity)}


@dataclass(frozen=True)
class UnitFilter:
    """Filter and order of the units of a lot.

    Args:
        verdicts: of these only; empty takes all, `none` those without a result.
        text: serials that hold this text, in any case.
        sort: one of `SORTABLE`, or `severity`: worst verdict, then largest forecast.
        is_descending: largest first; units without a value are last either way.
        serials: of these units only; None takes all.
    """

    verdicts: tuple[str, ...] = ()
    text: str = ""
    sort: str = "serial"
    is_descending: bool = False
    serials: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.sort not in (*SORTABLE, "severity"):
            raise InputError(f"units cannot be sorted by {self.sort!r}; known: severity, {', '.join(SORTABLE)}")
        if len(self.serials or ()) > MAX_SERIALS:
            raise InputError(f"{len(self.serials or ())} units at once; choose fewer than {MAX_SERIALS}, by days")

    def conditions(self, table: sa.Subquery) -> Iterator[ColumnElement[bool]]:
        if self.verdicts:
            yield func.coalesce(table.c.verdict, "none").in_(self.verdicts)
        if self.text:
            yield func.lower(table.c.serial).contains(self.text.lower(), autoescape=True)
        if self.serials is not None:
            yield table.c.serial.in_(self.serials)

    def order(self, table: sa.Subquery) -> list[ColumnElement[Any]]:
        if self.sort == "severity":
            severity = case(_severities(), value=table.c.verdict, else_=1)
            return [severity, table.c.predicted_rmse.desc().nulls_last(), table.c.serial]
        column = table.c[self.sort]
        return [(column.desc() if self.is_descending else column.asc()).nulls_last(), table.c.serial]


@dataclass(frozen=True)
class UnitPage:
    """One page of units, and the number of all units in the filter."""

    units: tuple[UnitEntry, ...]
    total: int


class LotPages(RegistryBase):
    """Status of many units at once: pages, counts, errors, without reading the whole lot."""

    def unit_page(self, lot_id: str, unit_filter: UnitFilter, *, size: int = 50, before: int = 0) -> UnitPage:
        """Return the `size` target units of a lot behind the first `before`, each with its newest result.

        `InputError`: no such lot.
        """
        with self.database.reading():
            self._lot_row(lot_id)
            status_query = StatusQuery(self.database, lot_id, role="target")
            table = status_query.table
            condition: ColumnElement[bool] = and_(True, *unit_filter.conditions(table))
            order = unit_filter.order(table)
            query = select(table).where(condition).order_by(*order).limit(size).offset(before)
            total = self.database.value(select(func.count()).select_from(table).where(condition), status_query.values)
            entries = [status_query.entry(row) for row in self.database.rows(query, status_query.values)]
        return UnitPage(tuple(entries), int(total))

    def unit_statuses(
        self, lot_id: str, serials: Sequence[str], *, has_stale: bool = False, has_arrays: bool = False
    ) -> dict[str, UnitResult]:
        """Return the status of units of a lot for a report.

        A unit with a conflict is to be decided by a person: its verdict is retest. So is that of a unit that was
        decided against another limit than the one in force.

        Args:
            has_stale: whether a unit decided against another limit still has its calibration.
            has_arrays: whether its map can estimate; without, a lot of ten thousand fits into memory.
        """
        unit_statuses: dict[str, UnitResult] = {}
        c = calibrations.c
        for part in parts(serials):
            with self.database.reading():
                entries = units_with_status(self.database, lot_id, part)
                entries = [
                    (unit, has_calibration or (has_stale and is_stale(unit))) for unit, has_calibration in entries
                ]
                keys = [(unit.serial, unit.revision) for unit, has_calibration in entries if has_calibration]
                query = select(calibrations).where(c.lot_id == lot_id, sa.tuple_(c.serial, c.revision).in_(keys))
                # Two registries may have made a revision of this number: the state tells which.
                rows = {(row["serial"], row["state_sha256"]): row for row in self.database.rows(query)}
                fit_rows = read_parts(self.database, list(rows.values()))
            for unit, has_calibration in entries:
                if unit.verdict is not None and unit.made_at is not None:
                    stored, row = None, rows.get((unit.serial, unit.state_sha256))
                    if has_calibration and row is not None:
                        state = state_of(self.database, row, fit_rows, has_arrays=has_arrays)
                        stored = entry_from_row(StoredCalibration, row, state=state, is_current=True, is_conflict=False)
                    decision = (unit.verdict, unit.reasons, unit.made_at)
                    unit_statuses[unit.serial] = UnitResult(unit.serial, *decision, stored)
        return unit_statuses

    def find_units(self, text: str) -> list[UnitKey]:
        """Return up to `MAX_MATCHES` target units with a result whose serials hold a text, best match first."""
        results = (select(table.c.serial).where(_is_of_unit(table)) for table in (calibrations, refusals))
        has_result = sa.or_(*(result.exists() for result in results))
        query = select(units.c.lot_id, units.c.serial).where(units.c.role == "target", has_result)
        order: list[ColumnElement[Any]] = [units.c.serial, units.c.lot_id]
        if text:
            # Without a text the index gives the first serials, and nothing else is read.
            name = func.lower(units.c.serial)
            query = query.where(name.contains(text.lower(), autoescape=True))
            order = [case((name.startswith(text.lower(), autoescape=True), 0), else_=1), *order]
        return [UnitKey(*row) for row in self.database.tuples(query.order_by(*order).limit(MAX_MATCHES))]

    def verdict_counts(self, lot_id: str) -> dict[str, int]:
        """Return the count of a lot's target units by verdict; `none` counts those without."""
        with self.database.reading():
            self._lot_row(lot_id)
            statuses = StatusQuery(self.database, lot_id, role="target")
            query = select(statuses.table.c.verdict, func.count()).group_by(statuses.table.c.verdict)
            counts = {str(v or "none"): int(n) for v, n in self.database.tuples(query, statuses.values)}
        return {name: counts.get(name, 0) for name in (*_severities(), "none")}

    def verdicts(self, lot_id: str) -> dict[str, str]:
        """Return the verdict of every target unit of a lot that has one, by serial."""
        with self.database.reading():
            self._lot_row(lot_id)
            statuses = StatusQuery(self.database, lot_id, role="target")
            query = select(statuses.table.c.serial, statuses.table.c.verdict)
            return {serial: verdict for serial, verdict in self.database.tuples(query, statuses.values) if verdict}

    def audited_count(self, lot_id: str) -> int:
        """Return how many target units of a lot have an error that was measured, and an audit that is not set aside."""
        with self.database.reading():
            statuses = StatusQuery(self.database, lot_id, role="target")
            table = statuses.table
            query = select(func.count()).select_from(table).where(table.c.after_rmse.is_not(None))
            return int(self.database.value(query, statuses.values))

    def lot_errors(self, lot_id: str) -> list[UnitEntry]:
        """Return verdict and errors of every target unit with a map, by serial, without its reasons."""
        with self.database.reading():
            self._lot_row(lot_id)
            statuses = StatusQuery(self.database, lot_id, role="target")
            columns = [statuses.table.c[name] for name in ("lot_id", "serial", "role", "verdict", *CALIBRATION_FIELDS)]
            # Asked for in SQL, "with a map" makes PostgreSQL read the calibrations of all lots.
            rows = self.database.rows(select(*columns).order_by(statuses.table.c.serial), statuses.values)
            return [UnitEntry(**row) for row in rows if row["revision"] is not None]

    def change_marker(self, lot_id: str) -> str:
        """Return text that changes whenever anything of a lot does.

        A cheap key of a cache: every change adds a row to a chain of the audit trail.
        """
        with self.database.reading():
            return "|".join([lot_id, *(sha256 for _, sha256 in history.heads(self.database).values())])


class StatusQuery:
    """Query of the status of a lot or some of its units: `table` with the `values` of its parameters."""

    def __init__(
        self, database: Database, lot_id: str, serials: Sequence[str] | None = None, role: str | None = None
    ) -> None:
        self.database, self.lot_id = database, lot_id
        # For these two registries put different maps into use. A verdict against another limit does not stand.
        undecided = [serial for _, serial in conflicts_of(database, lot_id, serials)]
        self.limit = limit_in_force(database, lot_id)
        self.table = _status_table(serials is not None, role is not None, self.limit.rmse is not None)
        bound_values = {"serials": serials, "role": role, "limit": self.limit.rmse}
        self.values: dict[str, Any] = {
            "standing_lot": lot_id,
            "standing_lot_again": lot_id,
            # Nothing is named "". Without members IN and NOT IN are written otherwise, and one would stand for both.
            "standing_undecided": [*undecided, ""],
            "standing_methods": [*ids_of_this_method(database), ""],
            **{f"standing_{name}": value for name, value in bound_values.items() if value is not None},
        }

    def entry(self, row: sa.RowMapping) -> UnitEntry:
        serial = row["serial"]
        if row["is_stale"] is None:
            raise damage_error(f"unit {serial} of lot {self.lot_id}: the calibration in use was not found")
        if row["is_conflict"] and not row["is_refused"]:
            reasons: tuple[Reason, ...] = (plain(conflict_line(self.database, self.lot_id, serial)),)
        elif row["judged_by"] is not None:
            reasons = (self.limit.stale_reason(row["judged_by"]),)
        else:
            reasons = tuple(map(Reason.parse, row["reasons"] or ()))
        return entry_from_row(UnitEntry, row, reasons=reasons)


def is_stale(unit: UnitEntry) -> bool:
    """Return whether a unit was decided against another limit than the limit in force."""
    return bool(unit.reasons) and unit.reasons[0].code in STALE


def units_with_status(
    database: Database, lot_id: str, serials: Sequence[str] | None = None
) -> list[tuple[UnitEntry, bool]]:
    """Return units of a lot, each with whether its calibration in use gives its verdict."""
    status_query = StatusQuery(database, lot_id, serials)
    rows = database.rows(select(status_query.table).order_by(status_query.table.c.serial), status_query.values)
    registered = {row["serial"] for row in rows}
    # A damaged index hides rows without a word.
    for results in (in_use, refusals):
        query = select(results.c.serial).where(
            *equality_conditions((results.c.lot_id, lot_id), (results.c.serial, serials))
        )
        if missing := sorted({*database.values(query.distinct())} - registered):
            raise damage_error(f"unit {missing[0]} of lot {lot_id} has a result and was not found itself")
    return [(status_query.entry(row), bool(row["is_made"])) for row in rows]


@cache
def _status_table(has_serials: bool, has_role: bool, is_limited: bool) -> sa.Subquery:
    """Return every unit beside its map in use and its newest verdict, or a later refusal's.

    Built once: that takes longer than to ask it. The newest row of a unit is found through the index of the table; a
    window function over all rows is not, and its join with the units would take the square of their number.
    """
    c, u, r = calibrations, in_use, refusals
    is_refused = and_(r.c.made_at.is_not(None), sa.or_(u.c.made_at.is_(None), r.c.made_at > u.c.made_at))
    is_open = units.c.serial.in_(bindparam("standing_undecided", expanding=True))
    is_stated = and_(u.c.made_at.is_not(None), ~is_refused)
    is_other = sa.or_(~c.c.is_limit_stated, c.c.limit_rmse != bindparam("standing_limit"))
    is_unjudged = and_(is_stated, ~is_open, is_other if is_limited else c.c.is_limit_stated)
    is_undecided = and_(is_stated, sa.or_(is_open, is_unjudged))
    is_of_this_method = c.c.method_id.in_(bindparam("standing_methods", expanding=True))
    columns: dict[str, ColumnElement[Any]] = {
        "verdict": case((is_refused, r.c.verdict), (is_undecided, UNDECIDED), else_=c.c.verdict),
        "reasons": case((is_refused, r.c.reasons), else_=c.c.reasons),
        "made_at": case((is_refused, r.c.made_at), else_=u.c.made_at),
        **{name: case((is_open, None), else_=c.c[name]) for name in CALIBRATION_FIELDS},
        "is_stale": and_(u.c.made_at.is_not(None), ~is_open, ~is_of_this_method),
        "is_conflict": is_open,
        # What is left out of an entry.
        "is_made": and_(is_stated, ~is_undecided),
        "is_refused": is_refused,
        "judged_by": case((is_unjudged, c.c.limit_rmse), else_=None),
    }
    stated = units.outerjoin(u, and_(_is_of_unit(u), _is_newest(u, ("made_at", "number", "origin"))))
    refused = and_(_is_of_unit(r), _is_newest(r, ("made_at", "origin")))
    joined = stated.outerjoin(c, OF_STATEMENT).outerjoin(r, refused)
    query = select(units.c.lot_id, units.c.serial, units.c.role, *(c.label(name) for name, c in columns.items()))
    # Named twice: PostgreSQL would read `= lot` into every table of the join. Of a lot that was just written it
    # expects one row, and would compare all units of the lot with all.
    lot: list[Any] = [bindparam("standing_lot"), bindparam("standing_lot_again")]
    query = query.select_from(joined).where(units.c.lot_id.in_(lot))
    if has_serials:
        query = query.where(units.c.serial.in_(bindparam("standing_serials", expanding=True)))
    if has_role:
        query = query.where(units.c.role == bindparam("standing_role"))
    return query.subquery("standing")


def _is_of_unit(table: sa.Table) -> ColumnElement[bool]:
    return and_(table.c.lot_id == units.c.lot_id, table.c.serial == units.c.serial)


def _is_newest(table: sa.Table, names: Sequence[str]) -> ColumnElement[bool]:
    # By a subquery of its own for each row: no statistics make it anything but a search of the index.
    other = table.alias()
    query = select(*(other.c[name] for name in names)).order_by(*(other.c[name].desc() for name in names)).limit(1)
    query = query.where(other.c.lot_id == table.c.lot_id, other.c.serial == table.c.serial).correlate(table)
    return sa.tuple_(*(table.c[name] for name in names)).in_(query)
