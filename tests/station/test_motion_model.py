"""All runs of the safety core: every fault at every step, on the code that moves the real stage."""

import pytest

from softcal.core.errors import DeviceError
from softcal.core.words.reason import Reason, plain
from softcal.station import interlock, motion
from softcal.station.bench import open_simulated_bench
from softcal.station.interfaces import Move
from softcal.station.interlock import NEXT, PHASES, Event, Interlock, Phase, Speed, State, Watch
from softcal.station.motion import Motion
from softcal.station.safety import FollowWatch, ForceWatch, JumpWatch, StreamWatch, StuckWatch
from softcal.station.simulated.explore import KNOWN, broken_property, explore, run_once
from softcal.station.watched import Known, WatchedBench

RESTS = (State.STOPPED, State.OVER)


@pytest.mark.parametrize(("most_faults", "runs"), [(2, 3_000), pytest.param(3, 40_000, marks=pytest.mark.long)])
def test_every_run_with_any_faults_keeps_the_properties(most_faults, runs):
    found = explore(broken_property, most_faults)
    assert found.broken == ()
    assert found.runs > runs and found.states > 15
    assert found.ways == {(state, event) for state, ways in NEXT.items() for event in ways}  # none was left untried


def goes_on(monkeypatch):
    """The run begins again by itself after any fault."""
    supervise = Motion.supervise

    def supervise_twice(motion, action):
        try:
            return supervise(motion, action)
        except DeviceError:
            motion._interlock.state, motion._interlock.phase = State.STANDING, Phase.WAKING
            return supervise(motion, action)

    monkeypatch.setattr(Motion, "supervise", supervise_twice)


def waits_for_ever(monkeypatch):
    """A move has no deadline."""
    endless = {phase: row._replace(late_s=float("inf")) for phase, row in PHASES.items()}
    monkeypatch.setattr(interlock, "PHASES", endless)


def lifts_what_is_held(monkeypatch):
    """The button at the machine is taken for any other fault."""
    monkeypatch.setattr(motion, "Held", type("NobodyRaisesThis", (Exception,), {}))


def says_lifted_without_lifting(monkeypatch):
    def lift(self, is_cell_sound):
        for event in (Event.LIFT, Event.ARRIVED):
            self._interlock.take(event)
        return Reason("left.lifted")

    monkeypatch.setattr(Motion, "_lift", lift)


def says_nothing_of_the_load(monkeypatch):
    monkeypatch.setattr(motion, "reason", lambda code, **values: plain("stopped"))


def believes_the_count(monkeypatch):
    """The controller says that it went up: that is taken for the truth."""

    def confirmed(self, is_cell_sound):
        self._interlock.take(Event.ARRIVED)
        return Reason("left.lifted")

    monkeypatch.setattr(Motion, "_confirmed", confirmed)


def lifts_the_wrong_way(monkeypatch):
    def begin_down(self, path):
        self._stage.begin(Move(self._stage.position_mm + 1.0, path.speed_mm_s))

    monkeypatch.setattr(Motion, "_begin_lift", begin_down)


def homes_to_get_away(monkeypatch):
    def home_instead(self, is_cell_sound):
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
        (says_lifted_without_lifting, "says of the stage what is not so"),
        (believes_the_count, "says of the stage what is not so"),
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


def ways(phase: Phase) -> list[list[Phase]]:
    """Every way through the phases from here to where none follows."""
    return [[phase, *rest] for following in PHASES[phase].exits for rest in ways(following)] or [[phase]]


def test_no_way_through_the_phases_presses_before_everything_it_needs_was_found():
    every = ways(Phase.WAKING)
    assert {phase for way in every for phase in way} == set(Phase)
    for way in every:
        assert way[-1] is Phase.PRESSING and len(set(way)) == len(way)
        watched = [PHASES[phase].watches for phase in way if PHASES[phase].speed is not Speed.NONE]
        assert all({Watch.FORCE, Watch.DEPTH, Watch.STREAM} <= on for on in watched)
        on_unit = [PHASES[phase] for phase in way if "contact_mm" in PHASES[phase].needs]
        assert all({Watch.FOLLOW, Watch.STUCK_CELL, Watch.STUCK_OUTPUT} <= row.watches for row in on_unit)


@pytest.mark.parametrize("phase", Phase)
def test_a_phase_begins_only_where_the_table_says_and_with_all_it_needs(phase):
    for before in Phase:
        for needed in PHASES[phase].needs:
            run = Interlock()
            run.phase = before
            with pytest.raises(ValueError):
                run.enter(phase, set(KNOWN) - {needed})
        run = Interlock()
        run.phase = before
        if phase in PHASES[before].exits:
            run.enter(phase, KNOWN)
            assert run.phase is phase
        else:
            with pytest.raises(ValueError):
                run.enter(phase, KNOWN)


class Stopped(Exception):
    pass


CHECKS = {
    Watch.STREAM: (StreamWatch, "check_silence"),
    Watch.FORCE: (ForceWatch, "check"),
    Watch.DEPTH: (WatchedBench, "_check_depth"),
    Watch.JUMP: (JumpWatch, "check"),
    Watch.FREE: (WatchedBench, "_check_free"),
    Watch.FOLLOW: (FollowWatch, "check"),
    Watch.STUCK_CELL: (StuckWatch, "check"),
    Watch.STUCK_OUTPUT: (StuckWatch, "check"),
    Watch.RISE: (WatchedBench, "_check_rise"),
}


@pytest.mark.parametrize("watch", Watch)
def test_a_watch_is_on_where_the_table_names_it_and_nowhere_else(watch, monkeypatch):
    """The watch is made to stop whatever it is shown: then a look at the devices stops the run, or it does not."""
    owner, method = CHECKS[watch]
    with open_simulated_bench(seed=1) as (bench, _):
        watched = WatchedBench(bench)
        watched.start()
        watched.home()
        watched.motion.wait(0.1)
        watched.known = Known(0.0, 0.0, 0.5, 1.0, 0.0)
        watched.motion._interlock.phase = Phase.SEARCHING
        watched.expect_contact(0.5)
        mine = watched._stuck.get(watch)

        def stop(self, *shown):
            if mine is None or self is mine:
                raise Stopped

        monkeypatch.setattr(owner, method, stop)
        for phase in Phase:
            watched.motion._interlock.phase = phase
            watched.start()
            assert stops(watched, phase) == (watch in PHASES[phase].watches), phase


def stops(watched: WatchedBench, phase: Phase) -> bool:
    try:
        for _ in range(30):
            if phase is Phase.HOMING:
                watched.bench.clock.sleep_s(0.01)
                watched._look_while_homing()
            else:
                watched.tick()
    except Stopped:
        return True
    return False
