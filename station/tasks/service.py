"""The owner of a station: one order at a time, one sentence for every stop. No database here."""

import math
import re
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path

from softcal.core.errors import BadReply, CommandRefused, DeviceError, NoReply, SafetyStop, SoftcalError
from softcal.core.lot import check_serial
from softcal.core.messages.reason import Reason, reason, root_of, several
from softcal.core.orders import Order, OrderKind, Progress, RunState, Signal, StationState
from softcal.core.profiles import Profile
from softcal.core.quality.gate import Gate, RigStatus
from softcal.core.quality.reading_at_rest import ReadingConfig
from softcal.station.bench.bench import Bench
from softcal.station.device_names import device_label
from softcal.station.devices.config import LATEST_S
from softcal.station.interfaces import Reader
from softcal.station.motion.motion import Cancelled
from softcal.station.record.recording import StationRecording
from softcal.station.record.spool import Spool
from softcal.station.tasks.acquisition import RunProgress, ZeroMoved, record
from softcal.station.tasks.at_rest import RestReading, read_at_rest
from softcal.station.tasks.durations import HOMING
from softcal.station.tasks.self_test import SelfTestItem, self_test

CODES: Mapping[type[SoftcalError], str] = {
    ZeroMoved: "E-ZERO",
    CommandRefused: "E-REFUSED",
    BadReply: "E-REPLY",
    NoReply: "E-SILENT",
    SafetyStop: "E-SAFETY",
    DeviceError: "E-DEVICE",
}
"""Stable code of the message for each kind of error; the screen's catalogue is keyed by it."""

SIGNAL_POINTS = 400

READING = "reading at rest"

CHECK_S = 12.0
"""How long a self-test takes, about."""

SILENT_S = 2.0
"""A stream that is silent for so long between runs is gone; in a run the bounds are far tighter."""


@dataclass(frozen=True)
class Hooks:
    """Callbacks from the service to its host.

    Args:
        report: takes progress; called about ten times a second of station time.
        is_stop_requested: whether a stop of the run in progress was requested; called at every poll of the devices.
        gate: whether an order of this kind may run now, with this rig.
    """

    report: Callable[[Progress], None]
    is_stop_requested: Callable[[], bool]
    gate: Callable[[OrderKind, RigStatus], Gate]


