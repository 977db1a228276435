"""A profile pressed on the bench, with everything that was read on the way. A broken run is never a recording."""

import math
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass

import numpy as np

from softcal.core.errors import BadReply, CommandRefused, SafetyStop
from softcal.core.messages.reason import Reason, reason
from softcal.core.profiles import Profile
from softcal.core.recording import Array
from softcal.station.bench.bench import Bench
from softcal.station.devices.config import LATEST_S
from softcal.station.interfaces import Move, OnWait, ignore_wait
from softcal.station.motion.contact import (
    MAX_UNCERTAINTY_MM,
    SECOND_APPROACH_MM,
    Approach,
    ContactSearch,
    slower_mm_s,
    stiffest_N_mm,
)
from softcal.station.motion.interlock import State
from softcal.station.motion.monitored_bench import MonitoredBench
from softcal.station.motion.monitors import STUCK_MM
from softcal.station.motion.motion import RETRACT_MM_S
from softcal.station.record.method import METHOD, ProofMethod
from softcal.station.record.recording import Raw, RunMetadata, StationRecording, assemble, device_times_s
from softcal.station.record.response import check_lag, fit_response
from softcal.station.record.spool import Spool
from softcal.station.tasks.durations import (
    HOMING,
    MIN_PROBING_S,
    PRESSING,
    PROBING,
    READING,
    RETURNING,
    SEARCHING,
    SETTLE_S,
    STEP_MM,
    phase_seconds,
)
from softcal.station.trajectory import DrivenMove, reconstruct_track

MIN_SEARCH_MM = 0.05
"""A contact that is there after less than this cannot be located: nothing was read above it."""

ROUNDING_MM, REST_S = 1e-6, 0.3
"""Positions that differ by less are one. After a move channels are read at rest for so long."""


class ZeroMoved(BadReply):
    """The unloaded load cell does not read zero, before or after a run: do not trust its readings."""


@dataclass(frozen=True)
class RunProgress:
    """Progress of a run: present phase, completed fraction, and newest reading of each channel.

    Readings are None before the first one, and where no such device is.
    """

    phase: str
    fraction: float
    remaining_s: float
    t_s: float = 0.0
    output: float | None = None
    stage_mm: float = 0.0
    force_N: float | None = None
    output_unit: str = "V"


OnProgress = Callable[[RunProgress], None]


def check_profile(bench: Bench, profile: Profile) -> None:
    """Raise `CommandRefused` when a profile could leave the bounds of stage or station."""
    bounds, fixture = bench.config.safety, bench.config.fixture
    fastest_mm_s = min(bounds.speed_mm_s, bench.stage.max_speed_mm_s)
    deepest_mm = min(bounds.deepest_mm, bench.stage.travel_mm)
    name, max_depth_mm = repr(profile.name), deepest_mm - fixture.approach_mm
    for move in steps_of(profile):
        if not isinstance(move, Move):
            continue
        if move.speed_mm_s > fastest_mm_s * (1 + 1e-9):
            speeds = {"speed_mm_s": move.speed_mm_s, "most_mm_s": fastest_mm_s}
            raise CommandRefused(reason("rig.profile.speed", profile=name, **speeds))
        if not -fixture.clearance_mm <= move.to_mm <= max_depth_mm:
            raise CommandRefused(reason("rig.profile.depth", profile=name, to_mm=move.to_mm, most_mm=max_depth_mm))


def steps_of(profile: Profile) -> list[Move | float]:
    """Return a profile as moves from rest to rest, and seconds of holds."""
    steps: list[Move | float] = []
    at_mm = 0.0
    for segment in profile.segments:
        way_mm, at_mm = abs(segment.target_mm - at_mm), segment.target_mm
        steps.append(Move(at_mm, way_mm / segment.duration_s) if way_mm else segment.duration_s)
    return steps


def record(
    bench: Bench,
    serial: str,
    profile: Profile,
    with_reference: bool,
    on_progress: OnProgress | None = None,
    spool: Spool | None = None,
    on_wait: OnWait = ignore_wait,
    method: ProofMethod = METHOD,
) -> StationRecording:
    """Press one unit with one profile and return the readings.

    Args:
        profile: position 0 is `fixture.clearance_mm` above the contact.
        with_reference: keep the load cell's reading in the recording (source unit); it guards the run in any case.
        on_progress: called about every 0.1 s.
        on_wait: called at every poll of the devices; an exception stops the stage.
        method: the numbers that decide whether the run is a recording.

    Raises:
        CommandRefused: the profile leaves the station's bounds; nothing moved.
        SafetyStop, NoReply, BadReply, DeviceError: the stage was stopped, and retracted where that is safe; nothing
            was recorded.
    """
    check_profile(bench, profile)
    if with_reference and bench.force is None:
        raise CommandRefused(Reason("rig.needs_cell"))
    if bench.force is None and not bench.config.safety.without_cell:
        raise CommandRefused(Reason("rig.no_limit"))
    run = _Run(bench, serial, profile, on_progress, spool, on_wait, method)
    return run.monitored.motion.supervise(lambda: run.perform(with_reference))


