"""All runs of the safety core: every fault at every step, on the code that moves the real stage."""

import pytest

from softcal.station.interlock import NEXT, Event, Interlock, State
from softcal.station.simulated.explore import Told, broken_property, explore, run_once

RESTS = (State.STOPPED, State.OVER)


def test_every_run_with_any_faults_keeps_the_properties():
    found = explore(broken_property, most_faults=3)
    assert found.broken == ()
    assert found.runs > 1000 and found.states > 12


def test_the_search_would_find_a_stage_that_goes_on_after_a_fault():

    def forbids_lifting(told: Told) -> str:
        is_lifted = told.faulted_at is not None and "up" in told.commands[told.faulted_at :]
        return "lifts after a fault" if is_lifted else ""

    assert explore(forbids_lifting, 1).broken


def test_a_run_without_faults_does_all_of_its_moves():
    told, _ = run_once([])
    assert told.ended is State.OVER
    assert told.commands == ["home", "down", "down", "stop", "down", "up"]


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
    with pytest.raises(ValueError, match="lower while stopping"):
        interlock.take(Event.LOWER)
