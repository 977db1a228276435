"""What may follow what while a stage moves: the states of one run, and nothing else. No device and no clock here.

A run is one deliberate start. It ends in OVER or in STOPPED; neither leads anywhere, so whatever moves next begins with
a start of its own. From STOPPING on only LIFTING is left, and that goes away from the unit.
"""

from collections.abc import Mapping
from enum import StrEnum


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


class Interlock:
    """The state of one run."""

    def __init__(self) -> None:
        self.state = State.STANDING

    def take(self, event: Event) -> None:
        """Go on to the next state.

        Raises:
            ValueError: this may not follow; a defect of softcal, nothing was sent.
        """
        following = NEXT[self.state]
        if event not in following:
            raise ValueError(f"{event} while {self.state}")
        self.state = following[event]
