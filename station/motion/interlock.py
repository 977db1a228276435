"""State table of a run: transitions, permitted moves and active monitors. No device and no clock.

Nothing else switches a watch, and nothing else lets a stage move. A run is one deliberate start. It ends in OVER or in
STOPPED; neither leads anywhere, so whatever moves next begins with a start of its own. From STOPPING on only LIFTING is
left, and that goes away from the unit.
"""

from collections.abc import Collection, Mapping
from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """State of a run; states only advance."""

    WAKING = "waking"
    HOMING = "homing"
    LISTENING = "listening"
    """To the unloaded channels, above everything."""
    APPROACHING = "approaching"
    """Through where nothing should be."""
    SEARCHING = "searching"
    PROBING = "feeling"
    """The first, slow press of a unit, down."""
    RELEASING = "releasing"
    """Up again from it; then it is known how late the load cell is."""
    PRESSING = "pressing"
    STOPPING = "stopping"
    LIFTING = "lifting"
    """Away from the unit after a stop; nothing else may follow a stop."""
    STOPPED = "stopped"
    OVER = "over"


class StageMonitor(StrEnum):
    """Safety monitors that can stop a run."""

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
    """A channel changes by no more than its noise while the stage moves on the unit."""


class AllowedMotion(StrEnum):
    """Permitted moves of the stage: none, homing, up; or down as well, at a speed that a stop can hold.

    That is a stop on the stiffest thing, noticed by its touch (FREE) or by the force limit (UNKNOWN), or a stop on what
    was felt (PROBED).
    """

    NONE = "none"
    HOME = "home"
    UP = "up"
    FREE = "free"
    UNKNOWN = "unknown"
    PROBED = "known"

    @property
    def are_down(self) -> bool:
        """Whether the stage may go towards the unit."""
        return self in (AllowedMotion.FREE, AllowedMotion.UNKNOWN, AllowedMotion.PROBED)


class StateRow(NamedTuple):
    """One row of the state table.

    Args:
        needs: what must have been found before (attributes of `station.motion.watched.RunEstimates`).
        late_s: how much longer than planned a move may take; for homing, how long it may take.
    """

    moves: AllowedMotion
    monitors: frozenset[StageMonitor]
    needs: tuple[str, ...]
    late_s: float
    exits: tuple[State, ...]


ARRIVAL_S, HOMING_S = 2.0, 90.0
"""A move that takes so much longer than planned has failed; so has a homing that takes so long."""

_S, _M = State, AllowedMotion
_NONE: frozenset[StageMonitor] = frozenset()
_ALWAYS = frozenset({StageMonitor.STREAM, StageMonitor.FORCE, StageMonitor.DEPTH, StageMonitor.JUMP})
_ON_UNIT = _ALWAYS | {StageMonitor.FOLLOW, StageMonitor.STUCK_CELL, StageMonitor.STUCK_OUTPUT}
_END = (_S.STOPPING, _S.OVER)
_PROBED = ("zero_N", "contact_mm", "probed_mm", "safe_mm_s")

TABLE: Mapping[State, StateRow] = {
    _S.WAKING: StateRow(_M.NONE, _ALWAYS, (), 0.0, (_S.HOMING, _S.LISTENING, *_END)),
    _S.HOMING: StateRow(_M.HOME, frozenset({StageMonitor.RISE}), (), HOMING_S, (_S.LISTENING, *_END)),
    _S.LISTENING: StateRow(_M.NONE, _ALWAYS, (), 0.0, (_S.APPROACHING, *_END)),
    _S.APPROACHING: StateRow(_M.FREE, _ALWAYS | {StageMonitor.FREE}, ("free_N",), ARRIVAL_S, (_S.SEARCHING, *_END)),
    _S.SEARCHING: StateRow(_M.FREE, _ALWAYS, ("zero_N",), ARRIVAL_S, (_S.PROBING, *_END)),
    _S.PROBING: StateRow(_M.UNKNOWN, _ON_UNIT, ("zero_N", "contact_mm"), ARRIVAL_S, (_S.RELEASING, *_END)),
    # A cell of which nobody knows yet how late it is seems to hang while the stage turns round.
    _S.RELEASING: StateRow(
        _M.UP, _ON_UNIT - {StageMonitor.STUCK_CELL}, ("contact_mm",), ARRIVAL_S, (_S.PRESSING, *_END)
    ),
    _S.PRESSING: StateRow(_M.PROBED, _ON_UNIT, _PROBED, ARRIVAL_S, _END),
    _S.STOPPING: StateRow(_M.NONE, _NONE, (), 0.0, (_S.LIFTING, _S.STOPPED)),
    _S.LIFTING: StateRow(_M.UP, _NONE, (), ARRIVAL_S, (_S.STOPPED,)),
    _S.STOPPED: StateRow(_M.NONE, _NONE, (), 0.0, ()),
    _S.OVER: StateRow(_M.NONE, _NONE, (), 0.0, ()),
}


class Interlock:
    """The state of one run."""

    def __init__(self) -> None:
        self.state = State.WAKING

    @property
    def row(self) -> StateRow:
        """Return the row of the present state."""
        return TABLE[self.state]

    def enter(self, state: State, available: Collection[str] = ()) -> None:
        """Enter a later state.

        Raises:
            ValueError: forbidden transition, or a missing quantity; a defect of softcal, no command was sent.
        """
        missing = sorted(set(TABLE[state].needs) - set(available))
        if state not in self.row.exits or missing:
            raise ValueError(f"{state} after {self.state}, without {missing}")
        self.state = state

    def check_move(self, is_down: bool) -> None:
        """Raise `ValueError` where the stage may not go down, or up: a defect; nothing was sent."""
        if not (self.row.moves.are_down or (self.row.moves is AllowedMotion.UP and not is_down)):
            raise ValueError(f"a move {'down' if is_down else 'up'} while {self.state}")
