"""A GRBL 1.1 controller with one axis at the far end of a serial line (gnea/grbl wiki, "Grbl v1.1 Interface")."""

import math
import re
from collections import deque
from collections.abc import Callable
from functools import partial

from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.motion import Axis, QueuedMove
from softcal.station.simulated.wire import Wire
from softcal.station.wire.frames import grbl

PLANNER_BLOCKS = 15
RECEIVE_BYTES = 128
SEEK_MM_S, FEED_MM_S = 25.0, 2.0
"""Homing speeds: $25 and $24 in mm/s."""

SEGMENTS_S = 0.06
"""Motion that is already cut into steps when a feed hold comes: it still runs out (stepper.c, segment buffer)."""

SETTINGS = {10: 1.0, 13: 0.0, 20: 1.0, 21: 1.0, 22: 1.0, 24: 25.0, 25: 500.0, 27: 1.0, 112: 1500.0}
"""A fresh controller (defaults.h, generic) with its limits switched on, the pressing axis."""

_WORD = re.compile(rb"([A-Z])(-?(?:\d+\.?\d*|\.\d+))")
_REAL_TIME_COMMANDS = b"?!~\x18\x84\x85"
_PIECE = re.compile(rb"[?!~\x18\x84\x85\r\n]|[^?!~\x18\x84\x85\r\n]+")


