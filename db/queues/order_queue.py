"""Orders to stations, the progress of their runs and the stations' heartbeats, as rows that page and station share.

A page writes an order and reads progress; the station takes orders and writes progress. Neither needs the other to be
there. One run at a time per station is a unique index of the database, not a rule of a program.
"""

import time
from dataclasses import fields
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import RowMapping, Select, delete, insert, select, update
from sqlalchemy.exc import IntegrityError

from softcal.core.errors import InputError
from softcal.core.orders import Condition, Heartbeat, Order, OrderKind, Progress, RunState, Signal, StationState
from softcal.core.words.reason import Reason, packed, reason, to_kept
from softcal.db.schema.database import OncePerCut
from softcal.db.schema.tables import heartbeats, orders, run_signals

SILENT_AFTER = timedelta(seconds=3)
"""A station whose last heartbeat is older is not there, as far as a screen can see."""

TAKEN_OVER_AFTER = timedelta(seconds=15)
"""Another process may serve a station whose heartbeat is older. A busy machine keeps a service from its beat for
seconds: it must not lose its rig for that."""

ORDER_FIELDS = ("order_id", "station", "kind", "serial", "lot_id", "actor", "reason", "created")
PROGRESS_FIELDS = tuple(field.name for field in fields(Progress) if field.name != "signal")
SIGNAL_FIELDS = ("t_s", "output", "stage_mm", "force_N")
RUNS = tuple(kind for kind in OrderKind if kind.is_run)


class Pressed(NamedTuple):
    """One press of a unit at the line: where, by whom, and from when until when (UTC)."""

    serial: str
    station: str
    actor: str
    begun: datetime
    ended: datetime


