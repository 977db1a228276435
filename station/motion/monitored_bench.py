"""A bench whose readings are stored and monitored while its stage moves, for runs and self-tests."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from softcal.core.errors import BadReply, DeviceError, NoReply, SafetyStop
from softcal.core.messages.reason import reason
from softcal.station.bench.bench import Bench
from softcal.station.devices.config import LATEST_S
from softcal.station.interfaces import Sample, StagePosition
from softcal.station.motion.bounds import FULL, REACTION_S, ForceBounds, Reaction
from softcal.station.motion.contact import unloaded
from softcal.station.motion.interlock import AllowedMotion, StageMonitor, State
from softcal.station.motion.monitors import (
    FROZEN,
    LAGS_S,
    STUCK_MM,
    STUCK_OUTPUT_MM,
    SUDDEN_N,
    FollowMonitor,
    ForceMonitor,
    JumpMonitor,
    StreamMonitor,
    StuckMonitor,
)
from softcal.station.motion.motion import TICK_S, Motion
from softcal.station.record.spool import Spool

PAUSE_S, CAUGHT_UP_S = 0.25, 1.5
"""A host that looks at nothing for so long stood still. Lines that are full lose samples: for so long afterwards a
stream that is late or at another rate is the host's doing, samples that are lost at any time."""

LASTING = frozenset({"rig.lost", "rig.gap"})
RECENT = LASTING | {"rig.old", "rig.rate", "rig.library.silent"}

BOOT_S = 3.0
"""How long a board may take to boot: 1.5 s to 2 s for an Arduino with its boot loader."""


@dataclass
class Readings:
    """All readings in order of arrival."""

    output: list[Sample] = field(default_factory=list)
    force: list[Sample] = field(default_factory=list)
    polls: list[StagePosition] = field(default_factory=list)


@dataclass
class RunEstimates:
    """Quantities that a run has measured so far, None before; a state requires some of them.

    Args:
        free_N, zero_N: the force in an empty path, and of the unloaded cell.
        contact_mm: where the unit's surface is.
        probed_mm: so deep the unit was pressed slowly: what lies above holds no surprise.
        safe_mm_s: fastest speed down to there that a stop can hold.
        late_s: how late the load cell is.
    """

    free_N: float | None = None
    zero_N: float | None = None
    contact_mm: float | None = None
    probed_mm: float | None = None
    safe_mm_s: float | None = None
    late_s: float | None = None

    @property
    def names(self) -> list[str]:
        return [name for name, value in vars(self).items() if value is not None]


