"""The resident owner of a station: one order at a time, one sentence for every stop. No database, no page here."""

import re
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softcal.core.errors import (
    BadReply,
    CommandRefused,
    DeviceError,
    NoReply,
    SafetyStop,
    SoftcalError,
)
from softcal.core.lot import check_serial
from softcal.core.orders import Order, OrderKind, Progress, RunState, Signal, StationState
from softcal.core.profiles import Profile
from softcal.core.station_gate import Gate
from softcal.station.acquisition import RunProgress, record
from softcal.station.bench import Bench
from softcal.station.recording import StationRecording
from softcal.station.self_test import Finding, self_test
from softcal.station.spool import Spool

CODES: Mapping[type[SoftcalError], str] = {
    CommandRefused: "E-REFUSED",
    BadReply: "E-REPLY",
    NoReply: "E-SILENT",
    SafetyStop: "E-SAFETY",
    DeviceError: "E-DEVICE",
}
"""Stable code of the message for each kind of error; the screen's catalogue is keyed by it."""

SIGNAL_POINTS = 400


class Cancelled(DeviceError):
    """Somebody asked for a stop."""


@dataclass(frozen=True)
class Hooks:
    """What the service needs from whoever hosts it.

    Args:
        report: takes progress; called about ten times a second of station time.
        is_stop_wanted: whether somebody asked to stop the run in progress.
        gate: whether an order of this kind may run now.
    """

    report: Callable[[Progress], None]
    is_stop_wanted: Callable[[], bool]
    gate: Callable[[OrderKind], Gate]


class StationService:
    """Owns the ports of one station and performs orders.

    STARTING → READY ⇄ RUNNING; an error in a run leads to STOPPED, where nothing moves until it is acknowledged.
    CLOSED is READY with a closed gate: golden units and self-tests still run.

    Args:
        open_bench: opens the devices; called again after an acknowledged fault, since ports may have died.
        profiles: profile per kind of order.
        spool_folder: where samples go as they come.
        hooks: the host.
    """

    def __init__(
        self,
        open_bench: Callable[[], AbstractContextManager[Bench]],
        profiles: Mapping[OrderKind, Profile],
        spool_folder: Path,
        hooks: Hooks,
    ) -> None:
        self._open_bench, self._profiles, self._spool_folder, self._hooks = open_bench, profiles, spool_folder, hooks
        self._open = ExitStack()
        self._bench: Bench | None = None
        self.state = StationState.STARTING
        self.reasons: tuple[str, ...] = ()
        self.findings: list[Finding] = []

    def start(self) -> None:
        """Open the ports; a device that is missing leaves the station stopped, with all of them named."""
        self._open.close()
        self._bench, self.state = None, StationState.STARTING
        try:
            self._bench = self._open.enter_context(self._open_bench())
        except DeviceError as error:
            self.state, self.reasons = StationState.STOPPED, (str(error),)
            return
        self.settle()

    def settle(self) -> None:
        """Look at the gate again, between orders."""
        if self.state in (StationState.STOPPED, StationState.RUNNING):
            return
        gate = self._hooks.gate(OrderKind.UNIT)
        self.state = StationState.READY if gate.is_open else StationState.CLOSED
        self.reasons = gate.reasons

    def acknowledge(self) -> None:
        """Somebody has read why the station stopped: open the ports again; the next run homes first."""
        self.start()

    def perform(self, order: Order) -> StationRecording | None:
        """Perform one order; every outcome but a good recording is reported here.

        Returns:
            The recording of a run that went through: the host stores it and reports it done. None otherwise.
        """
        if order.kind is OrderKind.ACKNOWLEDGE:
            self.acknowledge()
            self._end(order, RunState.DONE, "", "acknowledged")
            return None
        refusal = self._refusal(order)
        if refusal:
            self._end(order, RunState.ERROR, "E-GATE", refusal)
            return None
        try:
            self.state, self.reasons = StationState.RUNNING, ()
            return self._run(order)
        except Cancelled as error:
            self._stop(order, RunState.CANCELLED, "E-STOPPED", error)
        except SoftcalError as error:
            self._stop(order, RunState.ERROR, _code(error), error)
        return None

    def spool_path(self, order: Order) -> Path:
        """Return where the samples of an order go; the host removes it once the recording is stored."""
        name = re.sub(r"[^A-Za-z0-9-]", "_", order.order_id)[:64]
        return self._spool_folder / f"{check_serial(order.serial)}-{name}.spool"

    def close(self) -> None:
        """Give the ports back."""
        self._open.close()
        self._bench = None
        self.state = StationState.OFF

    def _refusal(self, order: Order) -> str:
        if self.state is StationState.STOPPED or self._bench is None:
            return f"the station is stopped: {'; '.join(self.reasons)}; acknowledge first"
        gate = self._hooks.gate(order.kind)
        return "" if gate.is_open else "; ".join(gate.reasons)

    def _run(self, order: Order) -> StationRecording | None:
        bench = self._bench
        if bench is None:
            raise NoReply("the station has no open devices; acknowledge first")
        if order.kind is OrderKind.CHECK:
            self.findings = self_test(bench)
            faults = [f"{f.device}, {f.what}: {f.cure}" for f in self.findings if not f.is_good]
            if faults:
                raise BadReply("; ".join(faults))
            self._end(order, RunState.DONE, "", "all devices are good")
            self._ready()
            return None
        relay = _Relay(order, self._hooks, bench.readout.unit)
        with_reference = order.kind in (OrderKind.SOURCE, OrderKind.GOLDEN)
        path = self.spool_path(order)
        header = {"serial": order.serial, "order": order.order_id, "station": order.station, "lot": order.lot_id}
        with Spool(path, header | {"kind": order.kind, "profile": self._profiles[order.kind].name}) as spool:
            recording = record(
                bench, order.serial, self._profiles[order.kind], with_reference, relay.on_progress, spool
            )
        self._ready()
        return recording

    def _ready(self) -> None:
        self.state = StationState.READY
        self.settle()

    def _stop(self, order: Order, state: RunState, code: str, error: SoftcalError) -> None:
        self.state, self.reasons = StationState.STOPPED, (str(error),)
        self._end(order, state, code, str(error))

    def _end(self, order: Order, state: RunState, code: str, message: str) -> None:
        self._hooks.report(Progress(order.order_id, state, "", 1.0, 0.0, code, message))


class _Relay:
    """Run progress in, order progress out, with the newest stretch of the signal."""

    def __init__(self, order: Order, hooks: Hooks, output_unit: str) -> None:
        self._order, self._hooks, self._output_unit = order, hooks, output_unit
        self._points: deque[tuple[float, float, float, float]] = deque(maxlen=SIGNAL_POINTS)

    def on_progress(self, progress: RunProgress) -> None:
        if self._hooks.is_stop_wanted():
            raise Cancelled("stopped by a person")
        force_N = float("nan") if progress.force_N is None else progress.force_N
        self._points.append((progress.t_s, progress.output, progress.stage_mm, force_N))
        self._hooks.report(
            Progress(
                self._order.order_id,
                RunState.RUNNING,
                progress.phase,
                progress.fraction,
                progress.remaining_s,
                signal=self._signal(),
            )
        )

    def _signal(self) -> Signal:
        points = np.array(self._points)
        t_s, output, stage_mm, force_N = (tuple(column.tolist()) for column in points.T)
        has_force = not np.isnan(points[-1, 3])
        return Signal(t_s, output, stage_mm, force_N if has_force else (), self._output_unit)


def _code(error: SoftcalError) -> str:
    return CODES.get(type(error), CODES[DeviceError])
