"""Long-term adaptation: every map a unit in use got, from which stream, with evidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Select, Text, func, select, type_coerce

from softcal.core.errors import NoSuchRevision
from softcal.db.schema.database import given
from softcal.db.schema.tables import adaptations, calibrations
from softcal.db.truth.registry_base import RegistryBase, of_row

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class AdaptedUnit:
    """A unit in use, the newest step of its adaptation, and how many the registry holds without checkpoints."""

    serial: str
    stream: str
    made_at: datetime
    steps: int
    entry: Entry


class AdaptationTables(RegistryBase):
    """What was followed of units in use."""

    def add(self, serial: str, revision: int, entries: Sequence[Entry], actor: str | None = None) -> int:
        """Store steps, all or none, and return the last one's number (1, 2, ... a serial).

        Args:
            revision: the calibration the adaptation started from.
            entries: JSON values with at least `stream` and `sample` (the row of the step).

        Raises:
            InputError: the serial has no such revision.
        """
        with self.database.writing():
            c = calibrations.c
            known = select(c.serial).where(c.serial == serial, c.revision == revision).limit(1)
            if self.database.row(known) is None:
                raise NoSuchRevision(f"serial {serial!r} has no revision {revision} to adapt")
            mine = (adaptations.c.serial == serial, adaptations.c.origin == self.origin)
            last = int(self.database.value(select(func.max(adaptations.c.number)).where(*mine)) or 0)
            for number, entry in enumerate(entries, last + 1):
                values = {"serial": serial, "number": number, "origin": self.origin, "revision": revision}
                values |= {"stream": entry["stream"], "sample": entry["sample"], "entry": dict(entry)}
                values["made_at"] = self.settings.clock()
                self._store(adaptations, values, "adapt", actor)
            return last + len(entries)

    def last(self, serial: str, revision: int, stream: str) -> Entry | None:
        """Return the newest step of a stream, to go on after a stop; None before the first."""
        entry: Entry | None = self.database.value(_newest_first(serial, revision, stream).limit(1))
        return entry

    def last_checkpoint(self, serial: str, revision: int, stream: str) -> Entry | None:
        """Return the newest step of a stream that holds a `state` to go on from."""
        with self.database.reading():
            newest = self.database.stream(_newest_first(serial, revision, stream))
            return next((row["entry"] for row in newest if "state" in row["entry"]), None)

    def all(self, serial: str, stream: str | None = None) -> list[Entry]:
        """Return the steps of a serial, of one stream or of all, in the order they were made."""
        c = adaptations.c
        query = select(c.entry).where(*given((c.serial, serial), (c.stream, stream)))
        return self.database.values(query.order_by(c.made_at, c.origin, c.number))

    def units(self) -> list[AdaptedUnit]:
        """Return the units in use, adapted last first, with their newest step but a checkpoint."""
        a = adaptations.c
        is_step = type_coerce(a.entry, Text).not_like('%"event":"checkpoint"%')
        order = (a.made_at.desc(), a.sample.desc(), a.number.desc())
        rank = func.row_number().over(partition_by=a.serial, order_by=order).label("rank")
        steps = func.count().over(partition_by=a.serial).label("steps")
        ranked = select(a.serial, a.stream, a.made_at, a.entry, rank, steps).where(is_step).subquery()
        newest = select(ranked).where(ranked.c.rank == 1).order_by(ranked.c.made_at.desc(), ranked.c.serial)
        return [of_row(AdaptedUnit, row) for row in self.database.rows(newest)]

    def streams(self, serial: str) -> list[str]:
        """Return the streams a unit was followed on, the newest first."""
        a = adaptations.c
        newest = func.max(a.made_at)
        query = select(a.stream).where(a.serial == serial).group_by(a.stream).order_by(newest.desc(), a.stream)
        return self.database.values(query)


def _newest_first(serial: str, revision: int, stream: str) -> Select[Any]:
    c = adaptations.c
    query = select(c.entry).where(c.serial == serial, c.revision == revision, c.stream == stream)
    return query.order_by(c.sample.desc(), c.made_at.desc(), c.number.desc())
