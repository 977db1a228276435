"""A profile pressed on the bench, with everything that was read on the way. A broken run is never a recording."""

import math
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass

import numpy as np

from softcal.core.errors import BadReply, CommandRefused, SafetyStop
from softcal.core.messages.reason import Reason, reason
from softcal.core.profiles import Profile
from softcal.core.recording import Array
from softcal.station.devices.bench import Bench
from softcal.station.devices.config import LATEST_S
from softcal.station.interfaces import Move, OnWait, ignore_wait
from softcal.station.motion.contact import AGAIN_MM, SURE_MM, ContactSearch, Touch, slower_mm_s, stiffest_N_mm
from softcal.station.motion.interlock import State
from softcal.station.motion.motion import RETRACT_MM_S
from softcal.station.motion.safety import STUCK_MM
from softcal.station.motion.watched import WatchedBench
from softcal.station.record.method import METHOD, ProofMethod
from softcal.station.record.recording import Raw, RunFacts, StationRecording, assemble, device_times_s
from softcal.station.record.response import check_lag, fit_response
from softcal.station.record.spool import Spool
from softcal.station.record.trajectory import DrivenMove, reconstruct
from softcal.station.tasks.seconds import (
    FEEL_S,
    FEELING,
    HOMING,
    PRESSING,
    READING,
    RETURNING,
    SEARCHING,
    SETTLE_S,
    STEP_MM,
    seconds_of,
)