class OrderQueue(OncePerCut):
    """Orders, runs and heartbeats of the stations of a registry. Every call is one short transaction."""

    def place(self, order: Order, until_s: float | None = None) -> bool:
        """Ask a station for something; the same order id again changes nothing.

        Args:
            until_s: `time.monotonic()` after which it is not asked any more, however long the registry was busy.

        Returns:
            Whether it was asked in time.

        Raises:
            InputError: the station has a run that is not over.
        """
        values = {name: getattr(order, name) for name in ORDER_FIELDS} | {"created": order.created or self._clock()}
        progress = _progress_values(Progress(order.order_id, RunState.QUEUED))
        with self.database.writing(in_turn=False) as connection:
            known = select(orders.c.order_id).where(orders.c.order_id == order.order_id)
            if connection.execute(known).first() is not None:
                return True
            # Looked at behind the wait for other writers, which is where the time goes.
            if until_s is not None and time.monotonic() > until_s:
                return False
            try:
                with connection.begin_nested():
                    connection.execute(insert(orders).values(**values | progress, changed_at=self._clock()))
            except IntegrityError as error:
                row = connection.execute(_open_runs(order.station)).mappings().one()
                what = f"{row['kind']} {row['serial']}".strip()
                busy = reason("station.busy", station=repr(order.station), what=what, state=row["state"])
                raise InputError(busy) from error
            return True

    def take(self, station: str, only: OrderKind | None = None) -> Order | None:
        """Return the station's next order and mark it running; what is no run (STOP) comes before everything else."""
        query = select(orders).where(orders.c.station == station, orders.c.state == RunState.QUEUED)
        query = query if only is None else query.where(orders.c.kind == only)
        with self.database.writing(in_turn=False) as connection:
            found = connection.execute(query.order_by(orders.c.created, orders.c.order_id)).mappings().all()
            if not found:
                return None
            row = min(found, key=lambda row: row["kind"] in RUNS)
            running = {"state": RunState.RUNNING, "changed_at": self._clock()}
            connection.execute(update(orders).where(orders.c.order_id == row["order_id"]).values(**running))
            return _order(row)

    def has_stop(self, station: str) -> bool:
        """Return whether somebody said stop and was not answered yet. It only reads."""
        waiting = (orders.c.station == station, orders.c.state == RunState.QUEUED, orders.c.kind == OrderKind.STOP)
        return self.database.row(select(orders.c.order_id).where(*waiting).limit(1)) is not None

    def report(self, progress: Progress) -> None:
        """Write how far an order is. An order that is over stays as it ended."""
        with self.database.writing(in_turn=False) as connection:
            values = _progress_values(progress) | {"changed_at": self._clock()}
            open_order = update(orders).where(
                orders.c.order_id == progress.order_id, orders.c.state.in_([RunState.QUEUED, RunState.RUNNING])
            )
            if connection.execute(open_order.values(**values)).rowcount and progress.signal.t_s:
                connection.execute(delete(run_signals).where(run_signals.c.order_id == progress.order_id))
                signal = vars(progress.signal)
                connection.execute(insert(run_signals).values(order_id=progress.order_id, signal=signal))

    def progress(self, order_id: str) -> Progress:
        """Return how far an order is, with its live signal.

        Raises:
            InputError: there is no such order.
        """
        with self.database.reading():
            row = self.database.row(select(orders).where(orders.c.order_id == order_id))
            if row is None:
                raise InputError(reason("name.no_order", order=repr(order_id)))
            return _progress(row, self._signal(order_id))

    def runs(self, station: str | None = None, count: int = 50) -> list[tuple[Order, Progress]]:
        """Return the newest orders with their progress, newest first, without the live signal."""
        query = select(orders).order_by(orders.c.created.desc(), orders.c.order_id).limit(count)
        query = query if station is None else query.where(orders.c.station == station)
        return [(_order(row), _progress(row, Signal())) for row in self.database.rows(query)]

    def pressed(self, lot_id: str) -> list[Pressed]:
        """Return which units of a lot were pressed where and by whom, in time order; broken runs are left out."""
        o = orders.c
        query = select(o.serial, o.station, o.actor, o.created, o.changed_at)
        ended = query.where(o.lot_id == lot_id, o.kind == OrderKind.UNIT, o.state == RunState.DONE)
        return [Pressed(*row.values()) for row in self.database.rows(ended.order_by(o.created, o.order_id))]

    def active(self, station: str) -> tuple[Order, Progress] | None:
        """Return the run that occupies a station, or None."""
        with self.database.reading():
            row = self.database.row(_open_runs(station))
            return None if row is None else (_order(row), _progress(row, self._signal(row["order_id"])))

    def interrupt(self, station: str, message: Reason | str) -> list[str]:
        """Mark what a station left running when it died as an error; return the order ids.

        Called by a station that starts. What was queued is cancelled: nothing moves because of an old order.
        """
        ended = {RunState.RUNNING: RunState.ERROR, RunState.QUEUED: RunState.CANCELLED}
        left = select(orders.c.order_id, orders.c.state).where(
            orders.c.station == station, orders.c.state.in_(list(ended))
        )
        with self.database.writing(in_turn=False) as connection:
            rows = connection.execute(left.order_by(orders.c.created)).all()
            for order_id, state in rows:
                values = {"state": ended[RunState(state)], "code": "E-INTERRUPTED", "message": packed([message])}
                mine = update(orders).where(orders.c.order_id == order_id)
                connection.execute(mine.values(**values, changed_at=self._clock()))
        return [order_id for order_id, _ in rows]

    def cancel_queued(self, station: str, message: Reason | str) -> list[str]:
        """Cancel the run that waits, if there is one: whoever says stop means that one too. Return the order ids."""
        waiting = (orders.c.station == station, orders.c.state == RunState.QUEUED, orders.c.kind.in_(RUNS))
        with self.database.writing(in_turn=False) as connection:
            order_ids = list(connection.execute(select(orders.c.order_id).where(*waiting)).scalars())
            values = {"state": RunState.CANCELLED, "code": "E-STOPPED", "message": packed([message])}
            mine = update(orders).where(orders.c.order_id.in_(order_ids))
            connection.execute(mine.values(**values, changed_at=self._clock()))
        return order_ids

    def beat(self, heartbeat: Heartbeat, after: timedelta = TAKEN_OVER_AFTER) -> None:
        """Write that a station lives and what it does.

        Args:
            after: how old the beat of another owner must be; zero for who knows that its process is gone.

        Raises:
            InputError: another process serves this station; ports have one owner.
        """
        gate = [[to_kept(c.name), c.is_good, to_kept(c.says)] for c in heartbeat.gate]
        values = vars(heartbeat) | {"reasons": [to_kept(why) for why in heartbeat.reasons], "gate": gate}
        where = heartbeats.c.station == heartbeat.station
        with self.database.writing(in_turn=False) as connection:
            known = connection.execute(select(heartbeats).where(where).with_for_update()).mappings().first()
            if known is None:
                try:
                    connection.execute(insert(heartbeats).values(**values))
                except IntegrityError as error:
                    raise InputError(reason("station.taken", station=repr(heartbeat.station))) from error
                return
            is_alive = heartbeat.at - known["at"] <= after
            if is_alive and known["process"] != heartbeat.process and known["state"] != StationState.OFF:
                raise InputError(reason("station.served", station=repr(heartbeat.station), process=known["process"]))
            connection.execute(update(heartbeats).where(where).values(**values))

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
        return last is not None and self._clock() - last.at <= SILENT_AFTER

    def _signal(self, order_id: str) -> Signal:
        row = self.database.row(select(run_signals.c.signal).where(run_signals.c.order_id == order_id))
        if row is None:
            return Signal()
        kept = row["signal"]
        return Signal(**{name: tuple(kept[name]) for name in SIGNAL_FIELDS}, output_unit=kept["output_unit"])


def _open_runs(station: str) -> Select[Any]:
    open_states = orders.c.state.in_([RunState.QUEUED, RunState.RUNNING])
    return select(orders).where(orders.c.station == station, open_states, orders.c.kind.in_(RUNS))


def _progress_values(progress: Progress) -> dict[str, object]:
    return {name: getattr(progress, name) for name in PROGRESS_FIELDS} | {"message": packed(progress.message)}


def _order(row: RowMapping) -> Order:
    return Order(**{name: row[name] for name in ORDER_FIELDS} | {"kind": OrderKind(row["kind"])})


def _progress(row: RowMapping, signal: Signal) -> Progress:
    facts = {name: row[name] for name in PROGRESS_FIELDS}
    return Progress(**facts | {"state": RunState(row["state"])}, signal=signal)


def _heartbeat(row: RowMapping) -> Heartbeat:
    facts = dict(row) | {"state": StationState(row["state"]), "reasons": tuple(row["reasons"])}
    return Heartbeat(**facts | {"gate": tuple(Condition(*condition) for condition in row["gate"])})
