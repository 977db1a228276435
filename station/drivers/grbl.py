"""Driver of a GRBL 1.1 or grblHAL stage with one axis (gnea/grbl wiki, "Grbl v1.1 Interface")."""

from collections import deque
from contextlib import suppress
from dataclasses import dataclass

from softcal.core.errors import BadReply, CommandRefused, DeviceError, NoReply
from softcal.core.messages.reason import Reason, reason
from softcal.station.devices.config import StageConfig, check_choice
from softcal.station.devices.driver import Driver, Simulated, make_opener
from softcal.station.devices.piece_feed import PieceFeed, runs_on_mm, runs_on_s
from softcal.station.drivers.admission import admit
from softcal.station.drivers.grbl_settings import ANSWER_S, read_settings
from softcal.station.interfaces import Move, OnWait, StageOnHold, StagePosition, ignore_wait
from softcal.station.messages import PAGES
from softcal.station.simulated.grbl import SimulatedGrbl
from softcal.station.trajectory import Trapezoid
from softcal.station.wire.frames import grbl
from softcal.station.wire.link import POLL_S, Link

STATUS_S = 0.1
"""Status polls: ten a second is the controller's limit."""

SILENCE_S = 0.25
"""A controller that leaves a status poll unanswered for so long is gone."""

MARGIN = 1.5
"""A stop may take this much longer than the deceleration in the settings says."""

OFF_SWITCH_MM = 1.0
"""A stage whose position is only roughly known keeps so far from its homing switch."""

HOMING_S = 60.0


@dataclass(frozen=True)
class GrblConfig(StageConfig):
    """A GRBL or grblHAL controller.

    Args:
        baud_rate: of its port.
        axis: letter of the axis that presses.
        is_reversed: whether pressing is the negative machine direction.
    """

    kind: str = "grbl"
    baud_rate: int = 115200
    axis: str = "Z"
    is_reversed: bool = True

    def __post_init__(self) -> None:
        check_choice("stage.axis", self.axis, ("X", "Y", "Z"))