class StationService:
    """Owns the ports of one station and performs orders.

    STARTING → READY ⇄ RUNNING; an error in a run leads to STOPPED, where nothing moves until it is acknowledged.
    CLOSED is READY with a closed gate: golden units and self-tests still run.

    Args:
        open_bench: opens the devices; called again after an acknowledged fault, since ports may have died.
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
        self._started_s = time.monotonic()
        self._newest_s: dict[str, float] = {}
        self._cell_clock_s = self._zero_return_N = 0.0
        self._homing_fault: Reason | None = None
        self._zero_fault: Reason | None = None
        self.state = StationState.STARTING
        self.reasons: tuple[Reason, ...] = ()
        self.gate = Gate()
        self.findings: list[SelfTestItem] = []

    @property
    def rig(self) -> RigStatus:
        # Opening its port resets an Arduino's clock though its cell stays powered: the longer of the two is true.
        powered_s = max(self._cell_clock_s, time.monotonic() - self._started_s)
        is_homed = self._bench is not None and self._bench.stage.is_position_known
        return RigStatus(
            timedelta(seconds=powered_s), is_homed, self._homing_fault, self._zero_fault, self._zero_return_N
        )

    def start(self) -> None:
        """Open the ports; where devices are missing the station stops, and names them all."""
        self._open.close()
        self._bench, self.state = None, StationState.STARTING
        try:
            self._bench = self._open.enter_context(self._open_bench())
        except DeviceError as error:
            self.state, self.reasons = StationState.STOPPED, (error.reason,)
            return
        self._newest_s = {}
        self.settle()

    def settle(self) -> None:
        """Check the gate again, between orders."""
        if self.state in (StationState.STOPPED, StationState.RUNNING):
            return
        self.gate = self._hooks.gate(OrderKind.UNIT, self.rig)
        self.state = StationState.READY if self.gate.is_open else StationState.CLOSED
        self.reasons = self.gate.reasons

    def poll_idle(self, seconds: float) -> None:
        """Wait a short time between orders and read all devices, so that a lost device is reported at once."""
        bench = self._bench
        if bench is None or self.state not in (StationState.READY, StationState.CLOSED):
            return
        try:
            bench.clock.sleep_s(seconds)
            was_homed = bench.stage.is_position_known
            try:
                bench.stage.poll()
            except DeviceError as error:
                # A stage that was never homed is locked, and says so; that is no news.
                if was_homed or isinstance(error, NoReply):
                    raise
            for reader in (bench.readout, bench.force):
                if reader is not None:
                    self._listen(bench, reader)
        except DeviceError as error:
            self.state, self.reasons = StationState.STOPPED, (error.reason,)

    def perform(self, order: Order) -> StationRecording | RestReading | None:
        """Perform one order and return the recorded run, which the host stores and reports as done.

        Every other outcome is reported here.
        """
        if order.kind is OrderKind.ACKNOWLEDGE:
            self.start()  # Somebody has read why it stopped; the next run homes first.
            self._end(order, RunState.DONE, "", (Reason("run.acknowledged"),))
            return None
        if self.state is StationState.STOPPED or self._bench is None:
            refusal = (*(reason("rig.stopped", why=cause) for cause in self.reasons), Reason("rig.acknowledge"))
        else:
            gate = self._hooks.gate(order.kind, self.rig)
            refusal = () if gate.is_open else gate.reasons
        if refusal:
            self._end(order, RunState.ERROR, "E-GATE", refusal)
            return None
        relay = _Relay(order, self._hooks)
        try:
            self.state, self.reasons = StationState.RUNNING, ()
            self._newest_s = {}  # In a run the acquisition listens.
            return self._run(order, relay)
        except Cancelled as error:
            self._stop(order, RunState.CANCELLED, "E-STOPPED", error)
        except SoftcalError as error:
            # This closes the gate until a self-test is good.
            if isinstance(error, ZeroMoved):
                self._zero_fault = root_of(error.reason)
            elif relay.phase == HOMING:
                self._homing_fault = root_of(error.reason)
            code = next(code for kind, code in CODES.items() if isinstance(error, kind) or kind is DeviceError)
            self._stop(order, RunState.ERROR, code, error)
        except Exception:
            self.state, self.reasons = StationState.STOPPED, (Reason("rig.defect"),)
            raise
        return None

    def spool_path(self, order: Order) -> Path:
        """Return where the samples of an order go, until the host has stored the recording."""
        name = re.sub(r"[^A-Za-z0-9-]", "_", order.order_id)[:64]
        return self._spool_folder / f"{check_serial(order.serial)}-{name}.spool"

    def close(self) -> None:
        self._open.close()
        self._bench = None
        self.state = StationState.OFF

    def _listen(self, bench: Bench, reader: Reader) -> None:
        now_s = bench.clock.now_s()
        try:
            samples = reader.poll()
        except BadReply:
            # A hand at the fixture saturates a cell, a restart sets a clock back: it speaks, the next run will judge.
            reader.start()
            self._newest_s[reader.name] = now_s
            return
        if samples:
            self._newest_s[reader.name] = now_s
            if reader is bench.force and samples[-1].device_s is not None:
                self._cell_clock_s = samples[-1].device_s
        silent_s = now_s - self._newest_s.setdefault(reader.name, now_s)
        if silent_s > SILENT_S:
            raise NoReply(reason("rig.silent.between", device=device_label(reader.name), seconds=silent_s))

    def _run(self, order: Order, relay: "_Relay") -> StationRecording | RestReading | None:
        bench = self._bench
        if bench is None:
            raise NoReply(Reason("rig.no_devices"))
        if order.kind is OrderKind.CHECK:
            self._hooks.report(Progress(order.order_id, RunState.RUNNING, "self-test", 0.0, CHECK_S))
            self.findings = self_test(bench, on_wait=relay.check_stop)
            faults = [
                reason("rig.self_test", device=f.device, what=f.what, value=f.value, cure=f.cure)
                for f in self.findings
                if f.cure is not None
            ]
            if faults:
                raise BadReply(several(faults))
            self._homing_fault = self._zero_fault = None
            self._zero_return_N = 0.0
            self._end(order, RunState.DONE, "", (Reason("rig.all_good"),))
            self.state = StationState.READY  # The gate is asked between orders.
            return None
        if order.kind is OrderKind.LOAD:
            config = ReadingConfig()
            reading = read_at_rest(bench, order.serial, config.settle_s, config.reading_s, relay.on_reading)
            self.state = StationState.READY  # The gate is asked between orders.
            return reading
        with_reference = order.kind in (OrderKind.SOURCE, OrderKind.GOLDEN)
        header = {"serial": order.serial, "order": order.order_id, "station": order.station, "lot": order.lot_id}
        profile = self._profiles[order.kind]
        with Spool(self.spool_path(order), header | {"kind": order.kind, "profile": profile.name}) as spool:
            recording = record(bench, order.serial, profile, with_reference, relay.on_progress, spool, relay.check_stop)
        self._zero_return_N = recording.zero_return_N
        # Later runs are held to how late a good one found the cell, until the ports open again.
        force, behind_s = bench.config.force, recording.alignment.force_behind_s
        if force is not None and not force.is_latency_declared and math.isfinite(behind_s):
            declared = replace(force, latency_s=min(max(0.0, behind_s), LATEST_S))
            self._bench = replace(bench, config=replace(bench.config, force=declared))
        self.state = StationState.READY  # The gate is asked between orders.
        return recording

    def _stop(self, order: Order, state: RunState, code: str, error: SoftcalError) -> None:
        self.state, self.reasons = StationState.STOPPED, (error.reason,)
        self._end(order, state, code, (error.reason,))

    def _end(self, order: Order, state: RunState, code: str, message: tuple[Reason, ...]) -> None:
        self._hooks.report(Progress(order.order_id, state, "", 1.0, 0.0, code, message))


class _Relay:
    """Run progress in, order progress out, with the newest stretch of the signal."""

    def __init__(self, order: Order, hooks: Hooks) -> None:
        self._order, self._hooks = order, hooks
        self._points: deque[tuple[float, float, float, float | None]] = deque(maxlen=SIGNAL_POINTS)
        self._unit = ""
        self._reported_step = -1
        self.phase = ""

    def check_stop(self) -> None:
        """Raise `Cancelled` if a stop was requested."""
        if self._hooks.is_stop_requested():
            raise Cancelled(Reason("rig.by_hand"))

    def on_progress(self, progress: RunProgress) -> None:
        self.phase = progress.phase
        if progress.output is not None:
            self._points.append((progress.t_s, progress.output, progress.stage_mm, progress.force_N))
            self._unit = progress.output_unit
        # Before the cell's first sample there is no force to draw.
        points, signal = [point for point in self._points if point[3] is not None] or list(self._points), Signal()
        if points:
            t_s, output, stage_mm, force_N = zip(*points, strict=True)
            signal = Signal(t_s, output, stage_mm, () if force_N[0] is None else force_N, self._unit)
        state = (progress.phase, progress.fraction, progress.remaining_s)
        self._hooks.report(Progress(self._order.order_id, RunState.RUNNING, *state, signal=signal))

    def on_reading(self, fraction: float, remaining_s: float) -> None:
        self.check_stop()
        # Ten times a second is enough for a screen.
        if (step := int(remaining_s * 10)) != self._reported_step:
            self._reported_step = step
            self._hooks.report(Progress(self._order.order_id, RunState.RUNNING, READING, fraction, remaining_s))
