"""One run on the simulated station with one fault: what the operator reads, when the stage stood, what was kept."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from softcal.core.errors import DeviceError
from softcal.core.messages.reason import Reason
from softcal.core.profiles import Profile, moves
from softcal.station.bench.bench import Bench, open_simulated_bench
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.motion.motion import TICK_S
from softcal.station.record.spool import Spool, read_spool
from softcal.station.tasks.acquisition import RunProgress, record
from softcal.station.tasks.durations import PRESSING, RETURNING
from softcal.station.testing.faults import MOMENTS, Fault

PROFILE: Profile = moves("trial", [0.0, 3.0, 0.0, 3.0, 0.0], [2.0, 2.0, 2.0, 10.0, 10.0], [1.0, 1.0, 0.5, 0.0, 1.0])

HANGS_S = 900.0
"""A run that is not over after so long is never over."""

AT_THE_END = "when the run is closed"
DISK_MOMENTS = (*MOMENTS, AT_THE_END)
"""When a disk can fill up."""

LOOK_S = 0.5
"""How long the load cell is read to compare what it shows with what was said."""

TOLERANCE_N, TOLERANCE_MM, RESTS_N = 0.3, 0.05, 0.08
"""A force that is said may be off by so much (its zero, its noise), a depth by so much. A stage that is called lifted
puts no more force on the unit than this: where a soft unit shows none, no load cell tells whether it is touched."""

COAST_S = 1.0
"""How long the rig is watched after the run gave up: a stage nobody can reach runs out of queued pieces."""


@dataclass(frozen=True)
class FaultOutcome:
    """What one fault did.

    Args:
        fault: its name.
        phase: of the run in which it was seen, "" where that was before the first.
        error: class of the error, "" when the run went through, "hang" when it never ended.
        message: the sentence for the operator.
        detected_s: from the fault to the stop byte, or to the end of the run where none was sent; NaN before a run.
        stopped_s: from the fault to a stage that stands until it is lifted on purpose; NaN before a run.
        largest_force_N: that the unit saw.
        record: "none" (nothing was recorded as good), "good" otherwise.
        spool: how the spool says the run ended.
        reason: the message as a code, for a screen in another language; None where the run went through.
        is_true: whether what it says of the stage is so.
    """

    fault: str
    phase: str
    error: str
    message: str
    detected_s: float
    stopped_s: float
    largest_force_N: float
    record: str
    spool: str
    reason: Reason | None = None
    is_true: bool = True


def run_with_fault(fault: Fault, folder: Path, seed: int = 0) -> FaultOutcome:
    """Press with one fault injected at the wire.

    Args:
        folder: where the spool goes.
        seed: of the simulated station.
    """
    return _run_trial(fault, folder, seed, lambda path: Spool(path, {"serial": "F1"}))


def _run_trial(fault: Fault, folder: Path, seed: int, make_spool: Callable[[Path], Spool]) -> FaultOutcome:
    opened = open_simulated_bench(seed=seed, stage_kind=fault.stage_kind, force_kind=fault.force_kind)
    with opened as (full, station):
        bench = full if fault.has_cell else without_cell(full)
        monitor = _FaultMonitor(station, fault)
        if not fault.phase:
            station.world.at(fault.after_s, monitor.inject)
            station.world.sleep_s(0.001)
        error: DeviceError | None = None
        record_state, is_hanging = "none", False
        path = folder / "run.spool"
        station.world.at(HANGS_S, _hang)
        try:
            with make_spool(path) as spool:
                record(bench, "F1", PROFILE, fault.has_cell, monitor.on_progress, spool)
            record_state = "good"
        except DeviceError as caught:
            error = caught
        except _Hangs:
            is_hanging = True
        ended_s = station.world.now_s()
        is_true = error is None or is_report_true(error, bench, station)
        station.world.sleep_s(COAST_S)
        return FaultOutcome(
            fault.name,
            monitor.phase,
            "hang" if is_hanging else type(error).__name__ if error else "",
            str(error or ""),
            monitor.detected_s(ended_s),
            monitor.stopped_s(),
            station.rig.largest_force_N,
            record_state,
            str(read_spool(path).end) if path.exists() else "no spool",
            error.reason if error else None,
            is_true,
        )


def is_report_true(error: DeviceError, bench: Bench, station: SimulatedStation, zero_N: float = 0.0) -> bool:
    """Whether what a run that was stopped says of its stage is so, by the rig and by what its load cell shows.

    Args:
        zero_N: what the run has taken for the unloaded cell.
    """
    lift_state, shown_N, now_s = error.reason.values.get("state"), list[float](), station.world.now_s()
    if not isinstance(lift_state, Reason):
        return station.rig.carriage_mm <= station.rig.clearance_mm  # Nothing moved.
    try:
        while bench.force is not None and station.world.now_s() < now_s + LOOK_S:
            station.world.sleep_s(TICK_S)
            shown_N += [sample.values[0] - zero_N for sample in bench.force.poll()]
    except DeviceError:
        pass  # Then it must be the truth.
    rig = station.rig
    rig.read(station.world.now_s())
    if rig.axis.is_moving and lift_state.code not in ("left.runs_on", "left.unreachable"):
        return False
    mean_N = [sum(shown_N) / len(shown_N)] if shown_N else []
    return is_true(lift_state, (rig._force_N, *mean_N), rig.axis.position_mm)


def is_true(lift_state: Reason, force_N: Sequence[float], counted_mm: float) -> bool:
    """Whether a sentence about the stage is so.

    Args:
        left: what became of the stage.
        force_N: true force on the unit, and what the load cell shows: a sentence may give either.
        counted_mm: position by the controller's count.
    """
    if lift_state.code in ("left.lifted", "left.lifted_roughly"):
        return force_N[0] <= RESTS_N
    reported_N, reported_mm = lift_state.values.get("force_N"), lift_state.values.get("at_mm", counted_mm)
    is_force_so = reported_N is None or any(abs(float(reported_N) - newton) <= TOLERANCE_N for newton in force_N)  # type: ignore[arg-type]
    inner = lift_state.values.get("state")
    is_inner_so = not isinstance(inner, Reason) or is_true(inner, force_N, counted_mm)
    return is_force_so and is_inner_so and abs(float(reported_mm) - counted_mm) <= TOLERANCE_MM  # type: ignore[arg-type]


def without_cell(bench: Bench) -> Bench:
    safety = replace(bench.config.safety, without_cell=True)
    return replace(bench, force=None, config=replace(bench.config, force=None, safety=safety))


def _hang() -> None:
    raise _Hangs


def run_with_full_disk(folder: Path, moment: str = "while pressing", seed: int = 0) -> FaultOutcome:
    """Press while the disk fills up: from that moment on the spool's next line cannot be written.

    Args:
        moment: one of DISK_MOMENTS.
    """
    spool: list[FillingSpool] = []

    def make_spool(path: Path) -> Spool:
        spool.append(FillingSpool(path, {"serial": "F1"}, is_full_at_end=moment == AT_THE_END))
        return spool[0]

    phase, after_s = MOMENTS.get(moment, (RETURNING, 1e6))
    fault = Fault(f"disk full {moment}", phase, after_s, lambda station: spool[0].fill())
    return _run_trial(fault, folder, seed, make_spool)


def run_with_dead_host(folder: Path, seed: int = 0) -> FaultOutcome:
    """Press until the host process is gone from one instant to the next: nothing is read or sent any more."""
    path = folder / "run.spool"
    with open_simulated_bench(seed=seed) as (bench, station):
        died_s = float("nan")
        spool_end = ""

        def on_progress(progress: RunProgress) -> None:
            nonlocal died_s, spool_end
            if progress.phase != PRESSING or progress.stage_mm < station.free_mm + 2.0:
                return
            died_s = station.world.now_s()
            station.world.sleep_s(COAST_S)
            spool_end = str(read_spool(path).end)
            raise _HostDied

        try:
            with Spool(path, {"serial": "F1"}) as spool:
                record(bench, "F1", PROFILE, True, on_progress, spool)
        except _HostDied:
            pass
        standstill_s = max(0.0, station.axis.standstills_s[-1] - died_s)
        message = "the station's service was started again; press the unit again"
        force_N = station.rig.largest_force_N
        return FaultOutcome(
            "host process killed while pressing",
            PRESSING,
            "none",
            message,
            0.0,
            standstill_s,
            force_N,
            "none",
            spool_end,
        )


class _Hangs(BaseException):
    """Far more time has passed than any run takes."""


class _HostDied(BaseException):
    """The host is gone; what follows in this process is no part of the trial."""


class FillingSpool(Spool):
    """A spool whose disk can fill up, on demand or when the run says its last."""

    _is_filled = False

    def __init__(self, path: Path, header: dict[str, str], is_full_at_end: bool) -> None:
        super().__init__(path, header)
        self._is_full_at_end, self._before = is_full_at_end, self._file

    def add_metadata(self, metadata: dict[str, Any]) -> None:
        if self._is_full_at_end:
            self.fill()
        super().add_metadata(metadata)

    def fill(self) -> None:
        # The file of before stays open: the writing thread may be in the middle of a line.
        self._before, self._file = self._file, Path("/dev/full").open("ab")
        self._is_filled = True

    def _write_line(self, value: dict[str, Any]) -> None:
        super()._write_line(value)
        # Simulated time stands still meanwhile: on a busy machine much of it would pass before the line is written.
        while self._is_filled and self._error is None and self._thread.is_alive():
            time.sleep(0.0005)

    def __exit__(self, *exception: Any) -> None:
        try:
            super().__exit__(*exception)
        finally:
            self._before.close()


class _FaultMonitor:
    def __init__(self, station: SimulatedStation, fault: Fault) -> None:
        self._station, self._fault = station, fault
        self._stage = station.stage if fault.stage_kind == "grbl" else None
        self._at_s: float | None = None
        self._is_planned = not fault.phase
        self.phase = ""

    def on_progress(self, progress: RunProgress) -> None:
        self.phase = progress.phase
        if not self._is_planned and progress.phase == self._fault.phase:
            self._is_planned = True
            self._station.world.at(self._station.world.now_s() + self._fault.after_s, self.inject)

    def inject(self) -> None:
        self._at_s = self._station.world.now_s()
        if self._stage is not None:
            self._stage.stop_received_s = None
        self._fault.inject(self._station)

    def detected_s(self, ended_s: float) -> float:
        if self._at_s is None or not self._fault.phase:
            return float("nan")
        stop_s = None if self._stage is None else self._stage.stop_received_s
        return (ended_s if stop_s is None else stop_s) - self._at_s

    def stopped_s(self) -> float:
        """When the stage came to rest for good: at the stop byte, before it, or without one."""
        if self._at_s is None or not self._fault.phase or self._stage is None:
            return float("nan")
        stop_s, standstills = self._stage.stop_received_s, self._station.axis.standstills_s
        if stop_s is not None and self._stage.was_moving_at_stop:
            rest_s = min(stand_s for stand_s in standstills if stand_s >= stop_s)
        else:
            rest_s = max((s for s in standstills if stop_s is None or s <= stop_s), default=0.0)
        return max(0.0, rest_s - self._at_s)
