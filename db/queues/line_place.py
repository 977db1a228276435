"""What stands at a line beside its runs, one row a station: every screen of the line shows the same.

A change names the version it was decided on: of two screens that decide at once, one is told to look again.
"""

from collections.abc import Mapping
from typing import Any

from sqlalchemy import insert, select, update
from sqlalchemy.exc import IntegrityError

from softcal.db.schema.database import OncePerCut
from softcal.db.schema.tables import line_places


class LinePlaces(OncePerCut):
    """The place of each station's line. Every call is one short transaction."""

    def read(self, station: str) -> tuple[int, Mapping[str, Any]]:
        """Return version and values of a station's place; version 0 and nothing where nobody was there yet."""
        query = select(line_places.c.version, line_places.c.place).where(line_places.c.station == station)
        row = self.database.row(query)
        return (0, {}) if row is None else (row["version"], row["place"])

    def write(self, station: str, seen_version: int, place: Mapping[str, Any]) -> bool:
        """Put other values in their place; return False, with nothing changed, where another one was first.

        Args:
            seen_version: version that the change was decided on.
        """
        where = (line_places.c.station == station, line_places.c.version == seen_version)
        values = {"station": station, "version": seen_version + 1, "place": dict(place)}
        with self.database.writing(in_turn=False) as connection:
            if seen_version:
                return connection.execute(update(line_places).where(*where).values(**values)).rowcount == 1
            try:
                with connection.begin_nested():
                    connection.execute(insert(line_places).values(**values))
            except IntegrityError:
                return False
            return True
