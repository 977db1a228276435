"""What may follow what while a stage moves, and what is watched then: two tables. No device and no clock here.

PHASES says how far a run is: which watches are on, what is known, how late a move may be. NEXT says what the stage may
do. Nothing else switches a watch, and nothing else lets a stage move.

A run is one deliberate start. It ends in OVER or in STOPPED; neither leads anywhere, so whatever moves next begins with
a start of its own. From STOPPING on only LIFTING is left, and that goes away from the unit.
"""

from collections.abc import Collection, Mapping
from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """What the stage of a run is doing."""

    STANDING = "standing"
    HOMING = "homing"
    LOWERING = "lowering"
    """Towards the unit: every watch is on."""
    RAISING = "raising"
    BRAKING = "braking"
    """The touch that was looked for is there; the run goes on once the stage stands."""
    STOPPING = "stopping"
    LIFTING = "lifting"
    """Away from the unit after a stop; nothing else may follow a stop."""
    STOPPED = "stopped"
    OVER = "over"


class Event(StrEnum):
    """What happens to it."""

    HOME = "home"
    LOWER = "lower"
    RAISE = "raise"
    BRAKE = "brake"
    ARRIVED = "arrived"
    FAULT = "fault"
    """A watch, a device, a deadline or a person."""
    LIFT = "lift"
    LEAVE = "leave"
    """It stays where it is, and what stands on the unit is said."""
    END = "end"


NEXT: Mapping[State, Mapping[Event, State]] = {
    State.STANDING: {
        Event.HOME: State.HOMING,
        Event.LOWER: State.LOWERING,
        Event.RAISE: State.RAISING,
        Event.FAULT: State.STOPPING,
        Event.END: State.OVER,
    },
    State.HOMING: {Event.ARRIVED: State.STANDING, Event.FAULT: State.STOPPING},
    State.LOWERING: {Event.ARRIVED: State.STANDING, Event.BRAKE: State.BRAKING, Event.FAULT: State.STOPPING},
    State.RAISING: {Event.ARRIVED: State.STANDING, Event.FAULT: State.STOPPING},
    State.BRAKING: {Event.ARRIVED: State.STANDING, Event.FAULT: State.STOPPING},
    State.STOPPING: {Event.LIFT: State.LIFTING, Event.LEAVE: State.STOPPED},
    State.LIFTING: {Event.ARRIVED: State.STOPPED, Event.LEAVE: State.STOPPED},
    State.STOPPED: {},
    State.OVER: {},
}


class Phase(StrEnum):
    """How far a run is; it never goes back."""

    WAKING = "waking"
    HOMING = "homing"
    LISTENING = "listening"
    """To the unloaded channels, above everything."""
    APPROACHING = "approaching"
    """Through where nothing should be."""
    SEARCHING = "searching"
    FEELING = "feeling"
    """The first, slow press of a unit."""
    PRESSING = "pressing"


class Watch(StrEnum):
    """What can stop a run."""

    RISE = "rise"
    """The force grows while the stage homes."""
    STREAM = "stream"
    """A channel is silent, old, at its rail, or at another rate than declared."""
    FORCE = "force"
    """The force is above its limit, or will be before the stage has braked."""
    DEPTH = "depth"
    JUMP = "jump"
    """The force jumps while the stage stands."""
    FREE = "free"
    """There is a force where nothing should be."""
    FOLLOW = "follow"
    """There is no force where the stage presses."""
    STUCK_CELL = "stuck cell"
    STUCK_OUTPUT = "stuck output"
    """A channel does not change, or no more than its noise, while the stage moves on the unit."""


class Speed(StrEnum):
    """How fast the stage may go down: so that a stop on the stiffest thing holds, noticed by its touch or by the force
    limit; or as fast as a stop holds on what was felt."""

    NONE = "none"
    FREE = "free"
    UNKNOWN = "unknown"
    KNOWN = "known"


class Row(NamedTuple):
    """One phase.

    Args:
        watches: those that are on.
        speed: bound of every move down.
        needs: what must have been found before (attributes of `station.watched.Known`).
        late_s: how much longer than planned a move may take; for homing, how long it may take.
        exits: phases that may follow; a stop may follow any.
    """

    watches: frozenset[Watch]
    speed: Speed
    needs: tuple[str, ...]
    late_s: float
    exits: tuple[Phase, ...]


_ALWAYS = frozenset({Watch.STREAM, Watch.FORCE, Watch.DEPTH, Watch.JUMP})
_ON_UNIT = _ALWAYS | {Watch.FOLLOW, Watch.STUCK_CELL, Watch.STUCK_OUTPUT}

ARRIVAL_S, HOMING_S = 2.0, 90.0
"""A move that takes so much longer than planned has failed; so has a homing that takes so long."""

PHASES: Mapping[Phase, Row] = {
    Phase.WAKING: Row(_ALWAYS, Speed.NONE, (), ARRIVAL_S, (Phase.HOMING, Phase.LISTENING)),
    Phase.HOMING: Row(frozenset({Watch.RISE}), Speed.NONE, (), HOMING_S, (Phase.LISTENING,)),
    Phase.LISTENING: Row(_ALWAYS, Speed.NONE, (), ARRIVAL_S, (Phase.APPROACHING,)),
    Phase.APPROACHING: Row(_ALWAYS | {Watch.FREE}, Speed.FREE, ("free_N",), ARRIVAL_S, (Phase.SEARCHING,)),
    Phase.SEARCHING: Row(_ALWAYS, Speed.FREE, ("zero_N",), ARRIVAL_S, (Phase.FEELING,)),
    Phase.FEELING: Row(_ON_UNIT, Speed.UNKNOWN, ("zero_N", "contact_mm"), ARRIVAL_S, (Phase.PRESSING,)),
    Phase.PRESSING: Row(_ON_UNIT, Speed.KNOWN, ("zero_N", "contact_mm", "felt_mm"), ARRIVAL_S, ()),
}


class Interlock:
    """The state of one run: what its stage does, and how far it is."""

    def __init__(self) -> None:
        self.state, self.phase = State.STANDING, Phase.WAKING

    @property
    def row(self) -> Row:
        """What holds in the present phase."""
        return PHASES[self.phase]

    def enter(self, phase: Phase, known: Collection[str] = ()) -> None:
        """Go on to a later phase.

        Args:
            known: what has been found.

        Raises:
            ValueError: it may not follow, or what it needs is not known; a defect of softcal, nothing was sent.
        """
        missing = set(PHASES[phase].needs) - set(known)
        if phase not in self.row.exits or missing or self.state is not State.STANDING:
            raise ValueError(f"{phase} after {self.phase} while {self.state}, without {sorted(missing)}")
        self.phase = phase

    def take(self, event: Event) -> None:
        """Go on to the next state.

        Raises:
            ValueError: this may not follow; a defect of softcal, nothing was sent.
        """
        following = NEXT[self.state]
        if event not in following:
            raise ValueError(f"{event} while {self.state}")
        self.state = following[event]
