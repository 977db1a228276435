"""GRBL 1.1 and grblHAL: bytes to values and back (gnea/grbl wiki, "Grbl v1.1 Interface"). No I/O here."""

import re
from dataclasses import dataclass
from typing import TypeAlias

from softcal.core.errors import BadReply
from softcal.core.messages.reason import Reason, reason

STATUS, HOLD, RESUME, RESET, DOOR = b"?", b"!", b"~", b"\x18", b"\x84"
"""Real-time bytes: picked out of the stream at once, never queued, no line end."""

LINE_LENGTH = 127
"""Usable bytes of the receive buffer."""

ERRORS = {code: Reason(f"grbl.error.{code}") for code in (1, 2, 3, 5, 7, 8, 9, 10, 15, 20, 22)}
ALARMS = {code: Reason(f"grbl.alarm.{code}") for code in range(1, 10)}
MANUAL = Reason("grbl.manual")


@dataclass(frozen=True)
class Ok:
    """The line before was taken."""


@dataclass(frozen=True)
class GrblRefusal:
    """The line before was not taken."""

    code: int

    @property
    def reason(self) -> Reason:
        return reason("grbl.error", code=self.code, why=ERRORS.get(self.code, MANUAL))


@dataclass(frozen=True)
class Alarm:
    """Motion was stopped by the controller; what came before may be lost."""

    code: int

    @property
    def loses_position(self) -> bool:
        """Whether steps may have been lost."""
        return self.code not in (2, 4, 5)

    @property
    def reason(self) -> Reason:
        return reason("grbl.alarmed", code=self.code, why=ALARMS.get(self.code, MANUAL))


@dataclass(frozen=True)
class GrblStatus:
    """One status report.

    Args:
        state: Idle, Run, Hold, Jog, Alarm, Door, Check, Home or Sleep.
        substate: the number after the colon (Hold:0 complete, Hold:1 still stopping), else 0.
        machine_mm: axis positions in machine coordinates, where the report has them.
        offset_mm: work offset, sent now and then: machine = work + offset.
        pins: letters of the inputs that are active (X Y Z limits, P probe, D door, R reset, H hold, S start).
    """

    state: str
    substate: int = 0
    machine_mm: tuple[float, ...] | None = None
    work_mm: tuple[float, ...] | None = None
    offset_mm: tuple[float, ...] | None = None
    pins: str = ""


@dataclass(frozen=True)
class Greeting:
    """Greeting of a controller after a reset; in a run it means that the queue is lost."""

    text: str


@dataclass(frozen=True)
class Setting:
    """One line of the settings dump."""

    number: int
    value: float


@dataclass(frozen=True)
class GrblNote:
    """A message that asks for nothing."""

    text: str


Reply: TypeAlias = Ok | GrblRefusal | Alarm | GrblStatus | Greeting | Setting | GrblNote

_STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep", "Tool")
_SETTING = re.compile(r"\$(\d+)=(-?[\d.]+)")
_GREETING = re.compile(r"grbl(hal)? \d", re.IGNORECASE)


def parse(line: bytes) -> Reply:
    """Return the meaning of a line without its end; raise `BadReply` for noise, or no line of GRBL."""
    try:
        text = line.decode("ascii")
        if text == "ok":
            return Ok()
        if text.startswith("error:"):
            return GrblRefusal(int(text[6:]))
        if text.startswith("ALARM:"):
            return Alarm(int(text[6:]))
        if text.startswith("<") and text.endswith(">"):
            head, *fields = text[1:-1].split("|")
            state, _, substate = head.partition(":")
            if state not in _STATES:
                raise ValueError(text)
            fields_by_name = dict(field.split(":", 1) for field in fields if ":" in field)
            machine_mm, work_mm, offset_mm = (
                tuple(map(float, fields_by_name[name].split(","))) if name in fields_by_name else None
                for name in ("MPos", "WPos", "WCO")
            )
            return GrblStatus(state, int(substate or 0), machine_mm, work_mm, offset_mm, fields_by_name.get("Pn", ""))
        if _GREETING.match(text):
            return Greeting(text)
        if setting := _SETTING.match(text):
            return Setting(int(setting[1]), float(setting[2]))
        if text == "" or text.startswith(("[", ">", "$N")):
            return GrblNote(text)
        raise ValueError(text)
    except ValueError as error:  # Not ASCII, or a number that is none.
        raise BadReply(reason("grbl.noise", line=repr(line[:60]))) from error


def move_line(axis: str, machine_mm: float, speed_mm_s: float, is_relative: bool = False) -> bytes:
    """Return a straight move in machine coordinates, or by so much from where the axis is; feed in mm/min."""
    codes = "G91 G21 G1" if is_relative else "G90 G21 G53 G1"
    return f"{codes} {axis}{machine_mm:.4f} F{speed_mm_s * 60:.3f}\n".encode()


SYNCHRONISE = b"G4 P0.01\n"
"""Answered with ok only when everything queued before it has been done: the one proof that a move is finished."""

HOME, SETTINGS, UNLOCK = b"$H\n", b"$$\n", b"$X\n"
