"""All runs of the safety core: every fault at every step, on the code that moves the real stage."""

import pytest
from common.station_runs import PROBED, broken_property, explore, run_once

from softcal.core.errors import DeviceError
from softcal.core.messages.reason import Reason, plain
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.interfaces import Move
from softcal.station.motion import interlock, motion
from softcal.station.motion.interlock import TABLE, AllowedMotion, Interlock, StageMonitor, State
from softcal.station.motion.monitored_bench import MonitoredBench, RunEstimates
from softcal.station.motion.monitors import FollowMonitor, ForceMonitor, JumpMonitor, StreamMonitor, StuckMonitor
from softcal.station.motion.motion import Motion

RESTS = (State.STOPPED, State.OVER)
RUNNING = [state for state, row in TABLE.items() if State.OVER in row.exits]


@pytest.mark.parametrize(("max_faults", "runs"), [(2, 4_000), pytest.param(3, 200_000, marks=pytest.mark.long)])
def test_every_run_with_any_faults_keeps_the_properties(max_faults, runs):
    counterexample = explore(broken_property, max_faults)
    assert counterexample.broken == ()
    assert counterexample.runs > runs and counterexample.states > 15
    assert counterexample.ways == {
        (state, following) for state, row in TABLE.items() for following in row.exits
    }  # none was left untried


def goes_on(monkeypatch):
    """The run begins again by itself after any fault."""
    supervise = Motion.supervise

    def supervise_twice(motion, action):
        try:
            return supervise(motion, action)
        except DeviceError:
            motion.state = State.WAKING
            return supervise(motion, action)

    monkeypatch.setattr(Motion, "supervise", supervise_twice)


def waits_for_ever(monkeypatch):
    """A move has no deadline."""
    endless = {state: row._replace(late_s=float("inf")) for state, row in TABLE.items()}
    monkeypatch.setattr(interlock, "TABLE", endless)


def lifts_on_hold(monkeypatch):
    """The button at the machine is taken for any other fault."""
    monkeypatch.setattr(motion, "StageOnHold", type("NobodyRaisesThis", (Exception,), {}))


def reports_lift_without_lifting(monkeypatch):
    def lift(self):
        self.enter(State.LIFTING)
        self.enter(State.STOPPED)
        return Reason("left.lifted")

    monkeypatch.setattr(Motion, "_lift", lift)


def omits_load_from_reason(monkeypatch):
    monkeypatch.setattr(motion, "reason", lambda code, **values: plain("stopped"))


def believes_the_count(monkeypatch):
    """The controller says that it went up: that is taken for the truth."""

    def confirmed(self):
        self.enter(State.STOPPED)
        return Reason("left.lifted")

    monkeypatch.setattr(Motion, "_confirm_lift", confirmed)


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
    open_end = {**TABLE, State.LIFTING: TABLE[State.LIFTING]._replace(exits=(State.STOPPED, State.PRESSING))}
    monkeypatch.setattr(interlock, "TABLE", open_end)

    def confirmed(self):
        self.enter(State.PRESSING, PROBED)
        return Reason("left.told")

    monkeypatch.setattr(Motion, "_confirm_lift", confirmed)


@pytest.mark.parametrize(
    ("mutate", "property_"),
    [
        (goes_on, "moves down after a stop"),
        (waits_for_ever, "a state has no deadline"),
        (lifts_on_hold, "moves by itself while somebody holds it"),
        (reports_lift_without_lifting, "says of the stage what is not so"),
        (believes_the_count, "says of the stage what is not so"),
        (omits_load_from_reason, "does not say what stands on the unit"),
        (lifts_the_wrong_way, "moves down after a stop"),
        (homes_to_get_away, "moves down after a stop"),
        (stays_open_after_a_stop, "a run does not end"),
    ],
)
def test_the_search_finds_a_safety_core_that_is_broken(monkeypatch, mutate, property_):
    mutate(monkeypatch)

    def broken_name(moves):
        return property_ if broken_property(moves).startswith(property_) else ""

    max_faults = 2 if mutate is believes_the_count else 1
    assert explore(broken_name, max_faults, stops_early=True).broken


def test_a_run_without_faults_does_all_of_its_moves():
    moves, _ = run_once([])
    assert moves.ended is State.OVER
    assert moves.commands == ["home", *["down", "stop", "up"] * 2, "down", "stop", "down", "up", "down", "stop", "up"]


