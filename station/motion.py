"""The one place that moves a stage: each move is watched, has a deadline, ends standing or in a stop that says so.

Nothing else in softcal calls `home`, `begin` or `stop` of a stage; `tests/station/test_holes.py` holds that.
"""

import math
from collections.abc import Callable
from typing import TypeVar

from softcal.core.errors import BadReply, DeviceError, NoReply, SafetyStop
from softcal.core.words.reason import Reason, reason
from softcal.station.bench import Bench
from softcal.station.interfaces import Held, Move, RoughLift, RunsOn
from softcal.station.interlock import Event, Interlock, State
from softcal.station.trajectory import DrivenMove, Trapezoid

TICK_S = 0.005
"""How often the devices are read while something may move; far below every latency that is promised."""

ARRIVAL_S = 2.0
"""A move that takes this much longer than planned has failed."""

HOMING_S = 90.0
RETRACT_MM_S = 5.0
READ_S = 0.3
"""How long the load cell is read to say what stands on the unit."""

LIFT_MM = 1.0
"""A stage is lifted at least so far, wherever it stood."""

AT_MM = 0.05
"""A stage this near to where it was to be lifted is lifted."""

_T = TypeVar("_T")


class Cancelled(DeviceError):
    """Somebody asked for a stop."""


class StoppedByHand(Cancelled):
    """Somebody stopped the run at the keyboard."""