SEARCH_WAY_MM = 0.05
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
    name, most_mm = repr(profile.name), deepest_mm - fixture.approach_mm
    for move in steps_of(profile):
        if not isinstance(move, Move):
            continue
        if move.speed_mm_s > fastest_mm_s * (1 + 1e-9):
            speeds = {"speed_mm_s": move.speed_mm_s, "most_mm_s": fastest_mm_s}
            raise CommandRefused(reason("rig.profile.speed", profile=name, **speeds))
        if not -fixture.clearance_mm <= move.to_mm <= most_mm:
            raise CommandRefused(reason("rig.profile.depth", profile=name, to_mm=move.to_mm, most_mm=most_mm))


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
    return run.watched.motion.supervise(lambda: run.perform(with_reference))


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
        self.watched = WatchedBench(bench, spool, self._on_tick)
        self._motion, self._readings = self.watched.motion, self.watched.readings
        self._moves: list[DrivenMove] = []
        self._phase, self._began_s, self._shown_s = "starting", bench.clock.now_s(), -1.0
        from_mm = bench.stage.position_mm if bench.stage.is_position_known else None
        self._plan = seconds_of(bench.config, self.watched.bounds, profile, from_mm)
        self._total_s, self._done = sum(self._plan.values()), 0.0

    def perform(self, with_reference: bool) -> StationRecording:
        self.watched.start()
        self.watched.await_streams()
        if not self._stage.is_position_known:
            self._enter(HOMING)
            self.watched.home()
        else:
            self.watched.enter(State.LISTENING)
        self._enter(READING)
        self._motion.wait(REST_S)
        self.watched.expect_nothing()
        # To where no unit reaches, so slowly that a hand that is in the way takes no harm.
        approach_mm = self._bench.config.fixture.approach_mm
        if abs(approach_mm - self._stage.position_mm) > ROUNDING_MM:
            self._go(approach_mm, self.watched.fastest_mm_s)
            self._motion.wait(REST_S)
        zero_N = self._take_zero()
        touch, fixture = self._find_contact(), self._bench.config.fixture
        contact_mm = touch.foot(self.watched.late_s).at_mm
        self.watched.expect_contact(contact_mm)
        felt_mm, safe_mm_s = self._feel(contact_mm - fixture.clearance_mm, touch, zero_N)
        # A late cell shows the contact too deep, and how late it is may be known only now.
        contact_mm = touch.foot(self.watched.late_s).at_mm
        zero_mm = contact_mm - fixture.clearance_mm
        # Up: where a clearance is 0, rounding alone may make it a move down.
        self._go(min(zero_mm, self._stage.position_mm), fixture.search_mm_s)
        self.watched.expect_press(contact_mm, felt_mm, safe_mm_s)
        # A slow press ended in a rest already.
        self._motion.wait(SETTLE_S - REST_S if felt_mm else SETTLE_S)
        span_s = self._press(zero_mm)
        zeros = (zero_mm, contact_mm, zero_N, self._return(zero_N))
        moves = tuple((*astuple(move.path), move.begun_s, move.confirmed_s) for move in self._moves)
        readout, force = self._bench.readout, self._bench.config.force
        about = (self._serial, self._profile.name, readout.name, readout.unit, readout.rate_Hz)
        is_stated = force is None or force.is_latency_stated
        facts = RunFacts(*about, moves, span_s, *zeros, with_reference, self.watched.late_s, is_stated)
        if self._spool is not None:
            self._spool.add_facts(asdict(facts))
        self._tell(1.0, 0.0)
        try:
            raw = Raw(self._readings.output, self._readings.force, self._readings.polls)
            return assemble(raw, facts, self._method)
        except BadReply as error:
            raise self.watched.blame(error) from error

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
        if self._clock.now_s() - self._shown_s >= 0.1:
            self._show()

    def _enter(self, phase: str) -> None:
        phases = list(self._plan)
        left_s = sum(self._plan[later] for later in phases[phases.index(phase) :])
        self._phase, self._total_s = phase, self._clock.now_s() - self._began_s + left_s
        self._show()

    def _show(self) -> None:
        self._shown_s = self._clock.now_s()
        gone_s = self._shown_s - self._began_s
        # A phase may take longer than planned: what is done stays done.
        self._done = max(self._done, min(0.99, gone_s / self._total_s))
        self._tell(self._done, max(0.0, self._total_s - gone_s))

    def _go(self, to_mm: float, speed_mm_s: float, is_over: Callable[[], bool] | None = None) -> None:
        self._moves.append(self._motion.go(to_mm, speed_mm_s, is_over))

    def _take_zero(self) -> float:
        count, zero_N = len(self._readings.force), 0.0
        self._motion.wait(SETTLE_S)
        if self._bench.force is not None:
            zero_N = float(np.mean([sample.values[0] for sample in self._readings.force[count:]]))
            if abs(zero_N) > (allowed_N := self._bench.config.safety.zero_N):
                raise ZeroMoved(reason("rig.not_zero", zero_N=zero_N, allowed_N=allowed_N))
        self.watched.take_zero(zero_N)
        return zero_N

    def _find_contact(self) -> Touch:
        """Lower slowly until force, or output without a cell, changes; return what shows the contact."""
        self._enter(SEARCHING)
        bench, fixture = self._bench, self._bench.config.fixture
        read, latest_s = self._readings, self.watched.latest_s
        search = ContactSearch(fixture, bench.force is not None, read.force, read.output, latest_s)
        speed_mm_s = min(fixture.search_mm_s, self.watched.fastest_mm_s)
        touch = self._touch(search, speed_mm_s)
        contact = touch.foot(self.watched.late_s)
        slow_mm_s = slower_mm_s(speed_mm_s, contact.doubt_mm)
        if contact.doubt_mm <= SURE_MM or slow_mm_s >= speed_mm_s:
            return touch
        above_mm = contact.at_mm - AGAIN_MM
        self._go(above_mm, self._retract_mm_s)
        self._motion.wait(max(REST_S, self.watched.bounds.reaction.delay_s))
        search.begin()
        return self._touch(search, slow_mm_s)

    def _touch(self, search: ContactSearch, speed_mm_s: float) -> Touch:
        deepest_mm, began_s = self._bench.config.safety.deepest_mm, self._clock.now_s()
        move = self._motion.go(deepest_mm, speed_mm_s, search.is_over)
        if not search.has_found:
            raise SafetyStop(reason("rig.no_contact", deepest_mm=deepest_mm))
        polls = [poll for poll in self._readings.polls if poll.host_s >= began_s]
        if not polls or self._stage.position_mm - move.path.start_mm < SEARCH_WAY_MM:
            raise BadReply(reason("rig.contact_at_once", way_mm=SEARCH_WAY_MM))
        # The search ended in a stop: the path that can be reconstructed begins here.
        self._moves.clear()
        return search.touch(reconstruct(polls, [move]).at)

    def _feel(self, zero_mm: float, touch: Touch, zero_N: float) -> tuple[float, float]:
        """Press once slowly to the depth of the profile: only there may the stage then move fast.

        Returns how deep that was (0 where the profile itself is slow enough, or no load cell reads), and the fastest
        speed down to there that a stop can hold; a faster profile is refused after the slow press.
        """
        slow_mm_s = self.watched.fastest_mm_s
        if self._bench.force is None or self._profile.fastest_mm_s <= slow_mm_s:
            self.watched.enter(State.RELEASING)
            return 0.0, slow_mm_s
        deepest_mm, began = zero_mm + self._profile.deepest_mm, len(self._readings.force)
        self._enter(FEELING)
        if not self._feel_down(deepest_mm):
            # Something hard: slowly from the top, and any force up to the limit is borne. Up so slowly that a late cell
            # does not seem to hang when the stage turns round.
            self._go(zero_mm, min(self._retract_mm_s, STUCK_MM / (2.0 * self.watched.latest_s + 0.2)))
            self._moves.clear()
            began = len(self._readings.force)
            self.watched.expect_rise(math.inf)
            self._go(deepest_mm, self.watched.fastest_mm_s)
        down = len(self._readings.force)
        self._motion.wait(REST_S)
        self.watched.enter(State.RELEASING)
        self._go(zero_mm, self._retract_mm_s)
        self._motion.wait(max(REST_S, self.watched.bounds.reaction.delay_s))
        at = reconstruct(self._readings.polls, self._moves).at
        host_s = np.array([sample.host_s for sample in self._readings.force[began:]]) - self.watched.late_s
        force_N = np.array([sample.values[0] for sample in self._readings.force[began:]])
        self._measure_latency(began, force_N, at, touch)
        seen = slice(None, down - began)
        felt_N, stiffness_N_mm = float(np.max(force_N)) - zero_N, stiffest_N_mm(at(host_s[seen]), force_N[seen])
        bounds, fastest_mm_s = self.watched.bounds, self._profile.fastest_mm_s
        known_mm_s = bounds.known_mm_s(felt_N, stiffness_N_mm)
        if fastest_mm_s > known_mm_s:
            felt = {"force_N": felt_N, "stiffness_N_mm": stiffness_N_mm}
            speeds = {"speed_mm_s": fastest_mm_s, "slower_mm_s": known_mm_s, "ceiling_N": bounds.ceiling_N}
            worst_N = bounds.worst_N(fastest_mm_s, **felt)
            about = reason("rig.too_fast", profile=repr(self._profile.name), worst_N=worst_N, **felt, **speeds)
            raise CommandRefused(about)
        return deepest_mm + ROUNDING_MM, known_mm_s

    def _feel_down(self, deepest_mm: float) -> bool:
        """Press in steps, each as fast as a stop holds that notices more force than the step before lets expect.

        Returns whether it came to the end; no more force than that was met.
        """
        last_N, before_N, from_mm = 0.0, 0.0, self._stage.position_mm
        slow_mm_s, enough_mm_s = self.watched.fastest_mm_s, (deepest_mm - from_mm) / FEEL_S
        if slow_mm_s >= enough_mm_s:
            self._go(deepest_mm, slow_mm_s)
            return True
        steps = max(1, math.ceil((deepest_mm - from_mm) / STEP_MM))
        for to_mm in np.linspace(from_mm, deepest_mm, steps + 1)[1:].tolist():
            force_N = self.watched.expect_rise(last_N)
            last_N, before_N = force_N - before_N, force_N
            speed_mm_s = min(enough_mm_s, self.watched.fastest_mm_s)
            self._go(to_mm, speed_mm_s, self.watched.has_risen)
            if self.watched.has_risen():
                return False
        return True

    def _measure_latency(self, began: int, force_N: Array, at: Callable[[Array], Array], touch: Touch) -> None:
        """Measure the latency of the cell in the slow press by its own clock, as lines are delayed, too."""
        force, reader, late_s = self._bench.config.force, self._bench.force, self.watched.late_s
        if force is None or reader is None:
            return
        host_s = device_times_s(self._readings.force)[began:]
        for _ in range(2):  # A late cell shows the contact too deep; by a law that begins there it seems slow.
            response = fit_response(host_s, force_N, at, touch.foot(late_s).at_mm, self._method)
            if force.is_latency_stated or not response.is_told:
                break
            late_s = min(max(0.0, response.lag_s), LATEST_S)
        check_lag(response, late_s, 1.0 / reader.rate_Hz, self._method.lag)
        if not force.is_latency_stated and response.is_told:
            self.watched.learn_latency(late_s)

    def _tell(self, fraction: float, remaining_s: float) -> None:
        if self._on_progress is None:
            return
        read, t_s = self._readings, self._clock.now_s() - self._began_s
        output, force_N = (samples[-1].values[0] if samples else None for samples in (read.output, read.force))
        stage_mm, unit = read.polls[-1].position_mm if read.polls else 0.0, self._bench.readout.unit
        self._on_progress(RunProgress(self._phase, fraction, remaining_s, t_s, output, stage_mm, force_N, unit))
