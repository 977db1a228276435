"""Registry of lots, units, recordings, maps and actions.

Every change is one transaction with its row of the audit trail. What is stored is never changed: a
correction is a new row. Everything given back is a value of its own, never a row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

from sqlalchemy.exc import DataError, DBAPIError, StatementError

from softcal.core.errors import InputError
from softcal.db.repositories.registry_base import RegistryBase

if TYPE_CHECKING:
    from softcal.db.access.people import People
    from softcal.db.access.tokens import TokenTable
    from softcal.db.entries import Anchor
    from softcal.db.queues.job_board import JobBoard
    from softcal.db.queues.order_queue import LineSessions, OrderQueue
    from softcal.db.queues.outbox import Outbox
    from softcal.db.queues.work_queue import WorkQueue
    from softcal.db.repositories.adaptations import AdaptationTables
    from softcal.db.repositories.calibrations import CalibrationTables
    from softcal.db.repositories.declarations import DeclarationTables
    from softcal.db.repositories.lot_decisions import LotDecisionTable
    from softcal.db.repositories.lot_pages import LotPages
    from softcal.db.repositories.lots import LotTables
    from softcal.db.repositories.networks import NetworkTables
    from softcal.db.repositories.recordings import RecordingTables
    from softcal.db.repositories.stations import StationTables
    from softcal.db.repositories.trail import AuditTrail


def _part(module: str, kind: str) -> Any:
    """Return a property that is created on first use, so that a caller pays only for what it uses."""

    def make(registry: Registry) -> RegistryBase:
        part: type[RegistryBase] = getattr(import_module(f"softcal.db.{module}"), kind)
        return part(registry.database, registry.settings, registry.origin)

    return cached_property(make)


class Registry(RegistryBase):
    """An open registry, made by `open_registry`; its repositories share transactions."""

    lots: LotTables = _part("repositories.lots", "LotTables")
    pages: LotPages = _part("repositories.lot_pages", "LotPages")
    recordings: RecordingTables = _part("repositories.recordings", "RecordingTables")
    networks: NetworkTables = _part("repositories.networks", "NetworkTables")
    calibrations: CalibrationTables = _part("repositories.calibrations", "CalibrationTables")
    decisions: LotDecisionTable = _part("repositories.lot_decisions", "LotDecisionTable")
    declarations: DeclarationTables = _part("repositories.declarations", "DeclarationTables")
    adaptations: AdaptationTables = _part("repositories.adaptations", "AdaptationTables")
    stations: StationTables = _part("repositories.stations", "StationTables")
    people: People = _part("access.people", "People")
    tokens: TokenTable = _part("access.tokens", "TokenTable")
    trail: AuditTrail = _part("repositories.trail", "AuditTrail")
    work_queue: WorkQueue = _part("queues.work_queue", "WorkQueue")
    order_queue: OrderQueue = _part("queues.order_queue", "OrderQueue")
    line_sessions: LineSessions = _part("queues.order_queue", "LineSessions")
    job_board: JobBoard = _part("queues.job_board", "JobBoard")
    outbox: Outbox = _part("queues.outbox", "Outbox")

    def __enter__(self) -> Registry:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections; uncommitted changes are lost."""
        self.database.close()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit everything in the block, or nothing; calls inside need no change."""
        with self.database.writing():
            yield

    @contextmanager
    def part(self) -> Iterator[None]:
        """Commit all of the block or nothing, inside an open transaction that continues either way.

        `InputError`: a value that the database cannot take.
        """
        with self.database.writing() as connection, connection.begin_nested():
            try:
                yield
            except StatementError as error:
                if isinstance(error, DBAPIError) and not isinstance(error, DataError):
                    raise
                raise InputError(f"a value cannot be stored: {error.orig}") from error

    def verify(
        self, *, is_quick: bool = False, anchors: Sequence[Anchor] = (), on_step: Callable[[str], None] = lambda _: None
    ) -> list[str]:
        """Check database, blobs, rows and audit chain as `db.maintenance.checks.faults`; return one line per fault."""
        # Only the check pays for what it needs.
        from softcal.db.maintenance.checks import faults

        with self.database.reading():
            return list(faults(self.database, is_quick=is_quick, anchors=anchors, on_step=on_step))
