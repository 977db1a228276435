"""Interfaces of clock, stage, load cell and readout that a run uses, whatever their dialect."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Event
from typing import Protocol, TypeAlias, runtime_checkable

from softcal.core.errors import DeviceError
from softcal.core.messages.reason import Reason


class StageOnHold(DeviceError):
    """The stage is on hold by the button at the machine: no move may begin by itself."""


@dataclass(frozen=True)
class Move:
    """A move to a stage position at constant speed, from rest to rest.

    Args:
        ahead_mm: how far beyond its present position the controller may have commands. That much runs out
            when the host dies. A controller that takes whole moves cannot keep to it.
    """

    to_mm: float
    speed_mm_s: float
    ahead_mm: float = math.inf


@dataclass(frozen=True)
class Sample:
    """One line of a stream.

    Args:
        host_s: when its last byte was read, host clock. Never a time axis: lines arrive late and in bursts.
        device_s: the device's own clock, unwrapped; None where the device has none.
        values: one number per channel, in the unit the reader declares.
    """

    host_s: float
    device_s: float | None
    values: tuple[float, ...]


@dataclass(frozen=True)
class StagePosition:
    """Stage position at the midpoint between status query and answer, by the host clock."""

    host_s: float
    position_mm: float


OnWait: TypeAlias = Callable[[], None]
"""Called every few milliseconds by whatever waits for a device."""


def ignore_wait() -> None:
    """Do nothing while waiting for a device."""


class Clock(Protocol):
    """The host's clock. On a simulated rig waiting is what lets time pass."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary start, never decreasing."""

    def sleep_s(self, seconds: float) -> None: ...

    def wait(self, event: Event, seconds: float) -> None:
        """Wait until an event is set, at most so long; for a thread beside the host's own."""


class Stage(Protocol):
    """Motion hardware with one axis, positive when it compresses, 0 at the homing switch."""

    name: str
    travel_mm: float
    max_speed_mm_s: float
    acceleration_mm_s2: float
    position_mm: float
    """Where the stage was last known to be; exact when it rests after a move."""

    @property
    def is_position_known(self) -> bool:
        """Whether the axis was homed and nothing since can have lost the position."""

    @property
    def is_moving(self) -> bool:
        """Whether the last move that was begun has not yet been confirmed as finished."""

    def home(self, on_wait: OnWait = ignore_wait) -> None:
        """Home the stage and wait for the end; an exception of `on_wait` ends the wait, but not yet the motion.

        Raises:
            DeviceError: the switch is missing or stuck, or something blocks the stage; the position stays unknown.
        """

    def begin(self, move: Move) -> None:
        """Start a move and return at once; `poll` sends the later pieces.

        Raises:
            CommandRefused: not homed, still moving, or beyond travel or speed; nothing was sent.
        """

    def poll(self) -> Sequence[StagePosition]:
        """Read the controller's lines, feed the move in progress, and query the position when due.

        Raises:
            NoReply: the port is gone, or a question was not answered.
            DeviceError: stopped short, stalled, moved by hand, an alarm, a restart: the position may be lost.
        """

    def stop(self) -> None:
        """Stop at once without any queue; the position stays valid if the device allows it.

        Raises:
            StageOnHold: the stage is at rest, on hold by the button at the machine.
            DeviceError: the stage does not answer; the stop was sent.
        """

    def close(self) -> None: ...


@runtime_checkable
class RoughLiftStage(Protocol):
    """A stage that can go away from the unit though a stop cut its motion and lost its position."""

    @property
    def can_lift_roughly(self) -> bool:
        """Whether our own stop alone lost the position, so that the controller's count is nearly right."""

    def lift_roughly(self, distance_mm: float, speed_mm_s: float) -> None:
        """Begin to lift without reaching the switch; `poll` follows. The position stays unknown."""


@runtime_checkable
class SelfStoppingStage(Protocol):
    """A stage that gets moves in pieces, so that it stops by itself after a loss of the host."""

    def runs_on_s(self, speed_mm_s: float) -> float:
        """Return the longest time to rest, in s, after a loss of the host at this speed."""

    def runs_on_mm(self, move: Move) -> float:
        """Return the longest way in mm that this move continues after a loss of the host."""


@runtime_checkable
class SettingsAudit(Protocol):
    """A stage whose settings can be looked at."""

    def unsafe_settings(self) -> Sequence[tuple[str, Reason]]:
        """Return each unsafe setting with its correction."""


class Reader(Protocol):
    """A device that delivers samples by itself or when asked."""

    name: str
    unit: str
    rate_Hz: float

    def start(self) -> None:
        """Throw away what lies in the buffers and begin to count."""

    def poll(self) -> Sequence[Sample]:
        """Return the samples that arrived since the last call, oldest first."""

    def close(self) -> None: ...


class ForceReader(Reader, Protocol):
    """A load cell; its samples hold one value in N, positive when it is compressed."""

    capacity_N: float


class Readout(Reader, Protocol):
    """The electronics of the sensor; its samples hold one value per channel in `unit`."""

    channels: int
    range: tuple[float, float]
    """Lowest and highest value the converter can give; a reading there is saturated."""
