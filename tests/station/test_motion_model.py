"""All runs of the safety core: every fault at every step, on the code that moves the real stage."""

import pytest

from softcal.core.errors import DeviceError
from softcal.core.words.reason import Reason
from softcal.station import interlock, motion
from softcal.station.interfaces import Move
from softcal.station.interlock import NEXT, Event, Interlock, State
from softcal.station.motion import Motion
from softcal.station.simulated.explore import broken_property, explore, run_once

RESTS = (State.STOPPED, State.OVER)


def test_every_run_with_any_faults_keeps_the_properties():
    found = explore(broken_property, most_faults=3)
    assert found.broken == ()
    assert found.runs > 10_000 and found.states > 15
    assert found.ways == {(state, event) for state, ways in NEXT.items() for event in ways}  # none was left untried


def goes_on(monkeypatch):
    """The run begins again by itself after any fault."""
    supervise = Motion.supervise

    def supervise_twice(motion, action):
        try:
            return supervise(motion, action)
        except DeviceError:
            motion._interlock.state = State.STANDING
            return supervise(motion, action)

    monkeypatch.setattr(Motion, "supervise", supervise_twice)


def waits_for_ever(monkeypatch):
    """A move has no deadline."""
    monkeypatch.setattr(motion, "ARRIVAL_S", float("inf"))


def lifts_what_is_held(monkeypatch):
    """The button at the machine is taken for any other fault."""
    monkeypatch.setattr(motion, "Held", type("NobodyRaisesThis", (Exception,), {}))


def says_lifted_without_lifting(monkeypatch):
    def lift(self):
        for event in (Event.LIFT, Event.ARRIVED):
            self._interlock.take(event)
        return Reason("left.lifted")

    monkeypatch.setattr(Motion, "_lift", lift)


def says_nothing_of_the_load(monkeypatch):
    def left(self, state):
        if self.state in (State.STOPPING, State.LIFTING):
            self._interlock.take(Event.LEAVE)
        return state

    monkeypatch.setattr(Motion, "_left", left)


def lifts_the_wrong_way(monkeypatch):
    def begin_down(self, path):
        self._stage.begin(Move(self._stage.position_mm + 1.0, path.speed_mm_s))

    monkeypatch.setattr(Motion, "_begin_lift", begin_down)


def homes_to_get_away(monkeypatch):
    def home_instead(self):
        self._stage.home()
        return Reason("left.lifted")

    monkeypatch.setattr(Motion, "_lift", home_instead)


def stays_open_after_a_stop(monkeypatch):
    """A run that was stopped is not over: it could go on."""
    open_end = {**NEXT, State.STOPPING: {**NEXT[State.STOPPING], Event.LEAVE: State.STANDING}}
    monkeypatch.setattr(interlock, "NEXT", open_end)


@pytest.mark.parametrize(
    ("mutate", "property_"),
    [
        (goes_on, "moves down after a stop"),
        (waits_for_ever, "a state has no deadline"),
        (lifts_what_is_held, "moves by itself while somebody holds it"),
        (says_lifted_without_lifting, "does not say what stands on the unit"),
        (says_nothing_of_the_load, "does not say what stands on the unit"),
        (lifts_the_wrong_way, "moves down after a stop"),
        (homes_to_get_away, "moves down after a stop"),
        (stays_open_after_a_stop, "a run does not end"),
    ],
)
def test_the_search_finds_a_safety_core_that_is_broken(monkeypatch, mutate, property_):
    mutate(monkeypatch)
    broken = explore(broken_property, 1).broken
    assert any(property_ in run for run in broken), broken[:3]


def test_a_run_without_faults_does_all_of_its_moves():
    told, _ = run_once([])
    assert told.ended is State.OVER
    assert told.commands == ["home", "down", *["down", "stop", "up"] * 2, "down", "up"]


def reached(start: State) -> set[State]:
    seen, waiting = set(), [start]
    while waiting:
        for following in NEXT[waiting.pop()].values():
            if following not in seen:
                seen.add(following)
                waiting.append(following)
    return seen


@pytest.mark.parametrize("state", [State.STOPPING, State.LIFTING, *RESTS])
def test_after_a_stop_nothing_can_lower_the_stage(state):
    assert not reached(state) & {State.LOWERING, State.HOMING, State.RAISING, State.STANDING, State.BRAKING}


@pytest.mark.parametrize("state", [state for state in State if state not in RESTS])
def test_a_fault_in_any_state_ends_the_run(state):
    ways = NEXT[state]
    assert Event.FAULT in ways or set(ways.values()) <= {State.LIFTING, State.STOPPED}
    assert set(RESTS) & reached(state)


def test_what_may_not_follow_is_refused():
    interlock = Interlock()
    interlock.take(Event.FAULT)
    with pytest.raises(ValueError):
        interlock.take(Event.LOWER)
