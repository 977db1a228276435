"""A profile pressed on the bench, with everything that was read on the way. A broken run is never a recording."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass, field

import numpy as np

from softcal.core.errors import BadReply, CommandRefused, DeviceError, NoReply, SafetyStop
from softcal.core.profiles import Profile
from softcal.station.bench import Bench
from softcal.station.contact import Search
from softcal.station.interfaces import Move, Sample, StagePosition, Step
from softcal.station.recording import Raw, RunFacts, StationRecording, assemble
from softcal.station.safety import FollowWatch, ForceWatch, JumpWatch, StreamWatch
from softcal.station.spool import Spool
from softcal.station.steps import check_profile, steps_of
from softcal.station.trajectory import DrivenMove, Trapezoid, reconstruct

TICK_S = 0.005
"""How often the devices are read while something may move; far below every latency that is promised."""

SETTLE_S = 1.0
ARRIVAL_S = 2.0
"""A move that takes this much longer than planned has failed."""

RETRACT_MM_S = 5.0

HOMING, PRESSING = "homing", "pressing"
RETURN_S = 3.5
"""Lifting and reading the zero return, about."""


class ZeroMoved(BadReply):
    """The unloaded load cell does not read zero, before or after a run: its readings are not to be trusted."""


@dataclass(frozen=True)
class RunProgress:
    """Where a run stands: what happens now, the done share of it, and the newest reading of each channel.

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


@dataclass
class _Readings:
    """Everything that was read, as it came."""

    output: list[Sample] = field(default_factory=list)
    force: list[Sample] = field(default_factory=list)
    polls: list[StagePosition] = field(default_factory=list)


def record(
    bench: Bench,
    serial: str,
    profile: Profile,
    with_reference: bool,
    on_progress: OnProgress | None = None,
    spool: Spool | None = None,
) -> StationRecording:
    """Press one unit with one profile and return what was read.

    Args:
        bench: open devices.
        serial: of the unit in the fixture.
        profile: position 0 is `fixture.clearance_mm` above the contact.
        with_reference: keep the load cell's reading in the recording (source unit); it guards the run in any case.
        on_progress: called about every 0.1 s.
        spool: where everything that is read goes as it comes.

    Raises:
        CommandRefused: the profile leaves the station's bounds; nothing moved.
        SafetyStop, NoReply, BadReply, DeviceError: the stage was stopped, and retracted where that is safe; nothing
            was recorded.
    """
    check_profile(bench, profile)
    if with_reference and bench.force is None:
        raise CommandRefused("a source unit needs the load cell, the station file has none; nothing moved")
    run = _Run(bench, serial, profile, on_progress, spool)
    try:
        return run.perform(with_reference)
    except DeviceError as error:
        raise type(error)(f"{error}; {run.make_safe(may_retract=True)}, the run is aborted") from error
    except BaseException:
        run.make_safe(may_retract=False)
        raise