def reached(start: State) -> set[State]:
    explored, waiting = set(), [start]
    while waiting:
        for following in TABLE[waiting.pop()].exits:
            if following not in explored:
                explored.add(following)
                waiting.append(following)
    return explored


@pytest.mark.parametrize("state", State)
def test_a_run_never_goes_back_and_after_a_stop_nothing_lowers_the_stage(state):
    assert state not in reached(state)
    if state in (State.STOPPING, State.LIFTING, *RESTS):
        assert not any(TABLE[following].moves.are_down for following in {state, *reached(state)})


@pytest.mark.parametrize("state", [state for state in State if state not in RESTS])
def test_a_fault_in_any_state_ends_the_run(state):
    assert State.STOPPING in TABLE[state].exits or reached(state) <= {State.LIFTING, State.STOPPED}
    assert set(RESTS) & reached(state)


def test_what_may_not_move_is_refused():
    for state, row in TABLE.items():
        run = Interlock()
        run.state = state
        for is_down in (True, False):
            if row.moves.are_down or (row.moves is AllowedMotion.UP and not is_down):
                run.check_move(is_down)
                continue
            with pytest.raises(ValueError):
                run.check_move(is_down)


def test_nothing_goes_down_unwatched_nor_onto_a_unit_before_all_that_needs_was_found():
    for row in TABLE.values():
        if row.moves.are_down:
            assert {StageMonitor.FORCE, StageMonitor.DEPTH, StageMonitor.STREAM} <= row.monitors and row.late_s < float(
                "inf"
            )
        if row.moves in (AllowedMotion.UNKNOWN, AllowedMotion.PROBED):
            assert {StageMonitor.FOLLOW, StageMonitor.STUCK_CELL, StageMonitor.STUCK_OUTPUT} <= row.monitors
            assert {"zero_N", "contact_mm"} <= set(row.needs)
        if row.moves is AllowedMotion.PROBED:
            assert {"probed_mm", "safe_mm_s"} <= set(row.needs)


@pytest.mark.parametrize("state", State)
def test_a_state_begins_only_where_the_table_says_and_with_all_it_needs(state):
    for before in State:
        for available in (PROBED, *(PROBED - {needed} for needed in TABLE[state].needs)):
            run = Interlock()
            run.state = before
            if state in TABLE[before].exits and available == PROBED:
                run.enter(state, available)
                assert run.state is state
                continue
            with pytest.raises(ValueError):
                run.enter(state, available)


class Stopped(Exception):
    pass


CHECKS = {
    StageMonitor.STREAM: (StreamMonitor, "check_silence"),
    StageMonitor.FORCE: (ForceMonitor, "check"),
    StageMonitor.DEPTH: (MonitoredBench, "check_depth"),
    StageMonitor.JUMP: (JumpMonitor, "check"),
    StageMonitor.FREE: (MonitoredBench, "check_free"),
    StageMonitor.FOLLOW: (FollowMonitor, "check"),
    StageMonitor.STUCK_CELL: (StuckMonitor, "check"),
    StageMonitor.STUCK_OUTPUT: (StuckMonitor, "check"),
    StageMonitor.RISE: (MonitoredBench, "check_rise"),
}


@pytest.mark.parametrize("monitor", StageMonitor)
def test_a_watch_is_on_where_the_table_names_it_and_nowhere_else(monitor, monkeypatch):
    """The watch is made to stop whatever it is shown: then a look at the devices stops the run, or it does not."""
    owner, method = CHECKS[monitor]
    with open_simulated_bench(seed=1) as (bench, _):
        monitored = MonitoredBench(bench)
        monitored.start()
        monitored.home()
        monitored.motion.wait(0.1)
        monitored.estimates = RunEstimates(0.0, 0.0, 0.5, 1.0, 1.0, 0.0)
        monitored.motion.state = State.SEARCHING
        monitored.expect_contact(0.5)
        mine = monitored._stuck.get(monitor, ())

        def stop(self, *arguments):
            if not mine or self in mine:
                raise Stopped

        monkeypatch.setattr(owner, method, stop)
        for state in RUNNING:
            monitored.motion.state = state
            monitored.start()
            assert stops(monitored, state) == (monitor in TABLE[state].monitors), state


def stops(monitored: MonitoredBench, state: State) -> bool:
    try:
        for _ in range(30):
            if state is State.HOMING:
                monitored.bench.clock.sleep_s(0.01)
                monitored._check_while_homing()
            else:
                monitored.tick()
    except Stopped:
        return True
    return False
