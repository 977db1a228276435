"""What a run needs of a clock, a stage, a load cell and a readout, whatever their dialect."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

from softcal.core.errors import DeviceError
from softcal.core.messages.reason import Reason


class Held(DeviceError):
    """Somebody holds the stage by the button at the machine: nothing may move it by itself."""


@dataclass(frozen=True)
class Move:
    """Go to a stage position at a constant speed, starting and ending at rest.

    Args:
        ahead_mm: how far beyond where the stage is its controller may have been told to go already. That much runs out
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
    """Where the stage was in the middle between status poll and answer, host clock."""

    host_s: float
    position_mm: float


OnWait: TypeAlias = Callable[[], None]
"""Called every few milliseconds by whatever waits for a device."""


def ignore_wait() -> None:
    """Do nothing while a device is waited for."""


class Clock(Protocol):
    """The host's clock. On a simulated rig waiting is what lets time pass."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary start; never goes backward."""

    def sleep_s(self, seconds: float) -> None: ...


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
        """Find the homing switch and wait until it is done; what `on_wait` raises ends the wait, not yet the motion.

        Raises:
            DeviceError: the switch is missing or stuck, or something blocks the stage; the position stays unknown.
        """

    def begin(self, move: Move) -> None:
        """Start a move and return at once; `poll` feeds it.

        Raises:
            CommandRefused: not homed, still moving, or beyond travel or speed; nothing was sent.
        """

    def poll(self) -> Sequence[StagePosition]:
        """Read what the controller said, feed the move in progress, ask for the position when it is time.

        Raises:
            NoReply: the port is gone, or a question was not answered.
            DeviceError: stopped short, stalled, moved by hand, an alarm, a restart: the position may be lost.
        """

    def stop(self) -> None:
        """Stop at once by a path that waits behind nothing; the position stays known where the device allows it.

        Raises:
            Held: it stands, and somebody holds it at the machine.
            DeviceError: it does not answer; it was told to stop all the same.
        """

    def close(self) -> None: ...


@runtime_checkable
class RoughLift(Protocol):
    """A stage that can go away from the unit though a stop cut its motion and lost its position."""

    @property
    def can_lift_roughly(self) -> bool:
        """Whether our own stop alone lost the position, so that its count is nearly right."""

    def lift_roughly(self, distance_mm: float, speed_mm_s: float) -> None:
        """Begin to go away, not into the switch; `poll` follows it. The position stays unknown."""


@runtime_checkable
class RunsOn(Protocol):
    """A stage that is fed in pieces, so that it stops by itself when nothing comes any more."""

    def runs_on_s(self, speed_mm_s: float) -> float:
        """Return after how long it stands, at most, when the host dies at this speed."""

    def runs_on_mm(self, move: Move) -> float:
        """Return how far it still goes, at most, once the host is gone in this move."""


@runtime_checkable
class Advises(Protocol):
    """A stage whose settings can be looked at."""

    def unsafe_settings(self) -> Sequence[tuple[str, Reason]]:
        """Return each setting that takes safety away, and what to do about it."""


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
