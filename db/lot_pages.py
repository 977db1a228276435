"""A lot of any size a page at a time: counts, columns of numbers and sorted, filtered pages of units, all in SQL."""

from dataclasses import dataclass
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, RowMapping, Subquery, Table, and_, case, func, or_, select, tuple_

from softcal.core.errors import InputError
from softcal.core.reason import Reason
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import UnitEntry
from softcal.db.registry_base import RegistryBase
from softcal.db.tables import calibrations, golden_runs, limits, line_rules, networks, refusals, units

ERRORS = ("predicted_rmse", "before_rmse", "after_rmse", "own_rmse")
SORTABLE = ("serial", "verdict", "made_at", "family", *ERRORS)
MADE_FIELDS = ("revision", "family", "map_sha256", *ERRORS)
SEVERITY = {str(verdict): -verdict.severity for verdict in sorted(Verdict, key=lambda v: -v.severity)}


@dataclass(frozen=True)
class UnitFilter:
    """Which units of a lot, in which order.

    Args:
        verdicts: of these only; empty takes all, `none` those without a result.
        text: serials that hold this text, in any case.
        sort: one of `SORTABLE`, or `severity`: the worst verdict first, then the largest predicted error.
        is_descending: largest first; units without a value stand last either way.
    """

    verdicts: tuple[str, ...] = ()
    text: str = ""
    sort: str = "serial"
    is_descending: bool = False

    def __post_init__(self) -> None:
        if self.sort not in (*SORTABLE, "severity"):
            raise InputError(f"units cannot be sorted by {self.sort!r}; known: severity, {', '.join(SORTABLE)}")


@dataclass(frozen=True)
class UnitPage:
    """One page of units and how many the filter lets through in all."""

    units: tuple[UnitEntry, ...]
    total: int


class UnitErrors(NamedTuple):
    """The errors of one unit's newest map in the reference unit, None where they were not found, and its verdict."""

    serial: str
    verdict: str
    predicted_rmse: float | None
    before_rmse: float | None
    after_rmse: float | None
    own_rmse: float | None


class LotPages(RegistryBase):
    """The part of the registry that answers for a whole lot without reading all of it."""

    def unit_page(self, lot_id: str, wanted: UnitFilter, page: int = 1, size: int = 50) -> UnitPage:
        """Return one page (1, 2, ...) of a lot's target units with their newest result.

        Raises:
            InputError: the lot is not in the registry.
        """
        table = _standing(lot_id)
        condition = _condition(table, wanted)
        order = _order(table, wanted)
        query = select(table).where(condition).order_by(*order).limit(size).offset((page - 1) * size)
        with self.database.reading() as connection:
            self._lot_row(connection, lot_id)
            total = connection.execute(select(func.count()).select_from(table).where(condition)).scalar_one()
            rows = connection.execute(query).mappings().all()
        return UnitPage(tuple(_entry(lot_id, row) for row in rows), int(total))

    def find_serials(self, text: str, count: int = 50) -> list[str]:
        """Return serials of target units with a result that hold a text in any case; those that begin with it first."""
        has_result = or_(
            select(calibrations.c.serial).where(calibrations.c.serial == units.c.serial).exists(),
            select(refusals.c.serial).where(refusals.c.serial == units.c.serial).exists(),
        )
        name = func.lower(units.c.serial)
        query = select(units.c.serial).distinct().where(units.c.role == "target", has_result)
        if text:
            query = query.where(name.contains(text.lower(), autoescape=True))
        begins = case((name.startswith(text.lower(), autoescape=True), 0), else_=1)
        with self.database.reading() as connection:
            found = query.add_columns(begins.label("begins")).order_by("begins", units.c.serial).limit(count)
            return [str(serial) for serial, _ in connection.execute(found)]

    def verdict_counts(self, lot_id: str) -> dict[str, int]:
        """Return a lot's target units by the verdict of their newest result; `none` counts those without."""
        table = _standing(lot_id)
        verdict = func.coalesce(table.c.verdict, "none")
        with self.database.reading() as connection:
            self._lot_row(connection, lot_id)
            found = {str(v): int(n) for v, n in connection.execute(select(verdict, func.count()).group_by(verdict))}
        return {name: found.get(name, 0) for name in (*SEVERITY, "none")}

    def lot_errors(self, lot_id: str) -> list[UnitErrors]:
        """Return the errors of every target unit with a map, by serial."""
        table = _standing(lot_id)
        query = select(table.c.serial, table.c.verdict, *(table.c[name] for name in ERRORS))
        with self.database.reading() as connection:
            self._lot_row(connection, lot_id)
            rows = connection.execute(query.where(table.c.revision.is_not(None)).order_by(table.c.serial))
            return [UnitErrors(*row) for row in rows]

    def change_marker(self, lot_id: str) -> str:
        """Return text that changes whenever a unit, a result, a limit, a rule, a network or a check is added.

        A cheap key for what was computed from a lot: nothing of it is ever changed in place or deleted.
        """
        of_lot = (calibrations, refusals, limits, line_rules)
        parts = [
            select(value).where(t.c.lot_id == lot_id) for t in of_lot for value in (func.count(), func.max(t.c.made_at))
        ]
        parts += [select(func.count()).where(t.c.lot_id == lot_id) for t in (units, networks)]
        parts.append(select(func.count()).select_from(golden_runs))
        with self.database.reading() as connection:
            found = connection.execute(select(*(part.scalar_subquery() for part in parts))).one()
        return "|".join(map(str, found))


