"""Steps of drift tracking: every map of a unit in use, with its stream and evidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, Text, func, select, type_coerce

from softcal.core.errors import NoSuchRevision
from softcal.core.lot import UnitKey
from softcal.db.repositories.registry_base import RegistryBase, entry_from_row
from softcal.db.schema.database import equality_conditions
from softcal.db.schema.tables import adaptations, calibrations

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class AdaptedUnit:
    """A unit in use, the newest step of its adaptation, and how many the registry holds without checkpoints."""

    lot_id: str
    serial: str
    stream: str
    made_at: datetime
    steps: int
    entry: Entry

    @property
    def key(self) -> UnitKey:
        return UnitKey(self.lot_id, self.serial)


class AdaptationTables(RegistryBase):
    """Repository of the steps of drift tracking."""

    def add(self, unit: UnitKey, revision: int, entries: Sequence[Entry], actor: str | None = None) -> int:
        """Store steps, all or none, and return the last one's number (1, 2, ... a unit).

        Args:
            revision: the calibration the adaptation started from.
            entries: JSON values with at least `stream` and `sample` (the row of the step).

        Raises:
            InputError: the unit has no such revision.
        """
        with self.database.writing():
            c = calibrations.c
            query = select(c.serial).where(*_of_unit(c, unit), c.revision == revision).limit(1)
            if self.database.row(query) is None:
                raise NoSuchRevision(f"unit {unit} has no revision {revision} to adapt")
            of_unit = (*_of_unit(adaptations.c, unit), adaptations.c.origin == self.origin)
            last = int(self.database.value(select(func.max(adaptations.c.number)).where(*of_unit)) or 0)
            for number, entry in enumerate(entries, last + 1):
                values = {**vars(unit), "number": number, "origin": self.origin, "revision": revision}
                values |= {"stream": entry["stream"], "sample": entry["sample"], "entry": dict(entry)}
                values["made_at"] = self.settings.clock()
                self._store(adaptations, values, "adapt", actor)
            return last + len(entries)

    def last(self, unit: UnitKey, revision: int, stream: str) -> Entry | None:
        """Return the newest step of a stream, to go on after a stop; None before the first."""
        entry: Entry | None = self.database.value(_newest_first(unit, revision, stream).limit(1))
        return entry

    def last_checkpoint(self, unit: UnitKey, revision: int, stream: str) -> Entry | None:
        """Return the newest step of a stream that holds a `state` to go on from."""
        with self.database.reading():
            newest = self.database.stream(_newest_first(unit, revision, stream))
            return next((row["entry"] for row in newest if "state" in row["entry"]), None)

    def all(self, unit: UnitKey, stream: str | None = None) -> list[Entry]:
        """Return the steps of a unit, of one stream or of all, in order of creation."""
        c = adaptations.c
        query = select(c.entry).where(*_of_unit(c, unit), *equality_conditions((c.stream, stream)))
        return self.database.values(query.order_by(c.made_at, c.origin, c.number))

    def units(self) -> list[AdaptedUnit]:
        """Return the units in use, adapted last first, with their newest step but a checkpoint."""
        a = adaptations.c
        is_step = type_coerce(a.entry, Text).not_like('%"event":"checkpoint"%')
        order = (a.made_at.desc(), a.sample.desc(), a.number.desc())
        rank = func.row_number().over(partition_by=(a.lot_id, a.serial), order_by=order).label("rank")
        steps = func.count().over(partition_by=(a.lot_id, a.serial)).label("steps")
        ranked = select(a.lot_id, a.serial, a.stream, a.made_at, a.entry, rank, steps).where(is_step).subquery()
        newest = (
            select(ranked).where(ranked.c.rank == 1).order_by(ranked.c.made_at.desc(), ranked.c.serial, ranked.c.lot_id)
        )
        return [entry_from_row(AdaptedUnit, row) for row in self.database.rows(newest)]

    def streams(self, unit: UnitKey) -> list[str]:
        """Return the streams a unit was followed on, the newest first."""
        a = adaptations.c
        newest = func.max(a.made_at)
        query = select(a.stream).where(*_of_unit(a, unit)).group_by(a.stream).order_by(newest.desc(), a.stream)
        return self.database.values(query)


def _of_unit(c: Any, unit: UnitKey) -> tuple[ColumnElement[bool], ...]:
    return c.lot_id == unit.lot_id, c.serial == unit.serial


def _newest_first(unit: UnitKey, revision: int, stream: str) -> Select[Any]:
    c = adaptations.c
    query = select(c.entry).where(*_of_unit(c, unit), c.revision == revision, c.stream == stream)
    return query.order_by(c.sample.desc(), c.made_at.desc(), c.number.desc())