class SimulatedGrbl(FarEnd):
    """A controller whose Z axis presses downward: machine Z runs from 0 at the homing switch to −travel.

    Faults are switches: `switch` ("good", "missing", "stuck"), `delay_reply_s`, `hit_limit()`, `dip_power()`,
    `open_door()`, `press_emergency_stop()`, `press_hold()`, and everything the wire can do.

    Args:
        axis: the drive; its position counts downward from the switch, mm.
    """

    def __init__(self, wire: Wire, axis: Axis, travel_mm: float = 40.0) -> None:
        super().__init__(wire, axis=axis)
        self.travel_mm = travel_mm
        self.settings = SETTINGS | {122: axis.acceleration_mm_s2, 132: travel_mm}
        self.switch = "good"
        self.delay_reply_s = 0.0
        self.is_locked_until_reset = False
        self.state = "Alarm"
        self.stop_received_s: float | None = None
        self.was_moving_at_stop = False  # noqa: V101
        self.assume_zero()
        self._now_s = 0.0
        self._lines: deque[bytes] = deque()
        self._waiting: Callable[[], bool] | None = None
        self._dwell_until_s = self._holds_at_s = math.inf
        self._is_hold_pressed = False
        self._is_relative = False
        self._feed_mm_s = 0.0
        self._greet()

    def assume_zero(self) -> None:
        """Set the present position as Z = 0, as a controller does after power-up."""
        self._offset_mm = -self.axis.position_mm

    def receive(self, now_s: float) -> None:
        self._now_s = now_s
        super().receive(now_s)

    def take(self, content: bytes, now_s: float) -> None:
        """Receive real-time bytes at once, and lines into the buffer."""
        for piece in _PIECE.findall(content):
            if piece == grbl.STATUS and self.state != "Home":
                self._report()
            elif piece == grbl.HOLD:
                if self.stop_received_s is None:
                    self.stop_received_s, self.was_moving_at_stop = self._now_s, self.axis.is_moving  # noqa: V101
                self._hold()
            elif piece == grbl.RESUME and self.state in ("Hold", "Door") and not self._is_hold_pressed:
                self._holds_at_s = math.inf
                self.axis.resume()
                self.state = "Run" if self.axis.is_moving else "Idle"
            elif piece == grbl.RESET:
                self._reset()
            elif piece == grbl.DOOR:
                self.open_door()
            elif piece in b"\r\n":
                self._lines.append(self._received)
                self._received = b""
            elif piece not in _REAL_TIME_COMMANDS:
                used = sum(map(len, (*self._lines, self._received)))
                self._received += piece[: max(0, RECEIVE_BYTES - 1 - used)]
        self._work()

    def next_event_s(self) -> float:
        # A pause does not end while the stage is held: its end would be an event of the past for ever.
        pause_s = math.inf if self.state == "Hold" or self.axis.is_on_hold else self._dwell_until_s
        return min(self.axis.ends_s, self.wire.next_arrival_s, pause_s, self._holds_at_s)

    def advance(self, now_s: float) -> None:
        self._now_s = now_s
        self.axis.advance(now_s)
        if now_s >= self._holds_at_s:
            self._holds_at_s = math.inf
            self.axis.hold()
        if self.state == "Run" and not self.axis.is_moving:
            self.state = "Idle"
        self._work()
        self.wire.deliver(now_s)

    def hit_limit(self) -> None:
        self.axis.flush()
        self._lines.clear()
        self._waiting = None
        self._alarm(1)
        self._send_line("[MSG:Reset to continue]")
        self.is_locked_until_reset = True

    def dip_power(self) -> None:
        """Interrupt the supply for a moment: the controller restarts without a valid position."""
        self.axis.flush()
        self._start_again()
        self.assume_zero()
        self.state = "Alarm"
        self._greet()

    def press_emergency_stop(self) -> None:
        """The reset input is pulled: motion is cut, the position is lost."""
        self._reset()

    def open_door(self) -> None:
        """The safety door opens: the controller brakes and waits."""
        self.axis.hold()
        self.state = "Door"

    def press_hold(self) -> None:
        """Press and keep the hold button at the machine."""
        self._is_hold_pressed = True
        self._hold()

    def _hold(self) -> None:
        if self.state in ("Run", "Idle"):
            self._holds_at_s = self._now_s + (SEGMENTS_S if self.axis.is_moving else 0.0)
            self.state = "Hold"

    def _greet(self) -> None:
        self._send_line("")
        self._send_line("Grbl 1.1h ['$' for help]")
        if self.state == "Alarm":
            self._send_line("[MSG:'$H'|'$X' to unlock]")

    def _reset(self) -> None:
        was_moving = self.axis.is_moving or self.state == "Home"
        was_locked = self.state == "Alarm"
        self.axis.flush()
        self._start_again()
        self.state = "Alarm" if was_moving or was_locked else "Idle"
        if was_moving:
            self._offset_mm += 0.4  # steps are lost when the motors are cut in motion
            self._send_line("ALARM:3")
        self._greet()

    def _start_again(self) -> None:
        self._lines.clear()
        self._received = b""
        self._waiting = None
        self._dwell_until_s = self._holds_at_s = math.inf
        self.is_locked_until_reset = False
        self._is_relative = False

    def _report(self) -> None:
        state = self.state
        if state == "Hold":
            state = "Hold:1" if self.axis.is_moving else "Hold:0"
        elif state == "Door":
            state = "Door:3" if self.axis.is_moving else "Door:1"
        speed = abs(self.axis.velocity_mm_s) * 60
        free = PLANNER_BLOCKS - len(self.axis.queue)
        letters = ("Z" if self.switch == "stuck" else "") + ("H" if self._is_hold_pressed else "")
        pins = f"|Pn:{letters}" if letters else ""
        machine_mm = -(self.reported_mm + self._offset_mm)
        self._send_line(f"<{state}|MPos:0.000,0.000,{machine_mm:.3f}|Bf:{free},128|FS:{speed:.0f},0{pins}>")

    def _send_line(self, text: str) -> None:
        self.wire.send(text.encode() + b"\r\n", self._now_s + self.delay_reply_s)

    def _alarm(self, code: int) -> None:
        self.state = "Alarm"
        self._send_line(f"ALARM:{code}")

    def _work(self) -> None:
        while True:
            if self._waiting is not None:
                if not self._waiting():
                    return
                self._waiting = None
            if not self._lines:
                return
            line = self._lines.popleft().upper().replace(b" ", b"")
            reply = self._dollar(line) if line.startswith(b"$") else self._code(line)
            if reply:
                self._send_line(reply)

    def _dollar(self, line: bytes) -> str:
        if line == b"$$":
            for number, value in sorted(self.settings.items()):
                self._send_line(f"${number}={value:g}" if value == int(value) else f"${number}={value:.3f}")
            return "ok"
        if line == b"$X":
            if self.is_locked_until_reset:
                return ""
            self.state = "Idle" if self.state == "Alarm" else self.state
            return "ok"
        if line == b"$H":
            if self.state not in ("Idle", "Alarm"):
                return "error:8"
            if not self.settings[22]:
                return "error:5"
            if self.is_locked_until_reset:
                return ""
            self.state = "Home"
            self.axis.flush()
            pull_off_mm, is_missing = self.settings[27], self.switch == "missing"
            seek_mm = self.axis.position_mm - 1.5 * self.travel_mm if is_missing else 0.0
            seek, slow = ((seek_mm, SEEK_MM_S), (pull_off_mm, SEEK_MM_S)), ((0.0, FEED_MM_S), (pull_off_mm, FEED_MM_S))
            for target_mm, speed_mm_s in seek[:1] if is_missing else (*seek, *slow):
                self.axis.add(QueuedMove(target_mm, speed_mm_s))
            self._waiting = self._is_homed
            return ""
        if line == b"$I":
            self._send_line("[VER:1.1h.20190825:]")
            self._send_line("[OPT:V,15,128]")
            return "ok"
        setting = re.fullmatch(rb"\$(\d+)=(-?[\d.]+)", line)
        if not setting or int(setting[1]) not in self.settings:
            return "error:3"
        self.settings[int(setting[1])] = float(setting[2])
        self.axis.acceleration_mm_s2 = self.settings[122]
        return "ok"

    def _is_homed(self) -> bool:
        if self.switch == "stuck" and self.axis.queue and self.axis.queue[0].target_mm > 0:
            self.axis.flush()
            self._alarm(8)
            return True
        if self.axis.is_moving:
            return False
        if self.switch == "missing":
            self._alarm(9)
            return True
        self._offset_mm = 0.0
        self.state = "Idle"
        self._send_line("ok")
        return True

    def _code(self, line: bytes) -> str:
        if not line:
            return "ok"
        if self.state == "Alarm" or self.is_locked_until_reset:
            return "error:9"
        fields = _WORD.findall(line)
        codes = {float(value) for letter, value in fields if letter == b"G"}
        values = {letter: float(value) for letter, value in fields if letter != b"G"}
        if b"".join(letter + value for letter, value in fields) != line or not codes <= {0, 1, 4, 21, 53, 90, 91}:
            return "error:20"
        if 4 in codes:
            self._waiting = partial(self._has_paused, values.get(b"P", 0.0))
            return ""
        self._is_relative = (self._is_relative or 91 in codes) and 90 not in codes
        self._feed_mm_s = values.get(b"F", self._feed_mm_s * 60) / 60
        if b"Z" not in values:
            return "ok"
        return self._move(values[b"Z"], is_rapid=0 in codes)

    def _move(self, z_mm: float, is_rapid: bool) -> str:
        if not is_rapid and not self._feed_mm_s:
            return "error:22"
        start_mm = self.axis.queue[-1].target_mm if self.axis.queue else self.axis.position_mm
        target_mm = start_mm - z_mm if self._is_relative else -z_mm - self._offset_mm
        if self.settings[20] and not -1e-9 <= target_mm + self._offset_mm <= self.travel_mm:
            self.axis.flush()
            self._alarm(2)
            return ""
        fastest = self.settings[112] / 60
        block = QueuedMove(target_mm, fastest if is_rapid else min(self._feed_mm_s, fastest))

        def queue_block() -> bool:
            if len(self.axis.queue) >= PLANNER_BLOCKS or self.axis.is_on_hold or self.state == "Hold":
                return False
            self.axis.add(block)
            self.state = "Run" if self.axis.is_moving else self.state
            self._send_line("ok")
            return True

        self._waiting = queue_block
        return ""

    def _has_paused(self, seconds: float) -> bool:
        if self.axis.is_moving or self.axis.is_on_hold or self.state == "Hold":
            return False
        if self._dwell_until_s == math.inf:
            self._dwell_until_s = self._now_s + seconds
        if self._now_s < self._dwell_until_s:
            return False
        self._dwell_until_s = math.inf
        self._send_line("ok")
        return True
