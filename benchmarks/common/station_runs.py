"""Every way a run can go, tried on the real `station.motion.motion.Motion`: all faults at all steps.

A made-up stage asks at each step what happens next; the run is repeated until every answer was given at every step,
with up to MOST_FAULTS answers in one run that are not "all is well". What the stage was told is judged against the
properties of docs/hazards.md.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from threading import Event
from types import SimpleNamespace
from typing import Any

from common.fault_trial import is_true

from softcal.core.errors import BadReply, CommandRefused, DeviceError, NoReply, SafetyStop
from softcal.core.messages.reason import Reason, plain
from softcal.station.devices.config import FixtureConfig, ForceConfig, SafetyConfig
from softcal.station.interfaces import Move, OnWait, Sample, StageOnHold, StagePosition
from softcal.station.motion.interlock import TABLE, AllowedMotion, StageMonitor, State
from softcal.station.motion.motion import Cancelled, Motion

MAX_FAULTS = 3
LONGEST_S = 120.0
"""No run of the program below may take longer, whatever happens."""

SECOND_APPROACH_WAY_MM, APPROACH_MM, POLLS, STEP_S = 5.0, 4.0, 3, 0.05

CREEP_MM = 1e-6
"""A stage that never arrives creeps on at every look: one that stands still is seen by that alone."""

PROBED = frozenset(name for row in TABLE.values() for name in row.needs)


class Choices:
    """The answers of one run: those that are given, then "all is well"."""

    def __init__(self, choices_given: Sequence[int]) -> None:
        self._choices, self.made = list(choices_given), list[tuple[int, int]]()

    def pick(self, count: int) -> int:
        """Return which of `count` answers is given here; 0 is "all is well"."""
        k = len(self.made)
        answer = self._choices[k] if k < len(self._choices) else 0
        self.made.append((answer, count))
        return answer


@dataclass
class RunOutcome:
    """What a stage was told in one run, and what was seen on the way.

    Args:
        commands: "down", "up", "home", "stop", in order.
        faulted_at: how many commands there had been when the first fault came; None without one.
        held_at: the same for the hold button.
        states: (state of the run, is moving, position known, held) that were met.
        ways: (state of the run, the one that followed).
        left: what was said of the stage after a fault.
        is_true: whether that is so.
    """

    commands: list[str] = field(default_factory=list)
    faulted_at: int | None = None
    held_at: int | None = None
    states: set[tuple[State, bool, bool, bool]] = field(default_factory=set)
    ways: set[tuple[State, State]] = field(default_factory=set)
    left: Reason | None = None
    is_true: bool = True
    seconds: float = 0.0
    message: str = ""
    ended: State = State.WAKING


class ModelStage:
    """A stage whose every step may go wrong."""

    name, travel_mm, max_speed_mm_s, acceleration_mm_s2 = "stage", 40.0, 25.0, 200.0

    def __init__(self, choices: Choices, outcome: RunOutcome) -> None:
        self._choices, self._outcome = choices, outcome
        self.position_mm = self._target_mm = APPROACH_MM
        self.is_position_known = self.is_moving = self.can_lift_roughly = False
        self._polls, self._is_blocked = 0, False
        self._stalled_at_mm: float | None = None
        """Where the carriage stays, once its motor has no supply: the controller counts on."""
        self._slipped_mm = 0.0
        self.look: Callable[[], None] = lambda: None

    @property
    def carriage_mm(self) -> float:
        """Where the carriage is, whatever the controller counts."""
        return self.position_mm + self._slipped_mm if self._stalled_at_mm is None else self._stalled_at_mm

    def home(self, on_wait: OnWait = lambda: None) -> None:
        """Home, or fail."""
        self._outcome.commands.append("home")
        self.is_moving = True
        on_wait()
        if self._choices.pick(2):
            self._fault(DeviceError("stage: homing failed"))
        self.is_moving, self.is_position_known, self.position_mm = False, True, 1.0

    def begin(self, move: Move) -> None:
        """Begin, refuse, or begin and never arrive."""
        self._outcome.commands.append("down" if move.to_mm > self.position_mm else "up")
        answer = self._choices.pick(3)
        if answer == 1:
            self._fault(CommandRefused("stage: refused"))
        self._target_mm, self.is_moving, self._polls, self._is_blocked = move.to_mm, True, 0, answer == 2

    def lift_roughly(self, distance_mm: float, speed_mm_s: float) -> None:
        """Go up without a known position."""
        self.begin(Move(self.position_mm - distance_mm, speed_mm_s))

    def poll(self) -> list[StagePosition]:
        """Go on, or fail."""
        self._polls += 1
        self.look()
        if self.is_moving and self._polls <= POLLS:
            self._step()
        if self._is_blocked and self.is_moving:
            self.position_mm += CREEP_MM
        return [StagePosition(0.0, self.position_mm)]

    def stop(self) -> None:
        """Stand, or lose the position, or be held, or say nothing."""
        if self._is_blocked and self._polls > 2 * POLLS:
            self._mark()  # Stopped because it was late.
        self._outcome.commands.append("stop")
        self.look()
        answer = self._choices.pick(5)
        if self.is_moving:
            self.position_mm = (self.position_mm + self._target_mm) / 2
        self.is_moving, self.can_lift_roughly = False, answer == 1
        if answer:
            self.is_position_known = False
        if answer == 3:
            self.is_position_known = True
            self._hold()
        if answer == 4:
            self._fault(NoReply("stage: no answer"))

    def _step(self) -> None:
        answer = self._choices.pick(8)
        if answer == 1:
            self._fault(NoReply("stage: no status"))
        if answer == 2:
            self.is_position_known = False
            self._fault(DeviceError("stage: ALARM"))
        if answer == 3:
            self.is_moving = False
            self._hold()
        if answer == 4:
            self._fault(BadReply("stage: noise"))
        if answer == 5:
            self._stalled_at_mm = self.carriage_mm
        if answer == 6:  # The motor loses steps: the carriage does not come as far as it is counted.
            self._slipped_mm += (self.position_mm - self._target_mm) / POLLS
        if answer == 7:
            self._mark()
            raise KeyboardInterrupt
        if self._polls >= POLLS and not self._is_blocked:
            self.position_mm, self.is_moving = self._target_mm, False

    def _hold(self) -> None:
        if self._outcome.held_at is None:
            self._outcome.held_at = len(self._outcome.commands)
        self._fault(StageOnHold("stage: held by the button"))

    def _fault(self, error: DeviceError) -> None:
        self._mark()
        raise error

    def _mark(self) -> None:
        if self._outcome.faulted_at is None:
            self._outcome.faulted_at = len(self._outcome.commands)


class ModelCell:
    """A load cell: it shows the force of the carriage, wherever the controller says it is; or is silent, or hangs."""

    def __init__(self, stage: ModelStage, choices: Choices, clock: "_Clock") -> None:
        self._stage, self._choices, self._clock = stage, choices, clock
        self._state: int | None = None
        self._hangs_at_N = 0.0

    @property
    def force_N(self) -> float:
        """The force on the unit, 1 N/mm."""
        return max(0.0, self._stage.carriage_mm - SECOND_APPROACH_WAY_MM)

    @property
    def shown_N(self) -> float:
        """What the cell shows of it."""
        return self._hangs_at_N if self._state == 2 else self.force_N

    def poll(self) -> list[Sample]:
        """Return one reading, or fail."""
        if self._state is None:
            self._state, self._hangs_at_N = self._choices.pick(3), self.force_N
        if self._state == 1:
            raise NoReply(plain("load cell: silent"))
        return [Sample(self._clock.now_s(), None, (self.shown_N,))]


class ModelReadout:
    """A sensor: it shows how deep the carriage presses the unit, 1 V/mm."""

    def __init__(self, stage: ModelStage, clock: "_Clock") -> None:
        self._stage, self._clock = stage, clock

    def poll(self) -> list[Sample]:
        """Return one reading."""
        return [Sample(self._clock.now_s(), None, (max(0.0, self._stage.carriage_mm - SECOND_APPROACH_WAY_MM),))]


class _Endless(BaseException):
    """A run that would go on for ever."""


class _Clock:
    def __init__(self) -> None:
        self.t_s = 0.0

    def now_s(self) -> float:
        return self.t_s

    def sleep_s(self, seconds: float) -> None:
        self.t_s += max(seconds, STEP_S)
        if self.t_s > LONGEST_S:
            raise _Endless

    def wait(self, event: Event, seconds: float) -> None:
        self.sleep_s(seconds)


class _RecordedMotion(Motion):
    """Keeps which way it went from which state."""

    def __init__(self, bench: Any, tick: Callable[[], None], outcome: "RunOutcome") -> None:
        super().__init__(bench, tick)
        self._outcome = outcome

    def enter(self, state: State, known_states: Collection[str] = ()) -> None:
        before = self.state
        super().enter(state, known_states)
        self._outcome.ways.add((before, state))


def run_once(choices_given: Sequence[int]) -> tuple[RunOutcome, list[tuple[int, int]]]:
    """Run the program once with these answers; return what was told, and the answers with their alternatives."""
    choices, outcome, clock = Choices(choices_given), RunOutcome(), _Clock()
    stage = ModelStage(choices, outcome)
    force, fixture = ForceConfig("", latency_s=0.0), FixtureConfig(approach_mm=APPROACH_MM)
    config = SimpleNamespace(safety=SafetyConfig(), fixture=fixture, force=force)
    cell = ModelCell(stage, choices, clock)
    readout = ModelReadout(stage, clock)
    bench: Any = SimpleNamespace(config=config, clock=clock, stage=stage, readout=readout, force=cell)
    looks = 0

    def tick() -> None:
        nonlocal looks
        clock.sleep_s(0.02)
        stage.poll()
        looks += 1
        if looks % POLLS == 1 and looks < 16 * POLLS:
            _choose_monitor(choices.pick(5), stage, motion.row.monitors)

    motion = _RecordedMotion(bench, tick, outcome)
    motion.zero_N = motion.free_output = 0.0

    def look() -> None:
        outcome.states.add((motion.state, stage.is_moving, stage.is_position_known, outcome.held_at is not None))

    stage.look = look
    try:
        motion.supervise(lambda: _program(motion, stage, choices))
    except DeviceError as error:
        outcome.message, lift_state = str(error), error.reason.values.get("state")
        if isinstance(lift_state, Reason):
            outcome.left, outcome.is_true = (
                lift_state,
                is_true(lift_state, (cell.force_N, cell.shown_N), stage.position_mm),
            )
    except _Endless:
        pass  # Its time tells.
    look()
    outcome.ended, outcome.seconds = motion.state, clock.t_s
    return outcome, choices.made


def _choose_monitor(answer: int, stage: ModelStage, on: frozenset[StageMonitor]) -> None:
    """A person, or something that a watch sees, where the table has it on."""
    interrupts: tuple[tuple[bool, BaseException], ...] = (
        (True, Cancelled("stopped by a person")),
        (True, KeyboardInterrupt()),
        (StageMonitor.FORCE in on, SafetyStop("force")),
        (StageMonitor.STREAM in on, BadReply("load cell: noise")),
    )
    if answer and interrupts[answer - 1][0]:
        stage._mark()
        raise interrupts[answer - 1][1]


def _program(motion: Motion, stage: ModelStage, choices: Choices) -> None:
    """Go through the table: in each state everything that may move moves, then one of its exits is taken."""
    while True:
        row = motion.row
        motion.wait(POLLS * STEP_S)
        if row.moves.are_down:
            motion.go(8.0, 1.0, lambda: stage.is_moving and stage._polls >= POLLS - 1)
            motion.go(APPROACH_MM if motion.state is not State.PROBING else 9.0, 5.0)
        elif row.moves is AllowedMotion.UP:
            motion.go(APPROACH_MM, 5.0)
        exits = [state for state in row.exits if state is not State.STOPPING]
        following = exits[choices.pick(len(exits))]
        if following is State.OVER:
            return
        if following is State.HOMING:
            motion.home(lambda: None)
            following = State.LISTENING
            if choices.pick(2):
                return
        stage.is_position_known = True
        motion.enter(following, PROBED)


@dataclass(frozen=True)
class Explored:
    """What the search went through, and the runs that break a property (none should)."""

    runs: int
    states: int
    ways: frozenset[tuple[State, State]]
    broken: tuple[str, ...]


def explore(
    find_broken: Callable[[RunOutcome], str], max_faults: int = MAX_FAULTS, stops_early: bool = False
) -> Explored:
    """Try every run.

    Args:
        judge: the property a run breaks, "" for none.
        most_faults: answers other than "all is well" in one run.
        stops_early: at the first run that breaks a property.
    """
    waiting: list[list[int]] = [[]]
    runs, broken = 0, list[str]()
    states: set[tuple[State, bool, bool, bool]] = set()
    ways: set[tuple[State, State]] = set()
    while waiting and not (broken and stops_early):
        choices_given = waiting.pop()
        outcome, choices_made = run_once(choices_given)
        runs, states, ways = runs + 1, states | outcome.states, ways | outcome.ways
        if wrong := find_broken(outcome):
            broken.append(f"{choices_given}: {wrong}: {outcome.commands}, {outcome.message}")
        if sum(answer > 0 for answer in choices_given) < max_faults:
            for k in range(len(choices_given), len(choices_made)):
                before = [answer for answer, _ in choices_made[:k]]
                waiting += [[*before, answer] for answer in range(1, choices_made[k][1])]
    return Explored(runs, len(states), frozenset(ways), tuple(broken))


def broken_property(outcome: RunOutcome) -> str:
    """Return which property of docs/hazards.md a run breaks, "" for none."""
    after = [] if outcome.faulted_at is None else outcome.commands[outcome.faulted_at :]
    if any(command in ("down", "home") for command in after):
        return "moves down after a stop without a fresh start"
    if outcome.seconds > LONGEST_S:
        return "a state has no deadline"
    if outcome.ended not in (State.STOPPED, State.OVER):
        return "a run does not end"
    if outcome.held_at is not None and "up" in outcome.commands[outcome.held_at :]:
        return "moves by itself while somebody holds it"
    if outcome.faulted_at is not None and outcome.left is None:
        return "does not say what stands on the unit"
    if not outcome.is_true:
        return "says of the stage what is not so"
    return ""
