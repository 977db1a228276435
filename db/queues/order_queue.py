"""Orders to stations, their progress, and heartbeats, as rows that page and station share.

A page writes an order and reads progress; the station takes orders and writes progress. Neither needs the other to be
there. One run at a time per station is a unique index of the database, not a rule of a program.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import RowMapping, Select, delete, insert, select, update

from softcal.core.errors import InputError, NoSuchOrder, StationBusy
from softcal.core.messages.reason import Reason, pack_reasons, reason, to_stored
from softcal.core.orders import ACTIVE, Condition, Heartbeat, Order, OrderKind, Progress, RunState, Signal, StationState
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.database import equality_conditions
from softcal.db.schema.deadline import is_silent
from softcal.db.schema.tables import heartbeats, line_places, orders, run_signals

STATION_SILENT_AFTER = timedelta(seconds=3)
"""A station whose last heartbeat is older is not there, as far as a screen can see."""

TAKEOVER_AFTER = timedelta(seconds=15)
"""Another process may serve a station whose heartbeat is older. A busy machine keeps a service from
its beat for seconds: it must not lose its rig for that."""

ORDER_FIELDS = ("order_id", "station", "kind", "serial", "lot_id", "actor", "reason", "created")
PROGRESS_FIELDS = tuple(field.name for field in fields(Progress) if field.name != "signal")
SIGNAL_FIELDS = ("t_s", "output", "stage_mm", "force_N")
RUNS = tuple(kind for kind in OrderKind if kind.is_run)
o = orders.c


class UnitPress(NamedTuple):
    """One press of a unit at the line: station, actor, start and end (UTC)."""

    serial: str
    station: str
    actor: str
    begun: datetime
    ended: datetime


class OrderQueue(RegistryBase):
    """Orders, runs and heartbeats of a registry's stations. Every call is one short transaction."""

    def place(self, order: Order, until_s: float | None = None) -> bool:
        """Ask a station for something before `until_s` (`time.monotonic()`); return whether in time.

        The same id changes nothing. `InputError`: the station has a run that is not over.
        """
        values = {name: getattr(order, name) for name in ORDER_FIELDS}
        values["created"] = order.created or self.settings.clock()
        progress = _progress_values(Progress(order.order_id, RunState.QUEUED))
        with self.database.writing(in_turn=False):
            if self.database.row(select(o.order_id).where(o.order_id == order.order_id)) is not None:
                return True
            # Looked at behind the wait for other writers, which is where the time goes.
            if until_s is not None and time.monotonic() > until_s:
                return False
            new_order = insert(orders).values(**values | progress, changed_at=self.settings.clock())
            if self.database.insert_new(new_order):
                return True
            row = self.database.rows(_open_runs(order.station))[0]
            run_text = f"{row['kind']} {row['serial']}".strip()
            raise StationBusy(reason("station.busy", station=repr(order.station), what=run_text, state=row["state"]))

    def take(self, station: str, only: OrderKind | None = None) -> Order | None:
        """Return the station's next order, marked running; orders without a run (STOP) come first."""
        query = select(orders).where(
            o.state == RunState.QUEUED, *equality_conditions((o.station, station), (o.kind, only))
        )
        with self.database.writing(in_turn=False):
            waiting = self.database.rows(query.order_by(o.created, o.order_id))
            if not waiting:
                return None
            row = min(waiting, key=lambda row: row["kind"] in RUNS)
            self._set([row["order_id"]], state=RunState.RUNNING)
            return _order(row)

    def has_stop(self, station: str) -> bool:
        """Return whether an unanswered stop request exists, by reading alone."""
        waiting = (o.station == station, o.state == RunState.QUEUED, o.kind == OrderKind.STOP)
        return self.database.value(select(o.order_id).where(*waiting).limit(1)) is not None

    def report(self, progress: Progress) -> None:
        """Write the progress of an order; a finished order stays as it ended."""
        open_order = update(orders).where(o.order_id == progress.order_id, o.state.in_(ACTIVE))
        with self.database.writing(in_turn=False):
            values = _progress_values(progress) | {"changed_at": self.settings.clock()}
            if self.database.change(open_order.values(**values)) and progress.signal.t_s:
                self.database.change(delete(run_signals).where(run_signals.c.order_id == progress.order_id))
                signal = vars(progress.signal)
                self.database.change(insert(run_signals).values(order_id=progress.order_id, signal=signal))

    def progress(self, order_id: str) -> Progress:
        """Return how far an order is, with its signal (`InputError`: there is no such order)."""
        with self.database.reading():
            row = self.database.row(select(orders).where(o.order_id == order_id))
            if row is None:
                raise NoSuchOrder(reason("name.no_order", order=repr(order_id)))
            return _progress(row, self._signal(order_id))

    def runs(self, station: str | None = None, count: int = 50, before: int = 0) -> list[tuple[Order, Progress]]:
        """Return `count` orders behind the newest `before` with their progress, newest first, without the signal."""
        query = select(orders).where(*equality_conditions((o.station, station))).order_by(o.created.desc(), o.order_id)
        rows = self.database.rows(query.limit(count).offset(before))
        return [(_order(row), _progress(row, Signal())) for row in rows]

    def list_presses(self, lot_id: str) -> list[UnitPress]:
        """Return the presses of the units of a lot in time order, without aborted runs."""
        query = select(o.serial, o.station, o.actor, o.created, o.changed_at)
        ended = query.where(o.lot_id == lot_id, o.kind == OrderKind.UNIT, o.state == RunState.DONE)
        return [UnitPress(*row.values()) for row in self.database.rows(ended.order_by(o.created, o.order_id))]

    def active(self, station: str) -> tuple[Order, Progress] | None:
        """Return the run that occupies a station, or None."""
        with self.database.reading():
            row = self.database.row(_open_runs(station))
            return None if row is None else (_order(row), _progress(row, self._signal(row["order_id"])))

    def interrupt(self, station: str, message: Reason | str) -> list[str]:
        """Mark orders that a dead service left running as errors; return the order ids.

        What was queued is cancelled: nothing moves because of an old order.
        """
        ended = {RunState.RUNNING: RunState.ERROR, RunState.QUEUED: RunState.CANCELLED}
        unfinished = select(o.order_id, o.state).where(o.station == station, o.state.in_(ACTIVE)).order_by(o.created)
        with self.database.writing(in_turn=False):
            rows = self.database.rows(unfinished)
            for row in rows:
                state = ended[RunState(row["state"])]
                self._set([row["order_id"]], state=state, code="E-INTERRUPTED", message=pack_reasons([message]))
        return [row["order_id"] for row in rows]

    def cancel_queued(self, station: str, message: Reason | str) -> list[str]:
        """Cancel the queued run, as a stop request means that run too; return the order ids."""
        waiting = (o.station == station, o.state == RunState.QUEUED, o.kind.in_(RUNS))
        with self.database.writing(in_turn=False):
            order_ids = self.database.values(select(o.order_id).where(*waiting))
            self._set(order_ids, state=RunState.CANCELLED, code="E-STOPPED", message=pack_reasons([message]))
        return order_ids

    def write_heartbeat(self, heartbeat: Heartbeat, after: timedelta = TAKEOVER_AFTER) -> None:
        """Write a station's heartbeat and state, if the heartbeat of another owner is older than `after`.

        `InputError`: another process serves this station; ports have one owner.
        """
        gate = [[to_stored(c.name), c.is_good, to_stored(c.says)] for c in heartbeat.gate]
        values = vars(heartbeat) | {"reasons": [to_stored(cause) for cause in heartbeat.reasons], "gate": gate}
        where = heartbeats.c.station == heartbeat.station
        with self.database.writing(in_turn=False):
            stored = self.database.row(select(heartbeats).where(where).with_for_update())
            if stored is None:
                if not self.database.insert_new(insert(heartbeats).values(**values)):
                    raise InputError(reason("station.taken", station=repr(heartbeat.station)))
                return
            is_alive = not is_silent(stored["at"], heartbeat.at, after)
            if is_alive and stored["process"] != heartbeat.process and stored["state"] != StationState.OFF:
                raise InputError(reason("station.served", station=repr(heartbeat.station), process=stored["process"]))
            self.database.change(update(heartbeats).where(where).values(**values))

    def heartbeat(self, station: str) -> Heartbeat | None:
        """Return the last sign of life of a station, or None where there never was one."""
        row = self.database.row(select(heartbeats).where(heartbeats.c.station == station))
        return None if row is None else _heartbeat(row)

    def stations(self) -> list[Heartbeat]:
        """Return the last sign of life of every station, by name."""
        return [_heartbeat(row) for row in self.database.rows(select(heartbeats).order_by(heartbeats.c.station))]

    def is_answering(self, station: str) -> bool:
        """Whether a station gave a sign of life in the last seconds."""
        last = self.heartbeat(station)
        return last is not None and not is_silent(last.at, self.settings.clock(), STATION_SILENT_AFTER)

    def _set(self, order_ids: Sequence[str], **values: object) -> None:
        statement = update(orders).where(o.order_id.in_(order_ids))
        self.database.change(statement.values(**values, changed_at=self.settings.clock()))

    def _signal(self, order_id: str) -> Signal:
        signal = self.database.value(select(run_signals.c.signal).where(run_signals.c.order_id == order_id))
        if signal is None:
            return Signal()
        return Signal(**{name: tuple(signal[name]) for name in SIGNAL_FIELDS}, output_unit=signal["output_unit"])