def _standing(lot_id: str) -> Subquery:
    """Every target unit of a lot beside its newest map and its newest verdict, which may be a later refusal's.

    "Nothing newer exists" is found through the index of the table; a window function over all rows is not, and its
    join with the units would take the square of their number.
    """
    c, r = calibrations, refusals
    is_refused = and_(r.c.made_at.is_not(None), or_(c.c.made_at.is_(None), r.c.made_at > c.c.made_at))
    newest = [case((is_refused, r.c[name]), else_=c.c[name]).label(name) for name in ("verdict", "reasons", "made_at")]
    joined = units.outerjoin(c, _is_newest(c, ("made_at", "revision", "origin"))).outerjoin(
        r, _is_newest(r, ("made_at", "origin"))
    )
    query = select(units.c.serial, *(c.c[name] for name in MADE_FIELDS), *newest).select_from(joined)
    return query.where(units.c.lot_id == lot_id, units.c.role == "target").subquery("standing")


def _is_newest(table: Table, order: tuple[str, ...]) -> ColumnElement[bool]:
    other = table.alias()
    is_same = and_(other.c.lot_id == table.c.lot_id, other.c.serial == table.c.serial)
    is_newer = tuple_(*(other.c[name] for name in order)) > tuple_(*(table.c[name] for name in order))
    newer = select(other.c.serial).where(is_same, is_newer).correlate(table).exists()
    return and_(table.c.lot_id == units.c.lot_id, table.c.serial == units.c.serial, ~newer)


def _condition(table: Subquery, wanted: UnitFilter) -> ColumnElement[bool]:
    parts: list[ColumnElement[bool]] = []
    if wanted.verdicts:
        parts.append(func.coalesce(table.c.verdict, "none").in_(wanted.verdicts))
    if wanted.text:
        parts.append(func.lower(table.c.serial).contains(wanted.text.lower(), autoescape=True))
    return and_(True, *parts)


def _order(table: Subquery, wanted: UnitFilter) -> list[ColumnElement[Any]]:
    if wanted.sort == "severity":
        severity = case(SEVERITY, value=table.c.verdict, else_=1)
        return [severity, table.c.predicted_rmse.desc().nulls_last(), table.c.serial]
    column = table.c[wanted.sort]
    first = (column.desc() if wanted.is_descending else column.asc()).nulls_last()
    return [first, table.c.serial]


def _entry(lot_id: str, row: RowMapping) -> UnitEntry:
    facts = {name: value for name, value in row.items() if name != "reasons"}
    return UnitEntry(lot_id=lot_id, role="target", reasons=tuple(map(Reason.of, row["reasons"] or ())), **facts)
