"""Simulated Mark-10 ESM stand with its gauge (ESM303 User's Guide, 6.2)."""

import re

from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.force_gauge import SimulatedMark10
from softcal.station.simulated.motion import Axis, QueuedMove
from softcal.station.simulated.wire import Wire

_COMMAND = re.compile(
    rb"/(?P<gauge>[^\\]*)\\|e(?P<speed>\d{4}\.\d)|g(?P<lower>-?\d{3}\.\d\d)|h(?P<upper>-?\d{3}\.\d\d)|(?P<letter>[^/egh])"
)


class SimulatedEsm(FarEnd):
    """A crosshead that moves down from its upper limit switch, with a gauge.

    Faults are switches: `is_switch_missing`, `press_panel()`, and all the wire can do.

    Args:
        axis: the drive; its position counts downward from the upper limit switch, mm.
    """

    def __init__(self, wire: Wire, axis: Axis, gauge: SimulatedMark10, travel_mm: float = 300.0) -> None:
        super().__init__(wire, axis=axis)
        self._gauge, self._travel_mm = gauge, travel_mm
        self.is_switch_missing = False
        self.mode, self._zero_mm, self._speed_mm_s = "M", axis.position_mm, 1.0
        self.lower_mm, self.upper_mm = 0.0, 0.0
        self._motion = "S"

    def take(self, content: bytes, now_s: float) -> None:
        self._received += content
        while command := _COMMAND.match(self._received):
            self._received = self._received[command.end() :]
            answer = ""
            if command["gauge"] is not None:
                answer = self._gauge.answer(command["gauge"].decode(), now_s)
            elif command["speed"] is not None:
                self._speed_mm_s = float(command["speed"]) / 60.0
            elif command["lower"] is not None:
                self.lower_mm = float(command["lower"])
            elif command["upper"] is not None:
                self.upper_mm = float(command["upper"])
            else:
                answer = self._letter(command["letter"], now_s)
            self.send_line(answer, now_s)

    def advance(self, now_s: float) -> None:
        super().advance(now_s)
        if not self.axis.is_moving:
            self._motion = "S"

    def press_panel(self) -> None:  # noqa: V105
        self.axis.brake()

    def _letter(self, letter: bytes, now_s: float) -> str:
        match letter:
            case b"x":
                return f"{self._zero_mm - self.reported_mm:.2f} mm"
            case b"p":
                upper = "" if self.is_switch_missing else "UL"
                lower = "DL" if self.axis.position_mm >= self._travel_mm - 1e-6 else ""
                return f"{self._motion} {self.mode} {upper if self.axis.position_mm <= 1e-6 else lower}".strip()
            case b"?":
                return self._gauge.answer("?", now_s)
            case b"z":
                self._zero_mm = self.axis.position_mm
            case b"m" | b"l":
                self.mode = letter.decode().upper()
            case b"s":
                self.axis.brake()
            case b"u":
                is_free = self.mode == "M"
                self._go("U", 0.0 if is_free else max(0.0, self._zero_mm - self.upper_mm))
            case b"d":
                is_free = self.mode == "M"
                self._go("D", self._travel_mm if is_free else min(self._travel_mm, self._zero_mm - self.lower_mm))
        return ""

    def _go(self, motion: str, to_mm: float) -> None:
        is_onward = to_mm < self.axis.position_mm if motion == "U" else to_mm > self.axis.position_mm
        if is_onward:
            self.axis.flush()
            self.axis.add(QueuedMove(to_mm, self._speed_mm_s))
            self._motion = motion
