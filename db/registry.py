"""The registry in the words of the factory: lots, units, recordings, networks, calibrations and who did what.

Every change is one transaction with its row of the audit trail. What is stored is never changed: a correction is a new
row. Everything given back is a value of its own, never a row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sqlalchemy import RowMapping, select
from sqlalchemy.exc import DataError, DBAPIError, StatementError

from softcal.core.errors import InputError
from softcal.db.access.people import People
from softcal.db.access.tokens import TokenTable
from softcal.db.entries import Anchor, AuditRow, Heads
from softcal.db.schema.database import parts
from softcal.db.schema.tables import audit, canonical_json
from softcal.db.truth import history
from softcal.db.truth.adaptations import AdaptationTables
from softcal.db.truth.calibrations import CalibrationTables
from softcal.db.truth.lot_pages import LotPages
from softcal.db.truth.lots import LotTables
from softcal.db.truth.network_release import NetworkReleases
from softcal.db.truth.stations import StationTables

if TYPE_CHECKING:
    from softcal.db.queues.job_board import JobBoard
    from softcal.db.queues.line_place import LinePlaces
    from softcal.db.queues.order_queue import OrderQueue
    from softcal.db.queues.outbox import Outbox
    from softcal.db.queues.work_queue import WorkQueue


class Registry(
    LotTables,
    LotPages,
    NetworkReleases,
    CalibrationTables,
    AdaptationTables,
    StationTables,
    People,
    TokenTable,
):
    """An open registry, used as a context manager and made by `open_registry`."""

    def __enter__(self) -> Registry:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections; what was not committed is gone."""
        self.database.close()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Keep everything done in the block, or nothing of it. Calls inside need no change."""
        with self.database.writing():
            yield

    @contextmanager
    def part(self) -> Iterator[None]:
        """Keep everything done in the block or nothing of it, inside a transaction that goes on either way.

        Raises:
            InputError: a value that the database cannot take.
        """
        with self.database.writing() as connection, connection.begin_nested():
            try:
                yield
            except DataError as error:
                raise InputError(f"a value cannot be stored: {error.orig}") from error
            except StatementError as error:
                if isinstance(error, DBAPIError):
                    raise
                raise InputError(f"a value cannot be stored: {error.orig}") from error

    @property
    def work_queue(self) -> WorkQueue:
        """The durable work items of this registry's lots."""
        # Here and below: whoever lists units has no use for queues and boards.
        from softcal.db.queues.work_queue import WorkQueue

        return WorkQueue(self.database, self.settings.clock)

    @property
    def order_queue(self) -> OrderQueue:
        """The orders to this registry's stations, their runs and heartbeats."""
        from softcal.db.queues.order_queue import OrderQueue

        return OrderQueue(self.database, self.settings.clock)

    @property
    def line_places(self) -> LinePlaces:
        """What stands at each line: the unit that waits for its run, the last sentence, the badge."""
        from softcal.db.queues.line_place import LinePlaces

        return LinePlaces(self.database, self.settings.clock)

    @property
    def job_board(self) -> JobBoard:
        """Long computations that pages ask for."""
        from softcal.db.queues.job_board import JobBoard

        return JobBoard(self.database, self.settings.clock)

    @property
    def outbox(self) -> Outbox:
        """How far each destination outside is in the audit trail."""
        from softcal.db.queues.outbox import Outbox

        return Outbox(self.database, self.settings.clock)

    def add_event(
        self,
        action: str,
        entity: str,
        key: tuple[str | int, ...],
        values: Mapping[str, object],
        *,
        reason: str = "",
        actor: str | None = None,
    ) -> None:
        """Put what changes no table (an export, an override of the station's gate) into the audit trail."""
        with self.database.writing() as connection:
            self._tell(connection, action, entity, key, actor, after=values, reason=reason)

    def events(self, entity: str, key: tuple[str | int, ...]) -> list[AuditRow]:
        """Return what the audit trail tells of one entity, in time order, whichever registry wrote it."""
        return self.events_of(entity, [key])

    def events_of(self, entity: str, keys: Sequence[tuple[str | int, ...]]) -> list[AuditRow]:
        """Return what the audit trail tells of several entities of a kind, in time order."""
        found: list[RowMapping] = []
        with self.database.reading():
            for part in parts(keys):
                names = [canonical_json(key) for key in part]
                found += self.database.rows(select(audit).where(audit.c.entity == entity, audit.c.key.in_(names)))
        return sorted((AuditRow(**row) for row in found), key=lambda row: (row.at, row.origin, row.seq))

    def events_of_kind(self, entity: str) -> list[AuditRow]:
        """Return what the audit trail tells of all entities of a kind, in time order."""
        query = select(audit).where(audit.c.entity == entity).order_by(audit.c.at, audit.c.origin, audit.c.seq)
        return [AuditRow(**row) for row in self.database.rows(query)]

    def audit_rows(self, origin: str | None = None) -> list[AuditRow]:
        """Return the audit trail of one registry, or of all that were synchronised, oldest first per origin."""
        with self.database.reading() as connection:
            return list(history.rows(connection, origin))

    def newest_audit_rows(self, count: int) -> list[AuditRow]:
        """Return the newest rows of the audit trail, whoever wrote them, the newest first."""
        found: list[RowMapping] = []
        with self.database.reading() as connection:
            # The newest of each chain are found through the index; sorted by time, all rows would be read.
            for origin in history.origins(connection):
                chain = select(audit).where(audit.c.origin == origin)
                found += self.database.rows(chain.order_by(audit.c.seq.desc()).limit(count))
        rows = sorted((AuditRow(**row) for row in found), key=lambda row: (row.at, row.origin, row.seq), reverse=True)
        return rows[:count]

    def verify(
        self,
        *,
        is_quick: bool = False,
        anchors: Sequence[Anchor] = (),
        on_step: Callable[[str], None] = lambda _: None,
    ) -> list[str]:
        """Check the database, every blob, every row and the audit chain; return one line per fault, none when all is
        well. `db.care.checks.faults` says what the arguments mean."""
        # Only the check pays for what it needs.
        from softcal.db.care.checks import faults

        with self.database.reading() as connection:
            return list(faults(connection, is_quick=is_quick, anchors=anchors, on_step=on_step))

    def heads(self) -> Heads:
        """Return number and hash of the last row of every chain of the audit trail: what to write down elsewhere."""
        with self.database.reading() as connection:
            return history.heads(connection)