class MonitoredBench:
    """The devices of a station with the watches on that `interlock.TABLE` names.

    Args:
        on_tick: called after every poll of the devices; an exception stops the stage.
    """

    def __init__(self, bench: Bench, spool: Spool | None = None, on_tick: Callable[[], None] = lambda: None) -> None:
        self.bench, self._spool, self._on_tick = bench, spool, on_tick
        self.readings = Readings()
        self.motion = Motion(bench, self.tick, self._ahead_mm)
        self.bounds = bounds_of(bench)
        self.estimates = RunEstimates()
        self._force_monitor = ForceMonitor(bench.config.safety)
        self._follow_monitor = FollowMonitor(bench.config.fixture.contact_N)
        self._jump_monitor = JumpMonitor()
        self._streams: dict[str, StreamMonitor] = {}
        self._stuck: dict[StageMonitor, tuple[StuckMonitor, StuckMonitor]] = {}
        self._lowest_N, self._expected_N = float("inf"), self.bounds.limit_N
        self._checked_s, self._was_moving = float("inf"), False
        self._paused_s, self._resumed_s = 0.0, float("-inf")
        force = bench.config.force
        if force is None or force.is_latency_declared:
            self.estimates.late_s = 0.0 if force is None else force.latency_s

    @property
    def late_s(self) -> float:
        """Latency of the load cell in s, as far as it is measured or stated."""
        return self.estimates.late_s or 0.0

    @property
    def latest_s(self) -> float:
        """Upper bound of the load cell's latency in s: the allowed maximum while it is not measured."""
        return LATEST_S if self.estimates.late_s is None else self.estimates.late_s

    @property
    def fastest_mm_s(self) -> float:
        bounds, moves = self.bounds, self.motion.row.moves
        by_force = {
            AllowedMotion.PROBED: self.estimates.safe_mm_s,
            AllowedMotion.NONE: 0.0,
            AllowedMotion.HOME: 0.0,
            AllowedMotion.UP: 0.0,
        }
        fastest_mm_s = by_force.get(moves, bounds.detected_mm_s(self.detected_N))
        if self.bench.force is None:
            fastest_mm_s = math.inf
        return min(fastest_mm_s or 0.0, self.bench.config.safety.speed_mm_s, self.bench.stage.max_speed_mm_s)

    def enter(self, state: State) -> None:
        """Enter a later state and activate the monitors of its row alone."""
        self.motion.enter(state, self.estimates.names)

    def start(self) -> None:
        bench, now_s = self.bench, self.bench.clock.now_s()
        bench.readout.start()
        self._streams["readout"] = StreamMonitor(bench.readout, bench.config.safety, now_s, bench.readout.range)
        if bench.force is not None:
            bench.force.start()
            self._streams["force"] = StreamMonitor(bench.force, bench.config.safety, now_s)

    def await_streams(self) -> None:
        """Wait for a reading of every channel before the first motion.

        A board that is reset when its port is opened says nothing before it has booted.
        """
        silent, end_s = set(self._streams), self.bench.clock.now_s() + BOOT_S
        while silent and self.bench.clock.now_s() < end_s:
            self.bench.clock.sleep_s(TICK_S)
            try:
                output, cell = self._read(())
            except BadReply:
                break  # It speaks: what it says is judged where that is due.
            silent -= {name for name, samples in (("readout", output), ("force", cell)) if samples}
            self._on_tick()
        else:
            for name in sorted(silent):
                self._streams[name].check_silence(self.bench.clock.now_s())
        self.start()

    def home(self) -> None:
        """Home the stage, and clear the readings; raise `SafetyStop` if the force grows meanwhile."""
        self._lowest_N = float("inf")
        self.motion.home(self._check_while_homing)
        self.start()  # A reset of the controller may have taken longer than any silence that is allowed.
        self.enter(State.LISTENING)

    def expect_nothing(self) -> None:
        """Set the present force as that of an empty path; a rise by the touch force then means an obstacle."""
        self.estimates.free_N = self.motion.zero_N = unloaded(self.readings.force[-10:])
        self.motion.free_output = unloaded(self.readings.output[-10:])
        self.enter(State.APPROACHING)

    def take_zero(self, zero_N: float) -> None:
        """Set the reading of the unloaded load cell as zero; later readings subtract it."""
        self.estimates.zero_N = self._force_monitor.zero_N = self.motion.zero_N = zero_N
        self.enter(State.SEARCHING)

    def expect_contact(self, contact_mm: float) -> None:
        """Set the position of the unit's surface: beyond it every channel must follow the stage."""
        self.estimates.contact_mm = contact_mm
        for monitor, reader, samples, stuck_mm, lags_s in (
            (StageMonitor.STUCK_OUTPUT, self.bench.readout, self.readings.output, STUCK_OUTPUT_MM, LAGS_S),
            (StageMonitor.STUCK_CELL, self.bench.force, self.readings.force, STUCK_MM, ()),
        ):
            if reader is not None:
                noisy = StuckMonitor(reader.name, noise_of(samples), reader.rate_Hz, stuck_mm, lags_s)
                frozen = StuckMonitor(reader.name, 0.0, reader.rate_Hz, FROZEN * stuck_mm, lags_s)
                self._stuck[monitor] = noisy, frozen
        self.enter(State.PROBING)

    def learn_latency(self, late_s: float) -> None:
        """Set the measured latency of the load cell, if the station file does not state it."""
        self.estimates.late_s = late_s
        delay_s = self.bounds.reaction.delay_s - LATEST_S + late_s
        self.bounds = replace(self.bounds, reaction=replace(self.bounds.reaction, delay_s=delay_s))

    def expect_press(self, contact_mm: float, probed_mm: float, safe_mm_s: float) -> None:
        """Set the surface by a cell of measured latency, and depth and speed of the press."""
        self.estimates.contact_mm, self.estimates.probed_mm, self.estimates.safe_mm_s = contact_mm, probed_mm, safe_mm_s
        self._expected_N = self.bounds.limit_N
        self.enter(State.PRESSING)

    def tick(self) -> None:
        """Wait for a short time, read every device, and check all readings.

        After a stall of the host, buffered readings are read and checked first; a moving stage is then
        stopped, as no monitor watched it.
        """
        self.bench.clock.sleep_s(TICK_S)
        is_unwatched = self._note_pause() and self._was_moving
        self._check_devices()
        if self._note_pause():  # While it looked.
            is_unwatched = is_unwatched or self._was_moving
            self._check_devices()
        if is_unwatched:
            raise NoReply(reason("rig.host_paused", seconds=self._paused_s))

    def _check_devices(self) -> None:
        try:
            polls = self.bench.stage.poll()
            self._was_moving = self.bench.stage.is_moving
            self._take(polls)
        except DeviceError as error:
            raise self.attribute_fault(error) from error

    def _note_pause(self) -> bool:
        now_s = self.bench.clock.now_s()
        before_s, self._checked_s = self._checked_s, now_s
        if now_s - before_s < PAUSE_S:
            return False
        self._paused_s, self._resumed_s = now_s - before_s, now_s
        for stream in self._streams.values():
            stream.resume(now_s)
        return True

    def attribute_fault(self, error: DeviceError) -> DeviceError:
        """Return an error, or a stall of the host if that explains the error."""
        is_recent = self.bench.clock.now_s() - self._resumed_s < CAUGHT_UP_S
        if self._paused_s and error.reason.code in (RECENT if is_recent else LASTING):
            return type(error)(reason("rig.host_paused", seconds=self._paused_s))
        return error

    def suspend_stage(self, seconds: float) -> None:
        """Monitor the channels without commands to the stage, as after a loss of the host."""
        end_s = self.bench.clock.now_s() + seconds
        while self.bench.clock.now_s() < end_s:
            self.bench.clock.sleep_s(TICK_S)
            self._checked_s = self.bench.clock.now_s()
            self._take(())

    def _take(self, polls: Sequence[StagePosition]) -> None:
        self.readings.polls += polls
        output, cell = self._read(polls)
        self._check(output, cell)
        self._on_tick()

    def _read(self, polls: Sequence[StagePosition]) -> tuple[Sequence[Sample], Sequence[Sample]]:
        cell = self.bench.force.poll() if self.bench.force is not None else ()
        output = self.bench.readout.poll()
        if self._spool is not None:
            self._spool.append(output, cell, polls)
        self.readings.force += cell
        self.readings.output += output
        return output, cell

    def _check_while_homing(self) -> None:
        try:
            _, cell = self._read(())
        except BadReply:
            return self._on_tick()  # Homing may begin under an overload: it is what takes it off.
        for sample in cell if StageMonitor.RISE in self.motion.row.monitors else ():
            self.check_rise(sample.values[0])
        self._on_tick()

    def check_rise(self, force_N: float) -> None:
        """Raise `SafetyStop` where the force grows while the stage homes."""
        self._lowest_N = min(self._lowest_N, force_N)
        if force_N > self._lowest_N + SUDDEN_N:
            raise SafetyStop(reason("rig.homing.rises", force_N=force_N - self._lowest_N))

    def _ahead_mm(self, to_mm: float, speed_mm_s: float) -> float:
        if speed_mm_s > self.fastest_mm_s * (1.0 + 1e-9):
            raise ValueError(f"down with {speed_mm_s} mm/s, at most {self.fastest_mm_s} mm/s; nothing was sent")
        if self.bench.force is None or to_mm <= (self.estimates.probed_mm or 0.0):
            return math.inf
        return self.bounds.ahead_mm(speed_mm_s, self.detected_N)

    @property
    def detected_N(self) -> float:
        """The force that stops the stage: the touch force; else the limit, or the prediction of a step."""
        return self.bounds.touch_N if self.motion.row.moves is AllowedMotion.FREE else self._expected_N

    def expect_rise(self, last_N: float) -> float:
        """Set the largest force of the next step of a slow press; return the present force.

        It grew by `last_N` over the step before; inf for any force up to the limit.
        """
        self._expected_N = min(self.bounds.limit_N, self._force_N + self.bounds.rise_N(last_N))
        return self._force_N

    def has_risen(self) -> bool:
        """Whether the force has grown beyond that."""
        return self._force_N > self._expected_N

    @property
    def _force_N(self) -> float:
        return self.readings.force[-1].values[0] - self._force_monitor.zero_N if self.readings.force else 0.0

    def _check(self, output: Sequence[Sample], cell: Sequence[Sample]) -> None:
        on, now_s = self.motion.row.monitors, self.bench.clock.now_s()
        if cell:
            self._check_force(on, cell)
        if output or cell:
            self._check_channels(on, output, cell)
        if StageMonitor.STREAM in on:
            for stream in self._streams.values():
                stream.check_silence(now_s)
        if StageMonitor.DEPTH in on and self.readings.polls:
            self.check_depth(self.readings.polls[-1].position_mm)

    def _check_force(self, on: Collection[StageMonitor], cell: Sequence[Sample]) -> None:
        # How long the force may still grow: until a stop holds, or the move ends by itself.
        speed_mm_s, ahead_s = self.motion.speed_mm_s, 0.0
        if speed_mm_s != 0.0 and self.motion.is_lowering:
            stop_s = REACTION_S + self.late_s + 0.5 * speed_mm_s / self.bounds.reaction.acceleration_mm_s2
            ahead_s = min(stop_s, self.late_s + self.motion.remaining_mm / speed_mm_s)
        self._force_monitor.ahead_s = ahead_s
        for sample in cell:
            newton = sample.values[0]
            if StageMonitor.FORCE in on:
                self._force_monitor.check(sample)
            if StageMonitor.FREE in on:
                self.check_free(newton - (self.estimates.free_N or 0.0))
            if StageMonitor.FOLLOW in on:
                self._follow_monitor.check(
                    newton - self._force_monitor.zero_N, self.pressed_mm(self.late_s), sample.host_s
                )
            if StageMonitor.JUMP in on:
                self._jump_monitor.check(newton, self.bench.stage.is_moving, sample.host_s, self.latest_s)

    def _check_channels(self, on: Collection[StageMonitor], output: Sequence[Sample], cell: Sequence[Sample]) -> None:
        # A unit that relaxed leaves the stage for a while: where there is no force, FOLLOW says whether that may be.
        is_touched = self.bench.force is None or self._force_N > self.bench.config.fixture.contact_N
        # A cell that is late tells of where the stage was.
        for name, samples, stuck, late_s in (
            ("force", cell, StageMonitor.STUCK_CELL, self.late_s),
            ("readout", output, StageMonitor.STUCK_OUTPUT, 0.0),
        ):
            if not samples:
                continue
            pressed_mm = self.pressed_mm(late_s) if is_touched else 0.0
            for sample in samples:
                if StageMonitor.STREAM in on:
                    self._streams[name].check(sample)
                for monitor in self._stuck[stuck] if stuck in on else ():
                    monitor.check(sample.values[0], pressed_mm)

    def check_free(self, force_N: float) -> None:
        """Raise `SafetyStop` where there is a force in the way of the approach."""
        if self.motion.is_lowering and force_N > self.bench.config.fixture.touch_N:
            raise SafetyStop(reason("rig.in_the_way", position_mm=self.bench.stage.position_mm, force_N=force_N))

    def check_depth(self, at_mm: float) -> None:
        """Raise `SafetyStop` if the stage is below its travel limit."""
        if at_mm > (deepest_mm := self.bench.config.safety.deepest_mm) + 0.01:
            raise SafetyStop(reason("rig.deepest", at_mm=at_mm, deepest_mm=deepest_mm))

    def pressed_mm(self, ago_s: float = 0.0) -> float:
        """Return the depth below the contact a given time ago in mm; 0 above it or without contact."""
        contact_mm = self.estimates.contact_mm
        if contact_mm is None or not self.readings.polls:
            return 0.0
        then_s = self.bench.clock.now_s() - ago_s
        newest = self.readings.polls[-1]
        poll = next((p for p in reversed(self.readings.polls) if p.host_s <= then_s), newest) if ago_s else newest
        return max(0.0, poll.position_mm - contact_mm)


def bounds_of(bench: Bench) -> ForceBounds:
    """Return the bounds that a stop on this bench guarantees."""
    config, reader = bench.config, bench.force
    force = config.force
    late_s = force.latency_s if force is not None and force.is_latency_declared else LATEST_S
    period_s = 0.0 if reader is None else 1.0 / reader.rate_Hz
    capacity_N = float("inf") if reader is None else reader.capacity_N
    return ForceBounds(
        Reaction(period_s + late_s + REACTION_S, bench.stage.acceleration_mm_s2),
        config.safety.force_N,
        config.fixture.touch_N,
        FULL * capacity_N,
        config.safety.stiffest_N_mm,
    )


def noise_of(samples: Sequence[Sample]) -> float:
    """Return the standard deviation of the first channel from sample to sample, drift left out."""
    values = np.array([sample.values[0] for sample in samples])
    return float(np.std(np.diff(values)) / np.sqrt(2)) if len(values) > 2 else 0.0