class Motion:
    """The moves of one run.

    Args:
        bench: open devices.
        tick: lets a little time pass, reads every device and raises what is wrong; called all through every move.
        ahead_mm: (position to go down to, speed) -> how far ahead its controller may be told to go.
    """

    def __init__(
        self,
        bench: Bench,
        tick: Callable[[], None],
        ahead_mm: Callable[[float, float], float] = lambda to_mm, speed_mm_s: math.inf,
    ) -> None:
        self._bench, self._clock, self._stage, self._tick = bench, bench.clock, bench.stage, tick
        self._ahead_mm = ahead_mm
        self._interlock = Interlock()
        self._path: Trapezoid | None = None
        self._force_N: float | None = None
        self.zero_N = 0.0

    @property
    def state(self) -> State:
        """What the stage is doing."""
        return self._interlock.state

    @property
    def speed_mm_s(self) -> float:
        """Largest speed of the move in progress; 0 while the stage stands."""
        return 0.0 if self._path is None else self._path.peak_mm_s

    @property
    def left_mm(self) -> float:
        """How far the move in progress still goes."""
        return 0.0 if self._path is None else abs(self._path.end_mm - self._stage.position_mm)

    @property
    def is_lowering(self) -> bool:
        """Whether the stage goes towards the unit."""
        return self.state is State.LOWERING

    def supervise(self, action: Callable[[], _T]) -> _T:
        """Return what an action gives; whatever it raises, the stage is made safe first and the message says how.

        Raises:
            DeviceError: as raised, with what became of the stage.
            StoppedByHand: Ctrl-C.
        """
        try:
            result = action()
            self._interlock.take(Event.END)
            return result
        except KeyboardInterrupt as stop:
            raise StoppedByHand(reason("rig.keyboard", state=self.make_safe(stop))) from stop
        except DeviceError as error:
            raise type(error)(reason("rig.aborted", why=error.reason, state=self.make_safe(error))) from error
        except BaseException as error:
            self.make_safe(error)
            raise

    def home(self, on_wait: Callable[[], None]) -> None:
        """Home the stage.

        Args:
            on_wait: called every few milliseconds; what it raises ends the homing.

        Raises:
            DeviceError: as the stage, or it took too long.
        """
        end_s = self._clock.now_s() + HOMING_S

        def watch() -> None:
            on_wait()
            if self._clock.now_s() > end_s:
                raise NoReply(reason("rig.not_home", seconds=HOMING_S))

        self._interlock.take(Event.HOME)
        self._stage.home(watch)
        self._interlock.take(Event.ARRIVED)

    def go(self, to_mm: float, speed_mm_s: float, is_over: Callable[[], bool] | None = None) -> DrivenMove:
        """Go to a position, or until `is_over`, and stand there.

        Raises:
            SafetyStop: deeper than allowed; nothing was sent.
            NoReply: late.
            DeviceError: whatever tick and stage raise.
        """
        self._check_depth(to_mm)
        path = Trapezoid(self._stage.position_mm, to_mm, speed_mm_s, self._stage.acceleration_mm_s2)
        began_s = self._clock.now_s()
        is_down = to_mm > self._stage.position_mm
        self._interlock.take(Event.LOWER if is_down else Event.RAISE)
        self._path = path
        self._stage.begin(Move(to_mm, speed_mm_s, self._ahead_mm(to_mm, speed_mm_s) if is_down else math.inf))
        while self._stage.is_moving:
            self._tick()
            if is_over is not None and is_over():
                return self._brake(path, began_s)
            if self._clock.now_s() - began_s > path.duration_s + ARRIVAL_S:
                raise NoReply(reason("rig.late", seconds=ARRIVAL_S, to_mm=to_mm))
        self._arrive()
        return DrivenMove(path, began_s, self._clock.now_s())

    def wait(self, seconds: float) -> None:
        """Stand and watch for so long."""
        end_s = self._clock.now_s() + seconds
        while self._clock.now_s() < end_s:
            self._tick()

    def make_safe(self, cause: BaseException) -> Reason:
        """Stop the stage, lift it where that is safe, and say what was done and what stands on the unit.

        It lifts where the position is known, or was lost by the stop alone. It never lifts while somebody holds the
        stage, after a door, an emergency stop or an alarm, nor a second time after an interruption.
        """
        if self.state in (State.STOPPED, State.OVER):
            return self._left(Reason("left.stopped"))
        self._interlock.take(Event.FAULT)
        self._path = None
        try:
            return self._stop_and_lift(cause)
        except KeyboardInterrupt:
            return self._stop_again()

    def _brake(self, path: Trapezoid, began_s: float) -> DrivenMove:
        move = DrivenMove(path, began_s, self._clock.now_s())
        self._interlock.take(Event.BRAKE)
        self._stage.stop()
        if not self._stage.is_position_known:
            raise DeviceError(Reason("rig.lost.at_touch"))
        self._arrive()
        return move

    def _arrive(self) -> None:
        self._path = None
        self._interlock.take(Event.ARRIVED)

    def _check_depth(self, to_mm: float) -> None:
        deepest_mm = self._bench.config.safety.deepest_mm
        if to_mm > deepest_mm:
            raise SafetyStop(reason("rig.too_deep", to_mm=to_mm, deepest_mm=deepest_mm))

    def _stop_and_lift(self, cause: BaseException) -> Reason:
        try:
            self._stage.stop()
        except Held:
            return self._left(Reason("left.held"))
        except DeviceError:
            self._interlock.take(Event.LEAVE)
            return self._unreachable()
        if isinstance(cause, Held):
            return self._left(Reason("left.held"))
        if not isinstance(cause, (Exception, KeyboardInterrupt)):
            return self._left(Reason("left.stopped"))
        if self._stage.is_position_known:
            return self._lift()
        if isinstance(self._stage, RoughLift) and self._stage.can_lift_roughly:
            return self._lift()
        return self._left(Reason("left.must_home"))

    def _lift(self) -> Reason:
        stage = self._stage
        # Never deeper; what is in the way above the approach is let go as well.
        to_mm = max(0.0, min(self._bench.config.fixture.approach_mm, stage.position_mm - LIFT_MM))
        speed_mm_s = min(RETRACT_MM_S, stage.max_speed_mm_s)
        path = Trapezoid(stage.position_mm, to_mm, speed_mm_s, stage.acceleration_mm_s2)
        self._interlock.take(Event.LIFT)
        try:
            if path.start_mm > path.end_mm:
                self._begin_lift(path)
                self._follow_lift(self._clock.now_s() + path.duration_s + ARRIVAL_S)
        except Held:
            return self._left(Reason("left.held"))
        except DeviceError:
            return self._not_lifted(to_mm)
        self._interlock.take(Event.ARRIVED)
        if stage.is_position_known:
            return Reason("left.lifted")
        return Reason("left.lifted_roughly")

    def _begin_lift(self, path: Trapezoid) -> None:
        if not self._stage.is_position_known and isinstance(self._stage, RoughLift):
            self._stage.lift_roughly(path.start_mm - path.end_mm, path.speed_mm_s)
        else:
            self._stage.begin(Move(path.end_mm, path.speed_mm_s))

    def _follow_lift(self, end_s: float) -> None:
        while self._stage.is_moving:
            self._clock.sleep_s(TICK_S)
            try:
                self._stage.poll()
            except BadReply:
                pass  # A line with noise says nothing about the lift; silence and alarms do.
            self._read_force()
            if self._clock.now_s() > end_s:
                raise NoReply(Reason("rig.late.lifting"))

    def _not_lifted(self, to_mm: float) -> Reason:
        is_up = self._stage.is_position_known and self._stage.position_mm <= to_mm + AT_MM
        try:
            self._stage.stop()
        except DeviceError:
            pass  # It was told to stop; what it says is of no use any more.
        if is_up:
            self._interlock.take(Event.LEAVE)
            return Reason("left.lifted")
        return self._left(Reason("left.not_lifted"))

    def _stop_again(self) -> Reason:
        """A second interruption: stand, wherever it is."""
        try:
            self._stage.stop()
        except DeviceError:
            pass  # It was told to stop all the same.
        return self._left(Reason("left.there"))

    def _unreachable(self) -> Reason:
        if isinstance(self._stage, RunsOn):
            s = self._stage.runs_on_s(self._bench.config.safety.speed_mm_s)
            return reason("left.runs_on", seconds=s)
        return Reason("left.unreachable")

    def _left(self, state: Reason) -> Reason:
        """Return what became of a stage that stays where it is, with what stands on the unit."""
        if self.state in (State.STOPPING, State.LIFTING):
            self._interlock.take(Event.LEAVE)
        end_s = self._clock.now_s() + READ_S
        self._force_N = None
        while self._bench.force is not None and self._clock.now_s() < end_s:
            self._clock.sleep_s(TICK_S)
            self._read_force()
        if self._force_N is None:
            return reason("left.may_stand", state=state)
        return reason("left.stands", state=state, force_N=self._force_N)

    def _read_force(self) -> None:
        force = self._bench.force
        if force is None:
            return
        try:
            for sample in force.poll():
                self._force_N = sample.values[0] - self.zero_N
        except DeviceError:
            self._force_N = None