class _Run:
    def __init__(
        self,
        bench: Bench,
        serial: str,
        profile: Profile,
        on_progress: OnProgress | None,
        spool: Spool | None,
        on_wait: OnWait,
        method: ProofMethod,
    ) -> None:
        self._bench, self._serial, self._profile, self._spool = bench, serial, profile, spool
        self._clock, self._stage = bench.clock, bench.stage
        self._on_progress, self._on_wait, self._method = on_progress, on_wait, method
        self.monitored = MonitoredBench(bench, spool, self._on_tick)
        self._motion, self._readings = self.monitored.motion, self.monitored.readings
        self._moves: list[DrivenMove] = []
        self._phase, self._began_s, self._reported_s = "starting", bench.clock.now_s(), -1.0
        from_mm = bench.stage.position_mm if bench.stage.is_position_known else None
        self._plan = phase_seconds(bench.config, self.monitored.bounds, profile, from_mm)
        self._total_s, self._done = sum(self._plan.values()), 0.0

    def perform(self, with_reference: bool) -> StationRecording:
        self.monitored.start()
        self.monitored.await_streams()
        if not self._stage.is_position_known:
            self._enter(HOMING)
            self.monitored.home()
        else:
            self.monitored.enter(State.LISTENING)
        self._enter(READING)
        self._motion.wait(REST_S)
        self.monitored.expect_nothing()
        # To where no unit reaches, so slowly that a hand that is in the way takes no harm.
        approach_mm = self._bench.config.fixture.approach_mm
        if abs(approach_mm - self._stage.position_mm) > ROUNDING_MM:
            self._go(approach_mm, self.monitored.fastest_mm_s)
            self._motion.wait(REST_S)
        zero_N = self._take_zero()
        approach, fixture = self._find_contact(), self._bench.config.fixture
        contact_mm = approach.fit_onset(self.monitored.late_s).at_mm
        self.monitored.expect_contact(contact_mm)
        probed_mm, safe_mm_s = self._probe(contact_mm - fixture.clearance_mm, approach, zero_N)
        # A late cell shows the contact too deep, and how late it is may be known only now.
        contact_mm = approach.fit_onset(self.monitored.late_s).at_mm
        zero_mm = contact_mm - fixture.clearance_mm
        # Up: where a clearance is 0, rounding alone may make it a move down.
        self._go(min(zero_mm, self._stage.position_mm), fixture.search_mm_s)
        self.monitored.expect_press(contact_mm, probed_mm, safe_mm_s)
        # A slow press ended in a rest already.
        self._motion.wait(SETTLE_S - REST_S if probed_mm else SETTLE_S)
        span_s = self._press(zero_mm)
        zeros = (zero_mm, contact_mm, zero_N, self._return(zero_N))
        moves = tuple((*astuple(move.path), move.begun_s, move.confirmed_s) for move in self._moves)
        readout, force = self._bench.readout, self._bench.config.force
        about = (self._serial, self._profile.name, readout.name, readout.unit, readout.rate_Hz)
        is_declared = force is None or force.is_latency_declared
        metadata = RunMetadata(*about, moves, span_s, *zeros, with_reference, self.monitored.late_s, is_declared)
        if self._spool is not None:
            self._spool.add_metadata(asdict(metadata))
        self._report_progress(1.0, 0.0)
        try:
            raw = Raw(self._readings.output, self._readings.force, self._readings.polls)
            return assemble(raw, metadata, self._method)
        except BadReply as error:
            raise self.monitored.attribute_fault(error) from error

    def _press(self, zero_mm: float) -> tuple[float, float]:
        began_s = self._clock.now_s()
        self._enter(PRESSING)
        for step in steps_of(self._profile):
            if isinstance(step, Move):
                self._go(zero_mm + step.to_mm, step.speed_mm_s)
            else:
                self._motion.wait(step)
        return began_s, self._clock.now_s()

    def _return(self, zero_N: float) -> float:
        self._enter(RETURNING)
        self._go(self._bench.config.fixture.approach_mm, self._retract_mm_s)
        self._motion.wait(SETTLE_S)
        if self._bench.force is None:
            return 0.0
        recent = [s.values[0] for s in self._readings.force if s.host_s > self._clock.now_s() - 0.7 * SETTLE_S]
        change_N = float(np.mean(recent)) - zero_N
        allowed_N = self._bench.config.safety.zero_return_N
        if abs(change_N) > allowed_N:
            raise ZeroMoved(reason("rig.zero_moved", change_N=change_N, allowed_N=allowed_N))
        return change_N

    @property
    def _retract_mm_s(self) -> float:
        return min(RETRACT_MM_S, self._stage.max_speed_mm_s)

    def _on_tick(self) -> None:
        self._on_wait()
        if self._clock.now_s() - self._reported_s >= 0.1:
            self._update_progress()

    def _enter(self, phase: str) -> None:
        phases = list(self._plan)
        remaining_s = sum(self._plan[later] for later in phases[phases.index(phase) :])
        self._phase, self._total_s = phase, self._clock.now_s() - self._began_s + remaining_s
        self._update_progress()

    def _update_progress(self) -> None:
        self._reported_s = self._clock.now_s()
        elapsed_s = self._reported_s - self._began_s
        # A phase may take longer than planned: what is done stays done.
        self._done = max(self._done, min(0.99, elapsed_s / self._total_s))
        self._report_progress(self._done, max(0.0, self._total_s - elapsed_s))

    def _go(self, to_mm: float, speed_mm_s: float, is_over: Callable[[], bool] | None = None) -> None:
        self._moves.append(self._motion.go(to_mm, speed_mm_s, is_over))

    def _take_zero(self) -> float:
        count, zero_N = len(self._readings.force), 0.0
        self._motion.wait(SETTLE_S)
        if self._bench.force is not None:
            zero_N = float(np.mean([sample.values[0] for sample in self._readings.force[count:]]))
            if abs(zero_N) > (allowed_N := self._bench.config.safety.zero_N):
                raise ZeroMoved(reason("rig.not_zero", zero_N=zero_N, allowed_N=allowed_N))
        self.monitored.take_zero(zero_N)
        return zero_N

    def _find_contact(self) -> Approach:
        """Lower slowly until force, or output without a cell, changes; return what shows the contact."""
        self._enter(SEARCHING)
        bench, fixture = self._bench, self._bench.config.fixture
        read, latest_s = self._readings, self.monitored.latest_s
        search = ContactSearch(fixture, bench.force is not None, read.force, read.output, latest_s)
        speed_mm_s = min(fixture.search_mm_s, self.monitored.fastest_mm_s)
        approach = self._approach(search, speed_mm_s)
        contact = approach.fit_onset(self.monitored.late_s)
        slow_mm_s = slower_mm_s(speed_mm_s, contact.uncertainty_mm)
        if contact.uncertainty_mm <= MAX_UNCERTAINTY_MM or slow_mm_s >= speed_mm_s:
            return approach
        above_mm = contact.at_mm - SECOND_APPROACH_MM
        self._go(above_mm, self._retract_mm_s)
        self._motion.wait(max(REST_S, self.monitored.bounds.reaction.delay_s))
        search.begin()
        return self._approach(search, slow_mm_s)

    def _approach(self, search: ContactSearch, speed_mm_s: float) -> Approach:
        deepest_mm, began_s = self._bench.config.safety.deepest_mm, self._clock.now_s()
        move = self._motion.go(deepest_mm, speed_mm_s, search.is_over)
        if not search.has_contact:
            raise SafetyStop(reason("rig.no_contact", deepest_mm=deepest_mm))
        polls = [poll for poll in self._readings.polls if poll.host_s >= began_s]
        if not polls or self._stage.position_mm - move.path.start_mm < MIN_SEARCH_MM:
            raise BadReply(reason("rig.contact_at_once", way_mm=MIN_SEARCH_MM))
        # The search ended in a stop: the path that can be reconstructed begins here.
        self._moves.clear()
        return search.approach(reconstruct_track(polls, [move]).at)

    def _probe(self, zero_mm: float, approach: Approach, zero_N: float) -> tuple[float, float]:
        """Press once slowly to the depth of the profile: only there may the stage then move fast.

        Returns how deep that was (0 where the profile itself is slow enough, or no load cell reads), and the fastest
        speed down to there that a stop can hold; a faster profile is refused after the slow press.
        """
        slow_mm_s = self.monitored.fastest_mm_s
        if self._bench.force is None or self._profile.fastest_mm_s <= slow_mm_s:
            self.monitored.enter(State.RELEASING)
            return 0.0, slow_mm_s
        deepest_mm, began = zero_mm + self._profile.deepest_mm, len(self._readings.force)
        self._enter(PROBING)
        if not self._probe_down(deepest_mm):
            # Something hard: slowly from the top, and any force up to the limit is borne. Up so slowly that a late cell
            # does not seem to hang when the stage turns round.
            self._go(zero_mm, min(self._retract_mm_s, STUCK_MM / (2.0 * self.monitored.latest_s + 0.2)))
            self._moves.clear()
            began = len(self._readings.force)
            self.monitored.expect_rise(math.inf)
            self._go(deepest_mm, self.monitored.fastest_mm_s)
        down = len(self._readings.force)
        self._motion.wait(REST_S)
        self.monitored.enter(State.RELEASING)
        self._go(zero_mm, self._retract_mm_s)
        self._motion.wait(max(REST_S, self.monitored.bounds.reaction.delay_s))
        at = reconstruct_track(self._readings.polls, self._moves).at
        host_s = np.array([sample.host_s for sample in self._readings.force[began:]]) - self.monitored.late_s
        force_N = np.array([sample.values[0] for sample in self._readings.force[began:]])
        self._measure_latency(began, force_N, at, approach)
        downward = slice(None, down - began)
        peak_N, stiffness_N_mm = float(np.max(force_N)) - zero_N, stiffest_N_mm(at(host_s[downward]), force_N[downward])
        bounds, fastest_mm_s = self.monitored.bounds, self._profile.fastest_mm_s
        probed_mm_s = bounds.probed_mm_s(peak_N, stiffness_N_mm)
        if fastest_mm_s > probed_mm_s:
            response = {"force_N": peak_N, "stiffness_N_mm": stiffness_N_mm}
            speeds = {"speed_mm_s": fastest_mm_s, "slower_mm_s": probed_mm_s, "ceiling_N": bounds.ceiling_N}
            worst_N = bounds.worst_N(fastest_mm_s, **response)
            about = reason("rig.too_fast", profile=repr(self._profile.name), worst_N=worst_N, **response, **speeds)
            raise CommandRefused(about)
        return deepest_mm + ROUNDING_MM, probed_mm_s

    def _probe_down(self, deepest_mm: float) -> bool:
        """Press in steps, each as fast as a stop holds that notices more force than the step before lets expect.

        Returns whether it came to the end; no more force than that was met.
        """
        last_N, before_N, from_mm = 0.0, 0.0, self._stage.position_mm
        slow_mm_s, enough_mm_s = self.monitored.fastest_mm_s, (deepest_mm - from_mm) / MIN_PROBING_S
        if slow_mm_s >= enough_mm_s:
            self._go(deepest_mm, slow_mm_s)
            return True
        steps = max(1, math.ceil((deepest_mm - from_mm) / STEP_MM))
        for to_mm in np.linspace(from_mm, deepest_mm, steps + 1)[1:].tolist():
            force_N = self.monitored.expect_rise(last_N)
            last_N, before_N = force_N - before_N, force_N
            speed_mm_s = min(enough_mm_s, self.monitored.fastest_mm_s)
            self._go(to_mm, speed_mm_s, self.monitored.has_risen)
            if self.monitored.has_risen():
                return False
        return True

    def _measure_latency(self, began: int, force_N: Array, at: Callable[[Array], Array], approach: Approach) -> None:
        """Measure the latency of the cell in the slow press by its own clock, as lines are delayed, too."""
        force, reader, late_s = self._bench.config.force, self._bench.force, self.monitored.late_s
        if force is None or reader is None:
            return
        host_s = device_times_s(self._readings.force)[began:]
        for _ in range(2):  # A late cell shows the contact too deep; by a law that begins there it seems slow.
            response = fit_response(host_s, force_N, at, approach.fit_onset(late_s).at_mm, self._method)
            if force.is_latency_declared or not response.is_identifiable:
                break
            late_s = min(max(0.0, response.lag_s), LATEST_S)
        check_lag(response, late_s, 1.0 / reader.rate_Hz, self._method.lag)
        if not force.is_latency_declared and response.is_identifiable:
            self.monitored.learn_latency(late_s)

    def _report_progress(self, fraction: float, remaining_s: float) -> None:
        if self._on_progress is None:
            return
        read, t_s = self._readings, self._clock.now_s() - self._began_s
        output, force_N = (samples[-1].values[0] if samples else None for samples in (read.output, read.force))
        stage_mm, unit = read.polls[-1].position_mm if read.polls else 0.0, self._bench.readout.unit
        self._on_progress(RunProgress(self._phase, fraction, remaining_s, t_s, output, stage_mm, force_N, unit))
