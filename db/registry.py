"""The registry in the words of the factory: lots, units, recordings, networks, calibrations and who did what.

Every change is one transaction with its row of the audit trail. What is stored is never changed: a correction is a new
row. Everything given back is a value of its own, never a row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

from sqlalchemy.exc import DataError, DBAPIError, StatementError

from softcal.core.errors import InputError
from softcal.db.truth.registry_base import RegistryBase

if TYPE_CHECKING:
    from softcal.db.access.people import People
    from softcal.db.access.tokens import TokenTable
    from softcal.db.entries import Anchor
    from softcal.db.queues.job_board import JobBoard
    from softcal.db.queues.line_place import LinePlaces
    from softcal.db.queues.order_queue import OrderQueue
    from softcal.db.queues.outbox import Outbox
    from softcal.db.queues.work_queue import WorkQueue
    from softcal.db.truth.adaptations import AdaptationTables
    from softcal.db.truth.calibrations import CalibrationTables
    from softcal.db.truth.lot_pages import LotPages
    from softcal.db.truth.lots import LotTables
    from softcal.db.truth.networks import NetworkTables
    from softcal.db.truth.recordings import RecordingTables
    from softcal.db.truth.stations import StationTables
    from softcal.db.truth.trail import AuditTrail

Part = TypeVar("Part", bound=RegistryBase)


class Registry(RegistryBase):
    """An open registry, used as a context manager and made by `open_registry`; its parts share its transactions."""

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

    @cached_property
    def lots(self) -> LotTables:
        """Lots and their units, limits and rules."""
        # Here and below: whoever lists units pays for no other part.
        from softcal.db.truth.lots import LotTables

        return self._part(LotTables)

    @cached_property
    def pages(self) -> LotPages:
        """What stands of many units at once: pages, counts, errors."""
        from softcal.db.truth.lot_pages import LotPages

        return self._part(LotPages)

    @cached_property
    def recordings(self) -> RecordingTables:
        """Recordings, by the hash of their content."""
        from softcal.db.truth.recordings import RecordingTables

        return self._part(RecordingTables)

    @cached_property
    def networks(self) -> NetworkTables:
        """Shared networks, and which of them the line may use."""
        from softcal.db.truth.networks import NetworkTables

        return self._part(NetworkTables)

    @cached_property
    def calibrations(self) -> CalibrationTables:
        """The calibrations of every unit, and which one is in use."""
        from softcal.db.truth.calibrations import CalibrationTables

        return self._part(CalibrationTables)

    @cached_property
    def adaptations(self) -> AdaptationTables:
        """What was followed of units in use."""
        from softcal.db.truth.adaptations import AdaptationTables

        return self._part(AdaptationTables)

    @cached_property
    def stations(self) -> StationTables:
        """Certificates of load cells and runs of golden units."""
        from softcal.db.truth.stations import StationTables

        return self._part(StationTables)

    @cached_property
    def people(self) -> People:
        """Accounts with role and PIN."""
        from softcal.db.access.people import People

        return self._part(People)

    @cached_property
    def tokens(self) -> TokenTable:
        """Tokens of programs that ask over REST."""
        from softcal.db.access.tokens import TokenTable

        return self._part(TokenTable)

    @cached_property
    def trail(self) -> AuditTrail:
        """Who did what, and when."""
        from softcal.db.truth.trail import AuditTrail

        return self._part(AuditTrail)

    @cached_property
    def work_queue(self) -> WorkQueue:
        """The durable work items of this registry's lots."""
        from softcal.db.queues.work_queue import WorkQueue

        return WorkQueue(self.database, self.settings.clock)

    @cached_property
    def order_queue(self) -> OrderQueue:
        """The orders to this registry's stations, their runs and heartbeats."""
        from softcal.db.queues.order_queue import OrderQueue

        return OrderQueue(self.database, self.settings.clock)

    @cached_property
    def line_places(self) -> LinePlaces:
        """What stands at each line: the unit that waits for its run, the last sentence, the badge."""
        from softcal.db.queues.line_place import LinePlaces

        return LinePlaces(self.database, self.settings.clock)

    @cached_property
    def job_board(self) -> JobBoard:
        """Long computations that pages ask for."""
        from softcal.db.queues.job_board import JobBoard

        return JobBoard(self.database, self.settings.clock)

    @cached_property
    def outbox(self) -> Outbox:
        """How far each destination outside is in the audit trail."""
        from softcal.db.queues.outbox import Outbox

        return Outbox(self.database, self.settings.clock)

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

    def _part(self, kind: type[Part]) -> Part:
        return kind(self.database, self.settings, self.origin)
