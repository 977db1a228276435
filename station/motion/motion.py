"""The only module that moves a stage: each move is monitored, has a deadline, and ends at rest or in a stop.

Nothing else in softcal calls `home`, `begin` or `stop` of a stage; `tests/station/test_hazards.py` holds that.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

import numpy as np

from softcal.core.errors import BadReply, DeviceError, NoReply, SafetyStop
from softcal.core.messages.reason import Reason, reason
from softcal.station.bench.bench import Bench
from softcal.station.interfaces import Move, RoughLiftStage, SelfStoppingStage, StageOnHold
from softcal.station.motion.interlock import Interlock, State
from softcal.station.motion.monitors import LASTS_S
from softcal.station.trajectory import DrivenMove, Trapezoid

TICK_S = 0.005
"""How often devices are read while something may move; far below every promised latency."""

RETRACT_MM_S, LIFT_MM = 5.0, 1.0
"""A stage is lifted so fast at most and so far at least, wherever it stood."""

FINAL_READING_S = 1.5
"""How long load cell and sensor are read to say what stands on the unit: readings may be old, a unit comes back."""

STILL_S, STILL_MM, UNFED_S = 0.5, 0.1, 0.2
"""A stage that should have gone so far since its position changed last, so long ago, does not move or does not say; but
not where nothing was sent for a while."""

REST = 0.5
"""A load cell within this share of the contact force is at rest."""

_T = TypeVar("_T")


class Cancelled(DeviceError):
    """A person requested a stop."""


class StoppedByHand(Cancelled):
    """A person stopped the run at the keyboard."""


class Motion(Interlock):
    """The moves of one run, as far as its state lets the stage move.

    Args:
        tick: waits a short time, reads every device and raises faults; called throughout every move.
        ahead_mm: (target of a downward move, speed) -> how far ahead its controller may have commands.
    """

    def __init__(
        self,
        bench: Bench,
        tick: Callable[[], None],
        ahead_mm: Callable[[float, float], float] = lambda to_mm, speed_mm_s: math.inf,
    ) -> None:
        super().__init__()
        self._bench, self._clock, self._stage, self._tick = bench, bench.clock, bench.stage, tick
        self._ahead_mm = ahead_mm
        self._path: Trapezoid | None = None
        self._cell: list[tuple[float, float]] = []  # (arrival, value) of every reading since the stop
        self._output: list[tuple[float, float]] = []
        self.zero_N: float | None = None
        self.free_output: float | None = None  # What the sensor shows with nothing on it.

    @property
    def speed_mm_s(self) -> float:
        """Largest speed of the move in progress in mm/s; 0 at rest."""
        return 0.0 if self._path is None else self._path.peak_mm_s

    @property
    def remaining_mm(self) -> float:
        return 0.0 if self._path is None else abs(self._path.end_mm - self._stage.position_mm)

    @property
    def is_lowering(self) -> bool:
        return self._path is not None and self._path.end_mm > self._path.start_mm

    def supervise(self, action: Callable[[], _T]) -> _T:
        """Return the result of an action; after an exception make the stage safe and add its state to the message."""
        try:
            result = action()
            self.enter(State.OVER)
            return result
        except KeyboardInterrupt as stop:
            raise StoppedByHand(reason("rig.keyboard", state=self.make_safe(stop))) from stop
        except DeviceError as error:
            raise type(error)(reason("rig.aborted", why=error.reason, state=self.make_safe(error))) from error
        except BaseException as error:
            self.make_safe(error)
            raise

    def home(self, on_wait: Callable[[], None]) -> None:
        """Home the stage; an exception of `on_wait` ends it, and `NoReply` after its deadline."""
        self.enter(State.HOMING)
        end_s = self._clock.now_s() + self.row.late_s

        def check_deadline() -> None:
            on_wait()
            if self._clock.now_s() > end_s:
                raise NoReply(reason("rig.not_home", seconds=self.row.late_s))

        self._stage.home(check_deadline)

    def go(self, to_mm: float, speed_mm_s: float, is_over: Callable[[], bool] | None = None) -> DrivenMove:
        """Move to a position, or until `is_over`, and wait for rest.

        Raises:
            SafetyStop: deeper than allowed; nothing was sent.
            BadReply: its position does not change.
            NoReply: late.
        """
        deepest_mm = self._bench.config.safety.deepest_mm
        if to_mm > deepest_mm:
            raise SafetyStop(reason("rig.too_deep", to_mm=to_mm, deepest_mm=deepest_mm))
        path = Trapezoid(self._stage.position_mm, to_mm, speed_mm_s, self._stage.acceleration_mm_s2)
        began_s = self._clock.now_s()
        is_down = to_mm > self._stage.position_mm
        self.check_move(is_down)
        self._path = path
        self._stage.begin(Move(to_mm, speed_mm_s, self._ahead_mm(to_mm, speed_mm_s) if is_down else math.inf))
        changed_s, checked_s, at_mm = began_s, began_s, self._stage.position_mm
        while self._stage.is_moving:
            self._tick()
            before_s, checked_s = checked_s, self._clock.now_s()
            # A stage that nobody fed for a while may stand for as long.
            if self._stage.position_mm != at_mm or checked_s - before_s > UNFED_S:
                changed_s, at_mm = checked_s, self._stage.position_mm
            self._check_still(path, began_s, changed_s)
            if is_over is not None and is_over():
                move = DrivenMove(path, began_s, self._clock.now_s())
                self._stage.stop()
                if not self._stage.is_position_known:
                    raise DeviceError(Reason("rig.lost.at_touch"))
                self._path = None
                return move
            if self._clock.now_s() - began_s > path.duration_s + self.row.late_s:
                raise NoReply(reason("rig.late", seconds=self.row.late_s, to_mm=to_mm))
        self._path = None
        return DrivenMove(path, began_s, self._clock.now_s())

    def _check_still(self, path: Trapezoid, began_s: float, changed_s: float) -> None:
        """Raise `BadReply` where the position has stayed while the stage should have moved."""
        now_s = self._clock.now_s()
        if now_s - changed_s > STILL_S:
            before_mm, after_mm = path.position_mm(np.array([changed_s, now_s]) - began_s)
            if abs(after_mm - before_mm) > STILL_MM:
                about = {"at_mm": self._stage.position_mm, "seconds": now_s - changed_s}
                raise BadReply(reason("rig.still", **about))

    def wait(self, seconds: float) -> None:
        end_s = self._clock.now_s() + seconds
        while self._clock.now_s() < end_s:
            self._tick()

    def make_safe(self, cause: BaseException) -> Reason:
        """Stop the stage, lift it if that is safe, and return a message with the action and the remaining load.

        It lifts if the position is valid, or was lost by the stop alone. It never lifts during a hold at the
        stage, after a door, an emergency stop or an alarm, nor a second time after an interruption.
        """
        if self.state in (State.STOPPED, State.OVER):
            return self._report_stop(Reason("left.stopped"))
        self.enter(State.STOPPING)
        self._path, self._cell, self._output = None, [], []
        try:
            return self._stop_and_lift(cause)
        except KeyboardInterrupt:  # A second interruption: stand, wherever it is.
            is_lifting = self.state is not State.STOPPING
            self._stop_quietly()
            return self._report_stop(Reason("left.told" if is_lifting else "left.there"))

    def _stop_and_lift(self, cause: BaseException) -> Reason:
        try:
            self._stage.stop()
        except StageOnHold:
            return self._report_stop(Reason("left.held"))
        except DeviceError:
            self.enter(State.STOPPED)
            if not isinstance(self._stage, SelfStoppingStage):
                return Reason("left.unreachable")
            return reason("left.runs_on", seconds=self._stage.runs_on_s(self._bench.config.safety.speed_mm_s))
        if isinstance(cause, StageOnHold):
            return self._report_stop(Reason("left.held"))
        if not isinstance(cause, (Exception, KeyboardInterrupt)):
            return self._report_stop(Reason("left.stopped"))
        can_lift_roughly = isinstance(self._stage, RoughLiftStage) and self._stage.can_lift_roughly
        if not self._stage.is_position_known and not can_lift_roughly:
            return self._report_stop(Reason("left.must_home"))
        return self._lift()

    def _lift(self) -> Reason:
        stage = self._stage
        # Never deeper; what is in the way above the approach is let go as well.
        to_mm = max(0.0, min(self._bench.config.fixture.approach_mm, stage.position_mm - LIFT_MM))
        speed_mm_s = min(RETRACT_MM_S, stage.max_speed_mm_s)
        path = Trapezoid(stage.position_mm, to_mm, speed_mm_s, stage.acceleration_mm_s2)
        self.enter(State.LIFTING)
        self._take_readings()
        try:
            if path.start_mm > path.end_mm:
                self._begin_lift(path)
                self._follow_lift(self._clock.now_s() + path.duration_s + self.row.late_s)
        except StageOnHold:
            return self._report_stop(Reason("left.held"))
        except DeviceError:
            self._stop_quietly()
            return self._report_stop(Reason("left.not_lifted"))
        return self._confirm_lift()

    def _begin_lift(self, path: Trapezoid) -> None:
        self.check_move(path.end_mm > path.start_mm)
        if not self._stage.is_position_known and isinstance(self._stage, RoughLiftStage):
            self._stage.lift_roughly(path.start_mm - path.end_mm, path.speed_mm_s)
        else:
            self._stage.begin(Move(path.end_mm, path.speed_mm_s))

    def _follow_lift(self, end_s: float) -> None:
        while self._stage.is_moving:
            self._clock.sleep_s(TICK_S)
            with suppress(BadReply):  # A line with noise says nothing about the lift; silence and alarms do.
                self._stage.poll()
            self._take_readings()
            if self._clock.now_s() > end_s:
                raise NoReply(Reason("rig.late.lifting"))

    def _confirm_lift(self) -> Reason:
        """Return whether the stage is lifted, by a load cell back at zero; the controller's count is no evidence.

        A cell that showed no force before may be dead: then the sensor must be at rest, too.
        """
        fixture, force_N = self._bench.config.fixture, self._read_force_N()
        if force_N is not None and abs(force_N) > fixture.contact_N:
            return self._report_state(Reason("left.stays"), force_N)
        has_fallen = max((value for _, value in self._cell), default=0.0) - (self.zero_N or 0.0) > fixture.contact_N
        output, free = self._newest(self._output), self.free_output
        is_output_free = output is not None and free is not None and abs(output - free) <= fixture.contact_output
        if force_N is None or abs(force_N) > REST * fixture.contact_N or not (has_fallen or is_output_free):
            return self._report_state(Reason("left.told"), force_N)
        self.enter(State.STOPPED)
        return Reason("left.lifted" if self._stage.is_position_known else "left.lifted_roughly")

    def _stop_quietly(self) -> None:
        with suppress(DeviceError):  # It was told to stop all the same.
            self._stage.stop()

    def _report_stop(self, state: Reason) -> Reason:
        """Return the message for a stage that stays in place, with the remaining load."""
        return self._report_state(state, self._read_force_N())

    def _report_state(self, state: Reason, force_N: float | None) -> Reason:
        if self.state in (State.STOPPING, State.LIFTING):
            self.enter(State.STOPPED)
        if force_N is None:
            return reason("left.may_stand", state=state)
        if not self._stage.is_position_known:
            return reason("left.stands_lost", state=state, force_N=force_N)
        return reason("left.stands", state=state, force_N=force_N, at_mm=self._stage.position_mm)

    def _read_force_N(self) -> float | None:
        """Return the last force of the load cell; None if it is silent or has no zero."""
        if self._bench.force is None or self.zero_N is None:
            return None
        end_s = self._clock.now_s() + FINAL_READING_S
        while self._clock.now_s() < end_s:
            self._clock.sleep_s(TICK_S)
            self._take_readings()
        reading_N = self._newest(self._cell)
        return None if reading_N is None else reading_N - self.zero_N

    def _take_readings(self) -> None:
        """Read load cell and sensor; ignore a device that fails."""
        for reader, readings in ((self._bench.force, self._cell), (self._bench.readout, self._output)):
            try:
                readings += [(self._clock.now_s(), sample.values[0]) for sample in (reader.poll() if reader else ())]
            except DeviceError:
                readings.clear()

    def _newest(self, readings: Sequence[tuple[float, float]]) -> float | None:
        """Return the mean of what came just now; None where nothing did."""
        values = [value for arrival_s, value in readings if arrival_s > self._clock.now_s() - LASTS_S]
        return sum(values) / len(values) if values else None
