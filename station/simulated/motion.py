"""Motion of one axis: queued straight moves, constant acceleration, look-ahead, feed hold."""

import math
from collections import deque
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass


@dataclass
class QueuedMove:
    """A queued move to `target_mm` at `speed_mm_s`."""

    target_mm: float
    speed_mm_s: float


@dataclass(frozen=True)
class _Phase:
    seconds: float
    acceleration: float


class Axis:
    """A carriage driven by a planner.

    Blocks in one direction are joined without a stop as far as the queue reaches; a reversal goes through rest.
    `ends_s` is when the phase in progress ends, infinity at rest.
    """

    def __init__(self, acceleration_mm_s2: float) -> None:
        self.acceleration_mm_s2 = acceleration_mm_s2
        self.position_mm = 0.0
        self.deepest_mm = 0.0
        self.velocity_mm_s = 0.0
        self.time_s = 0.0
        self.queue: deque[QueuedMove] = deque()
        self.is_on_hold = False
        self.standstills_s: deque[float] = deque(maxlen=100)
        self._block, self._leave_mm_s = (1.0, 0.0, 0.0), 0.0
        self._set_phases(())

    @property
    def is_moving(self) -> bool:
        return bool(self._phases)

    def add(self, block: QueuedMove) -> None:
        self.queue.append(block)
        # Planned anew from here, the same way would differ in the last digit: units computed ahead would go back.
        if not self.is_on_hold and not (self._phases and self._exit_speed(*self._block) == self._leave_mm_s):
            self._plan()

    def hold(self) -> None:
        """Brake with the drive's acceleration to rest; the queue is kept."""
        self.is_on_hold = True
        braking_s = abs(self.velocity_mm_s) / self.acceleration_mm_s2
        braking = _Phase(braking_s, -math.copysign(self.acceleration_mm_s2, self.velocity_mm_s))
        self._set_phases((braking,) if braking_s > 0 else ())

    def brake(self) -> None:
        """Brake at the drive's acceleration and forget the queue."""
        speed = self.velocity_mm_s
        stop_mm = self.position_mm + math.copysign(speed**2 / (2 * self.acceleration_mm_s2), speed)
        self.queue.clear()
        self._set_phases(())
        if speed:
            self.add(QueuedMove(stop_mm, abs(speed)))

    def resume(self) -> None:
        """Continue the queue after a hold."""
        self.is_on_hold = False
        self._plan()

    def flush(self) -> None:
        """Clear the queue and stop at once, as a reset of the controller does."""
        self.queue.clear()
        self._set_phases(())
        if self.velocity_mm_s:
            self.standstills_s.append(self.time_s)
        self.velocity_mm_s = 0.0
        self.is_on_hold = False

    def advance(self, now_s: float) -> None:
        while self.ends_s <= now_s + 1e-12:
            self._update_position(self._phases[0].seconds)
            self.time_s = self.ends_s
            self._phases.popleft()
            if self._phases:
                self._set_phases(self._phases)
                continue
            if not self.is_on_hold:
                self.position_mm = self.queue.popleft().target_mm
            if self.is_on_hold or not self.queue or abs(self.velocity_mm_s) < 1e-9:
                self.velocity_mm_s = 0.0
                self.standstills_s.append(self.time_s)
            if self.is_on_hold:
                self._set_phases(())
            else:
                self._plan()
        if now_s > self.time_s:
            self.time_s = now_s
            if self._phases:
                self._update_position(now_s - self._began_s)

    def positions_mm(self, times_s: Iterable[float], is_fed: bool = False) -> list[float]:
        """Return the positions of the carriage at later, ascending times, without further commands.

        Args:
            is_fed: further commands come in time: end where the carriage would brake for want of them.
        """
        ahead = copy(self)
        ahead.queue, ahead._phases, ahead.standstills_s = copy(self.queue), copy(self._phases), deque()
        positions_mm = []
        for time_s in times_s:
            ahead.advance(time_s)
            if is_fed and self._phases and len(ahead.queue) <= 1 and len(ahead._phases) <= 1:
                break
            positions_mm.append(ahead.position_mm)
        return positions_mm

    def _set_phases(self, phases: Iterable[_Phase]) -> None:
        """Start the first of these phases at the present position and time."""
        self._phases = deque(phases)
        # Counted from the start of the phase: where it is must not depend on how often somebody looked.
        self._began_s, self._began_mm, self._began_mm_s = self.time_s, self.position_mm, self.velocity_mm_s
        self.ends_s = self.time_s + self._phases[0].seconds if self._phases else math.inf

    def _update_position(self, seconds: float) -> None:
        """Set the carriage to its position at a time after the start of the phase."""
        acceleration = self._phases[0].acceleration
        self.position_mm = self._began_mm + self._began_mm_s * seconds + 0.5 * acceleration * seconds**2
        self.velocity_mm_s = self._began_mm_s + acceleration * seconds
        self.deepest_mm = max(self.deepest_mm, self.position_mm)

    def _plan(self) -> None:
        self._set_phases(())
        while self.queue and abs(self.queue[0].target_mm - self.position_mm) < 1e-9:
            self.queue.popleft()
        if not self.queue:
            return
        block = self.queue[0]
        direction = math.copysign(1.0, block.target_mm - self.position_mm)
        distance = abs(block.target_mm - self.position_mm)
        entry = max(0.0, self.velocity_mm_s * direction)
        self._block = direction, distance, entry
        leave = self._leave_mm_s = self._exit_speed(*self._block)
        self._set_phases(_trapezoid(distance, entry, block.speed_mm_s, leave, self.acceleration_mm_s2, direction))

    def _exit_speed(self, direction: float, distance: float, entry: float) -> float:
        """The fastest speed at the end of this block from which the rest of the queue can stop."""
        way, speed, previous = 0.0, math.inf, self.queue[0].target_mm
        for block in list(self.queue)[1:]:
            step = (block.target_mm - previous) * direction
            if step <= 0:
                break
            way, previous = way + step, block.target_mm
            speed = min(speed, block.speed_mm_s)
        a = self.acceleration_mm_s2
        limits = (speed, self.queue[0].speed_mm_s, math.sqrt(2 * a * way), math.sqrt(entry**2 + 2 * a * distance))
        return min(limits)


def _trapezoid(distance: float, entry: float, cruise: float, leave: float, a: float, direction: float) -> list[_Phase]:
    if entry**2 - leave**2 > 2 * a * distance:  # cannot brake in time at `a`: brake as hard as it takes
        return [_Phase(2 * distance / (entry + leave), direction * (leave**2 - entry**2) / (2 * distance))]
    peak = min(max(cruise, leave), math.sqrt(a * distance + (entry**2 + leave**2) / 2))
    ends = (entry**2 - peak**2) / (2 * a) if entry > peak else (peak**2 - entry**2) / (2 * a)
    cruise_mm = distance - ends - (peak**2 - leave**2) / (2 * a)
    phases = [
        _Phase(abs(peak - entry) / a, direction * math.copysign(a, peak - entry)),
        _Phase(max(0.0, cruise_mm) / peak, 0.0),
        _Phase((peak - leave) / a, -direction * a),
    ]
    return [phase for phase in phases if phase.seconds > 1e-12]
