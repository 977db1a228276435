"""Values between page, registry and station: orders, their progress, the station's heartbeat."""

import unicodedata
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from softcal.core.messages.reason import Reason, to_line, unpack_reasons


class OrderKind(StrEnum):
    """What a station can be asked to do."""

    SOURCE = "source"
    """Press the source unit with the source profile and record output and reference."""
    UNIT = "unit"
    """Press a target unit with the short profile and record its output."""
    GOLDEN = "golden"
    """Press a golden unit: the check that lets the station run this shift."""
    LOAD = "load"
    """Read the sensor at rest under a known load that a person put on the unit; nothing moves. The
    order's reason names step and load."""
    CHECK = "check"
    """Self-test of the station without a unit."""
    STOP = "stop"
    """Stop the run that is in progress; never waits behind another order."""
    ACKNOWLEDGE = "acknowledge"
    """The reason of a stop was read; the station opens its ports, and the next run homes first."""
    OVERRIDE = "override"
    """An engineer opens the gate for a while; the order's reason goes into the audit trail."""
    FAULT = "fault"
    """Break the simulated station: the order's reason names the fault. A real one refuses."""

    @property
    def presses(self) -> bool:
        """Whether a unit is pressed, so that the order needs its serial."""
        return self in (OrderKind.SOURCE, OrderKind.UNIT, OrderKind.GOLDEN)

    @property
    def is_about_unit(self) -> bool:
        """Whether its end may be the verdict of a unit of the lot."""
        return self in (OrderKind.UNIT, OrderKind.LOAD)

    @property
    def is_run(self) -> bool:
        """Whether it occupies its station; all others are taken at once, even in a run."""
        return self.presses or self in (OrderKind.CHECK, OrderKind.LOAD)


class RunState(StrEnum):
    """The state of one ordered run."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    ERROR = "error"
    CANCELLED = "cancelled"

    @property
    def is_active(self) -> bool:
        return self in ACTIVE


ACTIVE = (RunState.QUEUED, RunState.RUNNING)
"""States of what is not over yet."""


class StationState(StrEnum):
    """What the station is doing, as one word for the screen."""

    STARTING = "starting"
    OFF = "off"
    """The service has ended in good order and given its ports back."""
    CLOSED = "closed"
    """The gate is closed: the reasons say what is missing."""
    READY = "ready"
    RUNNING = "running"
    STOPPED = "stopped"
    """A run was stopped; nothing moves until somebody acknowledges."""


@dataclass(frozen=True)
class Order:
    """One wish of a person or a program to a station.

    Args:
        order_id: unique text, given by whoever asks; the same id twice is one order.
        reason: why, where a reason is needed (an override, a repeat).
    """

    order_id: str
    station: str
    kind: OrderKind
    serial: str = ""
    lot_id: str = ""
    actor: str = ""
    reason: str = ""
    created: datetime | None = None

    def __post_init__(self) -> None:
        if self.kind.presses and not self.serial:
            raise ValueError(f"an order of kind {self.kind} needs the serial of a unit")
        object.__setattr__(self, "serial", unicodedata.normalize("NFC", self.serial))


@dataclass(frozen=True)
class Signal:
    """The newest stretch of the live signal, thinned for a screen.

    Args:
        t_s: (n,) seconds since the run began.
        output: (n,) sensor output in `output_unit`.
        force_N: (n,) force in N; empty where no load cell reads.
    """

    t_s: tuple[float, ...] = ()
    output: tuple[float, ...] = ()
    stage_mm: tuple[float, ...] = ()
    force_N: tuple[float, ...] = ()
    output_unit: str = "V"


@dataclass(frozen=True)
class Progress:
    """How far one order is.

    Args:
        phase: what happens now, in words ("searching for contact").
        code: "" while all is well, else the stable code of the message ("E-NOREPLY").
        message: what is said to the operator: what happened and what to do. A text was kept so.
        recording_sha256: content hash of the stored recording, once there is one.
        verdict: pass, conditional, fail or retest of a judged unit, pass or fail of a golden one.
    """

    order_id: str
    state: RunState
    phase: str = ""
    fraction: float = 0.0
    remaining_s: float = 0.0
    code: str = ""
    message: tuple[Reason, ...] = ()
    recording_sha256: str = ""
    verdict: str = ""
    signal: Signal = field(default_factory=Signal)

    def __post_init__(self) -> None:
        if isinstance(self.message, str):
            object.__setattr__(self, "message", unpack_reasons(self.message))

    @property
    def text(self) -> str:
        return to_line(self.message)


@dataclass(frozen=True)
class Condition:
    """One thing the gate looked at, with the fact and, where it is not good, what to do.

    A sentence in the place of a reason is one that was kept.
    """

    name: Reason
    is_good: bool
    says: Reason

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", Reason.parse(self.name))
        object.__setattr__(self, "says", Reason.parse(self.says))


@dataclass(frozen=True)
class Heartbeat:
    """What a station says of itself every second; older than 3 s means that nobody is there.

    Args:
        reasons: why the gate is closed or the station stopped; empty when it is ready.
        process: host and process id of the owner of the ports.
        is_overridden: whether an engineer keeps the gate open in spite of its reasons.
    """

    station: str
    state: StationState
    at: datetime
    reasons: tuple[Reason, ...] = ()
    process: str = ""
    order_id: str = ""
    gate: tuple[Condition, ...] = ()
    is_overridden: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "reasons", tuple(map(Reason.parse, self.reasons)))