class _Run:
    def __init__(
        self, bench: Bench, serial: str, profile: Profile, on_progress: OnProgress | None, spool: Spool | None
    ) -> None:
        self._bench, self._serial, self._profile, self._spool = bench, serial, profile, spool
        self._clock, self._stage = bench.clock, bench.stage
        self._on_progress = on_progress
        self._readings = _Readings()
        self._moves: list[DrivenMove] = []
        self._contact_mm: float | None = None
        self._phase, self._began_s, self._shown_s = "starting", 0.0, -1.0
        self._total_s = profile.duration_s + 15.0
        self._force_watch = ForceWatch(bench.config.safety)
        self._follow_watch = FollowWatch(bench.config.fixture.contact_N)
        self._jump_watch = JumpWatch()
        self._watches: dict[str, StreamWatch] = {}

    def perform(self, with_reference: bool) -> StationRecording:
        bench, fixture = self._bench, self._bench.config.fixture
        self._start()
        if not self._stage.is_position_known:
            self._enter(HOMING)
            # Force is no reason to stop homing: it moves away from the unit, and may have to begin under load.
            self._stage.home(self._show_now_and_then)
            self._start()  # Nobody read while the stage was homing.
        self._enter("reading the unloaded channels")
        self._go(fixture.approach_mm, min(bench.config.safety.speed_mm_s, self._stage.max_speed_mm_s))
        zero_N = self._take_zero()
        contact_mm = self._find_contact()
        self._contact_mm = contact_mm
        # The search ended in a stop: the path that can be reconstructed begins here.
        self._moves.clear()
        zero_mm = contact_mm - fixture.clearance_mm
        self._go(zero_mm, fixture.search_mm_s)
        self._wait(SETTLE_S)
        profile_began_s = self._clock.now_s()
        self._total_s = profile_began_s - self._began_s + self._profile.duration_s + RETURN_S
        self._enter(PRESSING)
        for step in steps_of(self._profile):
            self._do(step, zero_mm)
        profile_ended_s = self._clock.now_s()
        self._enter("reading the zero return")
        self._go(fixture.approach_mm, RETRACT_MM_S)
        self._wait(SETTLE_S)
        facts = RunFacts(
            self._serial,
            self._profile.name,
            bench.readout.name,
            bench.readout.unit,
            bench.readout.rate_Hz,
            tuple((*astuple(move.path), move.begun_s, move.confirmed_s) for move in self._moves),
            (profile_began_s, profile_ended_s),
            zero_mm,
            contact_mm,
            zero_N,
            self._zero_return_N(zero_N),
            with_reference,
        )
        if self._spool is not None:
            self._spool.add_facts(asdict(facts))
        self._tell(1.0, 0.0)
        return assemble(Raw(self._readings.output, self._readings.force, self._readings.polls), facts)

    def make_safe(self, may_retract: bool) -> str:
        """Stop the stage, lift it where its position is still known, and say what was done."""
        try:
            self._stage.stop()
        except DeviceError:
            return "the stage does not answer any more, it stops within 0.4 s: switch it off before you reach in"
        if not may_retract or not self._stage.is_position_known:
            return "the stage is stopped and must be homed"
        try:
            self._stage.begin(Move(min(self._bench.config.fixture.approach_mm, self._stage.travel_mm), RETRACT_MM_S))
            while self._stage.is_moving:
                self._clock.sleep_s(TICK_S)
                self._stage.poll()
        except DeviceError:
            return "the stage is stopped but could not be lifted: lift it by hand and home it"
        return "the stage is stopped and lifted"

    def _start(self) -> None:
        bench, now_s = self._bench, self._clock.now_s()
        self._began_s = self._began_s or now_s
        bench.readout.start()
        self._watches["readout"] = StreamWatch(bench.readout, bench.config.safety, now_s, bench.readout.range)
        if bench.force is not None:
            bench.force.start()
            self._watches["force"] = StreamWatch(bench.force, bench.config.safety, now_s)

    def _tick(self) -> None:
        """Let a little time pass, read every device, and check everything that was read."""
        self._clock.sleep_s(TICK_S)
        polls = self._stage.poll()
        force = self._bench.force.poll() if self._bench.force is not None else ()
        output = self._bench.readout.poll()
        if self._spool is not None:
            self._spool.append(output, force, polls)
        self._readings.polls += polls
        self._readings.force += force
        self._readings.output += output
        self._check(output, force)
        self._show_now_and_then()

    def _show_now_and_then(self) -> None:
        if self._clock.now_s() - self._shown_s >= 0.1:
            self._show()

    def _enter(self, phase: str) -> None:
        self._phase = phase
        self._show()

    def _show(self) -> None:
        self._shown_s = self._clock.now_s()
        gone_s = self._shown_s - self._began_s
        self._tell(min(0.99, gone_s / self._total_s), max(0.0, self._total_s - gone_s))

    def _check(self, output: Sequence[Sample], cell: Sequence[Sample]) -> None:
        pressed_mm = self._pressed_mm()
        for sample in cell:
            self._force_watch.check(sample)
            self._follow_watch.check(sample.values[0] - self._force_watch.zero_N, pressed_mm, sample.host_s)
            self._jump_watch.check(sample.values[0], self._stage.is_moving, sample.host_s)
            self._watches["force"].check(sample, pressed_mm)
        for sample in output:
            self._watches["readout"].check(sample, pressed_mm)
        for watch in self._watches.values():
            watch.check_silence(self._clock.now_s())
        self._check_depth()

    def _pressed_mm(self) -> float:
        if self._contact_mm is None or not self._readings.polls:
            return 0.0
        return max(0.0, self._readings.polls[-1].position_mm - self._contact_mm)

    def _check_depth(self) -> None:
        deepest_mm = self._bench.config.safety.deepest_mm
        if self._readings.polls and self._readings.polls[-1].position_mm > deepest_mm + 0.01:
            at_mm = self._readings.polls[-1].position_mm
            raise SafetyStop(f"stage at {at_mm:.2f} mm, the limit is {deepest_mm:g} mm; check the fixture")

    def _go(self, to_mm: float, speed_mm_s: float) -> None:
        if to_mm > self._bench.config.safety.deepest_mm:
            raise SafetyStop(
                f"the profile would reach {to_mm:.2f} mm, the limit is {self._bench.config.safety.deepest_mm:g} mm; "
                "check the fixture"
            )
        path = Trapezoid(self._stage.position_mm, to_mm, speed_mm_s, self._stage.acceleration_mm_s2)
        began_s = self._clock.now_s()
        self._force_watch.braking_s = 0.5 * path.peak_mm_s / path.acceleration_mm_s2
        self._stage.begin(Move(to_mm, speed_mm_s))
        while self._stage.is_moving:
            self._tick()
            if self._clock.now_s() - began_s > path.duration_s + ARRIVAL_S:
                raise NoReply(f"stage: {ARRIVAL_S:g} s late at {to_mm:.2f} mm; look for what blocks it, then home it")
        self._moves.append(DrivenMove(path, began_s, self._clock.now_s()))

    def _wait(self, seconds: float) -> None:
        end_s = self._clock.now_s() + seconds
        while self._clock.now_s() < end_s:
            self._tick()

    def _do(self, step: Step, zero_mm: float) -> None:
        if isinstance(step, Move):
            self._go(zero_mm + step.to_mm, step.speed_mm_s)
        else:
            self._wait(step.seconds)

    def _take_zero(self) -> float:
        self._wait(0.3)
        if self._bench.force is None:
            self._wait(SETTLE_S)
            return 0.0
        count = len(self._readings.force)
        self._wait(SETTLE_S)
        zero_N = float(np.mean([sample.values[0] for sample in self._readings.force[count:]]))
        allowed_N = self._bench.config.safety.zero_N
        if abs(zero_N) > allowed_N:
            raise ZeroMoved(f"load cell: reads {zero_N:.3g} N unloaded, at most {allowed_N:g} N is allowed; zero it")
        self._force_watch.zero_N = zero_N
        return zero_N

    def _zero_return_N(self, zero_N: float) -> float:
        if self._bench.force is None:
            return 0.0
        recent = [s.values[0] for s in self._readings.force if s.host_s > self._clock.now_s() - 0.7 * SETTLE_S]
        change_N = float(np.mean(recent)) - zero_N
        allowed_N = self._bench.config.safety.zero_return_N
        if abs(change_N) > allowed_N:
            raise ZeroMoved(
                f"load cell: its zero moved by {change_N:.3g} N over the run, {allowed_N:g} N is allowed; let it warm "
                "up, check its mounting"
            )
        return change_N

    def _find_contact(self) -> float:
        """Lower slowly until force (or output, without a load cell) changes; return the position of the contact."""
        self._enter("searching for contact")
        bench, fixture = self._bench, self._bench.config.fixture
        search = Search(fixture, bench.force is not None, self._readings.force, self._readings.output)
        deepest_mm, began_s = bench.config.safety.deepest_mm, self._clock.now_s()
        path = Trapezoid(self._stage.position_mm, deepest_mm, fixture.search_mm_s, self._stage.acceleration_mm_s2)
        self._stage.begin(Move(deepest_mm, fixture.search_mm_s))
        while self._stage.is_moving:
            self._tick()
            if search.is_over():
                move = DrivenMove(path, began_s, self._clock.now_s())
                polls = [poll for poll in self._readings.polls if poll.host_s >= began_s]
                self._stage.stop()
                return search.contact_mm(reconstruct(polls, [move]).at)
        raise SafetyStop(
            f"no contact down to {bench.config.safety.deepest_mm:g} mm; is a unit in the fixture and connected?"
        )

    def _tell(self, fraction: float, remaining_s: float) -> None:
        if self._on_progress is None:
            return
        output, force, polls = self._readings.output, self._readings.force, self._readings.polls
        self._on_progress(
            RunProgress(
                self._phase,
                fraction,
                remaining_s,
                self._clock.now_s() - self._began_s,
                output[-1].values[0] if output else None,
                polls[-1].position_mm if polls else 0.0,
                force[-1].values[0] if force else None,
                self._bench.readout.unit,
            )
        )