class GrblStage:
    """One axis of a GRBL controller, positive when it compresses, 0 at the homing switch.

    Args:
        is_reversed: whether pressing is the negative machine direction, as for a Z axis that homes at the top.

    Raises:
        NoReply: no GRBL answers on this port.
        CommandRefused: homing is disabled, or positions are reported in inches.
    """

    name = "stage"

    def __init__(self, link: Link, axis: str = "Z", is_reversed: bool = True) -> None:
        self._link, self._axis, self._index = link, axis, "XYZ".index(axis)
        self._sign = -1.0 if is_reversed else 1.0
        self._offset_mm: tuple[float, ...] | None = None
        self.is_position_known = self._is_homing = False
        self._in_flight: deque[int] = deque()
        self._feed: PieceFeed | None = None
        self._speed_mm_s = self._peak_mm_s = 0.0
        self._is_button_pressed = self._is_alarmed = self.can_lift_roughly = False
        self._query_s: float | None = None
        self._next_status_s = 0.0
        self.position_mm = self._target_mm = 0.0
        for _ in range(4):  # A boot loader swallows the first tries.
            link.discard()
            link.write(grbl.RESET)
            with suppress(NoReply):
                self._wait_for_greeting(1.2)
                break
        else:
            raise NoReply(reason("grbl.none", port=link.port))
        self.settings = read_settings(link, self._index)
        self.travel_mm, self.max_speed_mm_s, self.acceleration_mm_s2 = self.settings.drive

    @property
    def is_moving(self) -> bool:
        return bool(self._feed is not None or self._in_flight)

    def home(self, on_wait: OnWait = ignore_wait) -> None:
        self.is_position_known = self.can_lift_roughly = False
        self._forget_motion()
        self._link.discard()
        self._link.write(grbl.RESET)  # A hard-limit alarm ignores even homing until a reset.
        self._wait_for_greeting(ANSWER_S)
        self._link.clock.sleep_s(0.05)
        self._link.discard()
        self._link.write(grbl.HOME)
        self._is_homing = True
        self._wait_until_homed(on_wait)
        self.is_position_known, self._is_homing = True, False
        self._await_status()

    def begin(self, move: Move) -> None:
        admit(self, move)
        path = Trapezoid(self.position_mm, move.to_mm, move.speed_mm_s, self.acceleration_mm_s2)
        self._target_mm, self._speed_mm_s = move.to_mm, move.speed_mm_s
        self._peak_mm_s = path.peak_mm_s
        self._feed = PieceFeed(path, move.ahead_mm, self._link.clock.now_s())
        self._send_due()

    def poll(self) -> list[StagePosition]:
        positions = []
        for line in self._link.read_lines():
            reply = grbl.parse(line.text)
            if isinstance(reply, grbl.Ok) and self._in_flight:
                self._in_flight.popleft()
                if not self.is_moving:
                    self.position_mm = self._target_mm  # Newer than the last status poll.
            elif isinstance(reply, grbl.GrblRefusal):
                raise CommandRefused(reason("grbl.refused", reply=reply.reason))
            elif isinstance(reply, grbl.Alarm):
                self.is_position_known = self.is_position_known and not reply.loses_position
                raise DeviceError(reason("grbl.alarm", reply=reply.reason))
            elif isinstance(reply, grbl.Greeting):
                self.is_position_known = False
                raise DeviceError(Reason("grbl.restarted"))
            elif isinstance(reply, grbl.GrblStatus):
                query_s = line.host_s if self._query_s is None else self._query_s
                self._query_s = None
                self._is_button_pressed = "H" in reply.pins
                if reply.state == "Hold":
                    raise StageOnHold(Reason("grbl.held"))
                if reply.state == "Door":
                    raise DeviceError(Reason("grbl.door"))
                if reply.state in ("Alarm", "Sleep"):
                    self.is_position_known = False
                    raise DeviceError(reason("grbl.state", state=reply.state))
                self._offset_mm = reply.offset_mm or self._offset_mm
                self.position_mm = self._sign * self._machine_mm(reply)
                positions.append(StagePosition((query_s + line.host_s) / 2, self.position_mm))
        now_s = self._link.clock.now_s()
        if self._query_s is not None and now_s - self._query_s > SILENCE_S:
            raise NoReply(reason("grbl.no_status", seconds=SILENCE_S))
        self._send_due()
        if self._query_s is None and now_s >= self._next_status_s:
            self._ask_status(now_s)
        return positions

    def stop(self) -> None:
        """Brake with feed hold, then reset: both are real-time bytes that wait behind nothing.

        A reset after a complete hold keeps the position; one in motion would lose it. How long braking takes follows
        from the speed and the deceleration of the drive. Only a stage that is far beyond it is cut off in motion.
        """
        answers_before = 0 if self._query_s is None else 1
        self._forget_motion()
        self._link.write(grbl.HOLD)
        self._link.discard()
        # Homing ignores the hold and answers no poll: only a reset ends it, and there is no position to lose.
        was_homing, was_homed = self._is_homing, self.is_position_known
        has_stopped = not was_homing and self._has_stopped(answers_before)
        self._is_homing = False
        self._link.write(grbl.RESET)
        self.is_position_known = was_homed and has_stopped
        self._wait_for_greeting(ANSWER_S)
        # Cut by our own reset, nothing else: the count is a few steps wrong.
        self.can_lift_roughly = was_homed and not has_stopped and not was_homing and not self._is_alarmed
        if self.is_position_known:
            self._await_status()
        if self._is_button_pressed:
            raise StageOnHold(Reason("grbl.held.now"))

    def lift_roughly(self, distance_mm: float, speed_mm_s: float) -> None:
        distance_mm = min(distance_mm, self.position_mm - OFF_SWITCH_MM)
        if not self.can_lift_roughly or distance_mm <= 0.0:
            raise CommandRefused(Reason("grbl.lost"))
        self._link.discard()
        lines = (
            grbl.UNLOCK,
            grbl.move_line(self._axis, -self._sign * distance_mm, min(speed_mm_s, self.max_speed_mm_s), True),
            grbl.SYNCHRONISE,
        )
        self._target_mm = self.position_mm - distance_mm
        self._next_status_s = self._link.clock.now_s() + STATUS_S  # Until it is unlocked it reports an alarm.
        for line in lines:
            self._in_flight.append(len(line))
            self._link.write(line)

    def unsafe_settings(self) -> list[tuple[str, Reason]]:
        return self.settings.list_unsafe()

    def runs_on_s(self, speed_mm_s: float) -> float:
        return runs_on_s(speed_mm_s, self.acceleration_mm_s2)

    def runs_on_mm(self, move: Move) -> float:
        return runs_on_mm(move, self.acceleration_mm_s2)

    def close(self) -> None:
        self._link.close()

    def _send_due(self) -> None:
        """Send the pieces that are due, and at last the line that proves the end of the move."""
        now_s = self._link.clock.now_s()
        while self._feed:
            ends_mm = self._feed.due_mm(now_s)
            if ends_mm is None or not self._send(grbl.move_line(self._axis, self._sign * ends_mm, self._speed_mm_s)):
                return
            self._feed.mark_sent(now_s)
        if self._feed is not None and self._send(grbl.SYNCHRONISE):
            self._feed = None

    def _send(self, line: bytes) -> bool:
        """Send a line if the controller's buffer has room for it, and return whether it had."""
        if sum(self._in_flight) + len(line) > grbl.LINE_LENGTH:
            return False
        self._in_flight.append(len(line))
        self._link.write(line)
        return True

    def _machine_mm(self, status: grbl.GrblStatus) -> float:
        if status.machine_mm is not None:
            return status.machine_mm[self._index]
        if status.work_mm is None or self._offset_mm is None:
            raise BadReply(Reason("grbl.no_position"))
        return status.work_mm[self._index] + self._offset_mm[self._index]

    def _ask_status(self, now_s: float) -> None:
        self._link.write(grbl.STATUS)
        self._query_s = now_s
        self._next_status_s = now_s + STATUS_S

    def _await_status(self) -> None:
        self._ask_status(self._link.clock.now_s())
        while not self.poll():
            self._link.clock.sleep_s(POLL_S)

    def _forget_motion(self) -> None:
        self._feed = None
        self._in_flight.clear()
        self._query_s = None

    def _has_stopped(self, answers_before: int) -> bool:
        """Poll until the controller reports rest; answers to polls from before the stop are ignored."""
        self._is_alarmed = False
        reply_s = self._link.clock.now_s()
        end_s = reply_s + 2 * SILENCE_S + MARGIN * self._peak_mm_s / self.acceleration_mm_s2
        while self._link.clock.now_s() < min(end_s, reply_s + 2 * SILENCE_S):
            self._link.write(grbl.STATUS)
            try:
                line = self._link.next_line(SILENCE_S)
                reply = grbl.parse(line.text)
            except (BadReply, NoReply):
                continue
            # Something other than a hold ended the motion: then nothing moves by itself.
            is_locked = isinstance(reply, grbl.GrblStatus) and reply.state in ("Alarm", "Door", "Sleep", "Home")
            if isinstance(reply, grbl.Alarm | grbl.Greeting) or is_locked:
                self._is_alarmed = True
                return False
            if isinstance(reply, grbl.GrblStatus):
                reply_s, self._is_button_pressed = line.host_s, "H" in reply.pins
                self.position_mm = self._sign * self._machine_mm(reply)
                is_at_rest = (reply.state, reply.substate) in (("Hold", 0), ("Idle", 0))
                if is_at_rest and answers_before <= 0:
                    return True
                answers_before -= 1
            self._link.clock.sleep_s(0.02)
        self._is_alarmed = self._link.clock.now_s() >= reply_s + 2 * SILENCE_S
        return False

    def _wait_for_greeting(self, within_s: float) -> None:
        end_s = self._link.clock.now_s() + within_s
        while True:
            line = self._link.next_line(max(0.0, end_s - self._link.clock.now_s()))
            try:
                reply = grbl.parse(line.text)
            except BadReply:
                continue  # Replies that were on the way are cut by the reset.
            if isinstance(reply, grbl.Alarm):
                self.is_position_known = False  # The reset cut a motion.
            if isinstance(reply, grbl.Greeting):
                return

    def _wait_until_homed(self, on_wait: OnWait) -> None:
        end_s = self._link.clock.now_s() + HOMING_S
        while self._link.clock.now_s() < end_s:
            for line in self._link.read_lines():
                reply = grbl.parse(line.text)
                if isinstance(reply, grbl.Ok):
                    return
                if isinstance(reply, grbl.GrblRefusal):
                    self._is_homing = False
                    raise CommandRefused(reason("grbl.homing_refused", reply=reply.reason))
                if isinstance(reply, grbl.Alarm | grbl.Greeting):
                    self._is_homing = False
                    cause = reply.reason if isinstance(reply, grbl.Alarm) else Reason("grbl.part.restarted")
                    raise DeviceError(reason("grbl.homing_failed", why=cause))
            self._link.clock.sleep_s(POLL_S)
            on_wait()
        raise NoReply(reason("rig.not_home", seconds=HOMING_S))


DRIVERS = (
    Driver(
        "grbl",
        "GRBL 1.1 and grblHAL controllers",
        GrblConfig,
        make_opener("stage", lambda link, config: GrblStage(link, config.axis, config.is_reversed)),
        lambda around: Simulated(GrblConfig(around.wire.port), SimulatedGrbl(around.wire, around.axis)),
        messages=PAGES["grbl"],
    ),
)