class LineSessions(RegistryBase):
    """State of each line between its runs, one row a station, shared by all screens.

    A change names the version it was decided on: of two screens the second must read again.
    """

    def read(self, station: str) -> tuple[int, Mapping[str, Any]]:
        """Return version and values of a station's place; 0 and nothing before the first."""
        row = self.database.row(select(line_places).where(line_places.c.station == station))
        return (0, {}) if row is None else (row["version"], row["place"])

    def write(self, station: str, expected_version: int, values_at_line: Mapping[str, Any]) -> bool:
        """Replace the values of a row; return False if another writer was first."""
        values = {"station": station, "version": expected_version + 1, "place": dict(values_at_line)}
        is_expected = (line_places.c.station == station, line_places.c.version == expected_version)
        if expected_version:
            return self.database.change(update(line_places).where(*is_expected).values(**values)) == 1
        return self.database.insert_new(insert(line_places).values(**values))


def _open_runs(station: str) -> Select[Any]:
    return select(orders).where(o.station == station, o.state.in_(ACTIVE), o.kind.in_(RUNS))


def _progress_values(progress: Progress) -> dict[str, object]:
    return {name: getattr(progress, name) for name in PROGRESS_FIELDS} | {"message": pack_reasons(progress.message)}


def _order(row: RowMapping) -> Order:
    return Order(**{name: row[name] for name in ORDER_FIELDS} | {"kind": OrderKind(row["kind"])})


def _progress(row: RowMapping, signal: Signal) -> Progress:
    values = {name: row[name] for name in PROGRESS_FIELDS}
    return Progress(**values | {"state": RunState(row["state"])}, signal=signal)


def _heartbeat(row: RowMapping) -> Heartbeat:
    values = dict(row) | {"state": StationState(row["state"]), "reasons": tuple(row["reasons"])}
    return Heartbeat(**values | {"gate": tuple(Condition(*condition) for condition in row["gate"])})
