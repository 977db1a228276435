"""What may hurt a hand, a sensor or a cell: default settings, the self-test, the hold button, Ctrl-C, stiff things."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common.fault_trial import is_report_true
from common.rig_trial import ForceLaw, LawUnit, RigCase, open_rig, press, press_until_gone

from softcal.app.line.rig import station_of
from softcal.core.errors import DeviceError, InputError, NoReply
from softcal.core.messages.reason import plain
from softcal.core.profiles import ramps
from softcal.station.bench.station_file import station_from_table
from softcal.station.drivers.grbl import GrblStage
from softcal.station.interfaces import Move, StageOnHold
from softcal.station.motion.monitored_bench import bounds_of
from softcal.station.motion.motion import StoppedByHand
from softcal.station.simulated.grbl import SimulatedGrbl
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.text_stream import SimulatedTextStream
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import World
from softcal.station.tasks.acquisition import record
from softcal.station.tasks.durations import PRESSING, PROBING
from softcal.station.tasks.identify import DeviceIdentity, identify
from softcal.station.tasks.self_test import self_test
from softcal.station.wire.link import Link

QUICK = RigCase(latency_s=0.0, stiffest_N_mm=100.0)
PROFILE = ramps([2.0, 2.0], 4.0, rest_s=0.5)


@pytest.fixture
def slow_stage(rng):
    """A homed stage with the acceleration of a fresh GRBL."""
    world, wire = World(), Wire(rng)
    controller = SimulatedGrbl(wire, Axis(10.0))
    world.add(controller)
    stage = GrblStage(Link(wire.port, world))
    stage.home()
    yield stage, world, controller
    wire.close()


def run_for(stage, world, seconds):
    end_s = world.now_s() + seconds
    while world.now_s() < end_s:
        world.sleep_s(0.005)
        stage.poll()


def test_a_stop_waits_as_long_as_the_drive_brakes_and_keeps_the_position(slow_stage):
    stage, world, controller = slow_stage
    stage.begin(Move(30.0, 8.0))
    run_for(stage, world, 2.0)
    stage.stop()  # 8 mm/s at 10 mm/s² brake for 0.8 s
    assert stage.is_position_known
    assert stage.position_mm == pytest.approx(controller.axis.position_mm, abs=2e-3)


def test_a_stop_that_had_to_cut_the_motion_still_lifts(slow_stage):
    stage, world, controller = slow_stage
    stage.begin(Move(30.0, 8.0))
    run_for(stage, world, 2.0)
    controller.axis.acceleration_mm_s2 = 1.0  # far from what its settings say
    stage.stop()
    assert not stage.is_position_known and stage.can_lift_roughly
    at_mm = controller.axis.position_mm
    stage.lift_roughly(4.0, 5.0)
    while stage.is_moving:
        world.sleep_s(0.005)
        stage.poll()
    assert controller.axis.position_mm == pytest.approx(at_mm - 4.0, abs=0.01)
    assert not stage.is_position_known


def test_default_acceleration_and_a_stop_of_20_N_mm_stay_at_the_limit_and_end_lifted():
    case = replace(QUICK, acceleration_mm_s2=10.0, law=ForceLaw(stop_mm=1.5, stop_N_mm=20.0))
    outcome = press(case, ramps([2.0], 5.0, rest_s=0.5))
    assert " 5 N" in outcome.message
    assert outcome.largest_N < 6.0
    assert outcome.is_up


@pytest.mark.parametrize("stop_N_mm", [100.0, 1000.0])
def test_a_hard_stop_under_a_soft_layer_is_met_slowly(stop_N_mm):
    case = replace(QUICK, stiffest_N_mm=1000.0, law=ForceLaw(stop_mm=1.0, stop_N_mm=stop_N_mm))
    outcome = press(case, ramps([1.5], 10.0, rest_s=0.5))
    assert outcome.largest_N < 0.9 * case.capacity_N
    assert outcome.is_up


def test_a_rigid_thing_in_the_way_of_the_approach_is_met_slowly():
    case = replace(QUICK, stiffest_N_mm=1000.0, surface_mm=1.2, law=ForceLaw(stop_mm=0.0, stop_N_mm=1000.0))
    outcome = press(case, PROFILE)
    assert " 1.2" in outcome.message
    assert outcome.largest_N < 0.9 * case.capacity_N
    assert outcome.is_up


def test_a_profile_that_a_stop_cannot_hold_is_refused_with_the_speed_that_can():
    case = replace(QUICK, acceleration_mm_s2=10.0, law=ForceLaw(stop_mm=1.0, stop_N_mm=8.0), limit_N=15.0)
    outcome = press(case, ramps([1.8], 8.0, rest_s=0.5))
    fastest = min(map(float, re.findall(r"([\d.]+) mm/s(?!²)", outcome.message)))
    assert 0.0 < fastest < 8.0
    assert press(case, ramps([1.8], 0.95 * fastest, rest_s=0.5)).message == ""


def test_the_self_test_watches_the_force_and_keeps_above_the_approach():
    with open_rig(replace(QUICK, surface_mm=1.4, law=ForceLaw(stop_mm=0.0, stop_N_mm=60.0))) as (bench, station):
        assert not all(finding.is_good for finding in self_test(bench) if str(finding.device) == "stage")
        assert station.axis.deepest_mm - 1.4 < 12.0 / 60.0
    with open_rig(QUICK) as (bench, station):
        assert all(finding.is_good for finding in self_test(bench) if str(finding.device) == "stage")
        assert station.axis.deepest_mm <= QUICK.approach_mm + 1e-6


def test_the_self_test_can_be_stopped():
    with open_rig(QUICK) as (bench, station):
        homed_s = []

        def press_ctrl_c():
            if bench.stage.is_position_known and bench.stage.position_mm > 1.2:
                homed_s.append(bench.clock.now_s())
                raise KeyboardInterrupt

        with pytest.raises(StoppedByHand) as stopped:
            self_test(bench, on_wait=press_ctrl_c)
        assert stopped.value.reason.values["state"].code == "left.lifted"
        assert homed_s and not station.axis.is_moving


@pytest.mark.parametrize("phase", ["searching for contact", PROBING, PRESSING])
def test_a_held_stage_is_not_lifted_and_the_load_on_the_unit_is_reported(phase):
    with open_rig(QUICK) as (bench, station):
        hold_when(station, phase, 0.8)
        with pytest.raises(StageOnHold, match=r" -?[\d.]+ N ") as caught:
            record(bench, "H1", PROFILE, True, station.on_progress)
        before_mm = station.axis.position_mm
        station.world.sleep_s(10.0)
        assert station.axis.position_mm == before_mm
        lift_state = caught.value.reason.values["state"]
        assert (lift_state.code, lift_state.values["state"].code) == ("left.stands", "left.held")
        depth_mm = before_mm - QUICK.surface_mm
        assert lift_state.values["force_N"] == pytest.approx(float(QUICK.law.force_N(depth_mm)), abs=0.15)


def test_a_stage_held_while_it_goes_back_ends_the_run_in_time():
    with open_rig(QUICK) as (bench, station):
        hold_when(station, "reading the zero return", 0.05)
        began_s = station.world.now_s()
        with pytest.raises(StageOnHold):
            record(bench, "H1", PROFILE, True, station.on_progress)
        assert station.world.now_s() - began_s < 60.0


def test_a_stage_held_while_it_is_lifted_after_a_stop_stays_there():
    with open_rig(QUICK) as (bench, station):

        def break_cell_then_hold(progress):
            is_deep = progress.phase == PRESSING and progress.stage_mm > QUICK.surface_mm + 1.5
            if is_deep and station.force_wire.is_plugged:
                station.force_wire.unplug()
                station.world.at(station.world.now_s() + 0.35, station.stage.press_hold)

        with pytest.raises(NoReply) as caught:
            record(bench, "H1", PROFILE, True, break_cell_then_hold)
        assert caught.value.reason.values["state"].code == "left.may_stand"
        before_mm = station.axis.position_mm
        station.world.sleep_s(10.0)
        assert station.axis.position_mm == before_mm


def hold_when(station, phase, after_s):
    presses = []

    def on_progress(progress):
        if progress.phase == phase and not presses:
            presses.append(True)
            station.world.at(station.world.now_s() + after_s, station.stage.press_hold)

    station.on_progress = on_progress


def test_ctrl_c_stops_lifts_and_says_so():
    with open_rig(QUICK) as (bench, station):

        def interrupt(progress):
            if progress.phase == PRESSING and progress.stage_mm > QUICK.surface_mm + 1.0:
                raise KeyboardInterrupt

        with pytest.raises(StoppedByHand) as stopped:
            record(bench, "C1", PROFILE, True, interrupt)
        assert stopped.value.reason.values["state"].code == "left.lifted"
        assert station.axis.position_mm == pytest.approx(QUICK.approach_mm, abs=0.01)
        assert isinstance(stopped.value, DeviceError)  # Exit code 3.


def test_the_self_test_names_unsafe_settings_and_the_command_that_mends_each():
    with open_rig(replace(QUICK, acceleration_mm_s2=10.0)) as (bench, _):
        bench.stage.settings.values.update({1: 25.0, 20: 0.0, 21: 0.0})
        cure_by_setting = {str(f.value): str(f.cure) for f in self_test(bench) if str(f.what) == "setting"}
    assert set(cure_by_setting) == {"$1=25", "$20=0", "$21=0", "$122=10"}
    cures = [re.findall(r"\$\d+=\d+", cure) for cure in cure_by_setting.values()]
    assert cures == [["$1=255"], ["$20=1"], ["$21=1"], ["$122=200"]]


TABLE = {"stage": {"port": "/dev/a"}, "readout": {"port": "/dev/b"}}


def test_a_station_without_a_load_cell_is_refused_unless_a_person_answers_for_it():
    with pytest.raises(InputError, match=r"\[force\]"):
        station_from_table(TABLE)
    assert station_from_table(TABLE | {"safety": {"without_cell": True}}).force is None


def test_a_limit_that_leaves_no_room_to_stop_is_refused():
    force = {"port": "/dev/c", "capacity_N": 20.0}
    with pytest.raises(InputError, match=r"safety\.force_N .*19.*\[0, 16\]"):
        station_from_table(TABLE | {"force": force, "safety": {"force_N": 19.0}})


STAGE = DeviceIdentity("/dev/s", "stage", "grbl", plain("Grbl 1.1h"))


def test_two_streams_that_could_be_either_are_not_guessed_between():
    first = DeviceIdentity("/dev/1", "readout", "arduino", plain("text stream"), 80.0, 1)
    second = DeviceIdentity("/dev/2", "readout", "arduino", plain("text stream"), 50.0, 1)
    with pytest.raises(NoReply, match="/dev/1.*/dev/2"):
        station_of([STAGE, first, second])


def test_a_station_file_is_never_made_without_a_load_cell():
    readout = DeviceIdentity("/dev/1", "readout", "arduino", plain("softcal readout 1"), 50.0, 1)
    with pytest.raises(NoReply) as missing:
        station_of([STAGE, readout])
    assert missing.value.reason.values["parts"].code == "part.cell"


def test_a_bare_stream_of_small_counts_is_not_taken_for_a_readout(rng):
    world, wire = World(), Wire(rng)
    world.add(SimulatedTextStream(wire, lambda now_s: (8_000 + int(rng.integers(-40, 40)),), 80.0, banner=b""))
    world.sleep_s(2.0)
    identity = identify(wire.port, world)
    wire.close()
    assert identity.role == ""


def test_every_move_of_softcal_is_made_in_one_place():
    root = Path(__file__).parents[2]
    # It presses the simulated unit to show how a map is followed.
    simulated_only = root / "app" / "operation" / "source.py"
    callers = [
        f"{path.relative_to(root)}: {line.strip()}"
        for folder in ("station", "app", "core")
        for path in (root / folder).rglob("*.py")
        if "drivers" not in path.parts
        and "simulated" not in path.parts
        and "testing" not in path.parts  # the kit tries a driver by itself, on its simulated far end
        and path.name != "motion.py"
        and path != simulated_only
        for line in path.read_text().splitlines()
        if re.search(r"stage\.(home|begin|stop|lift_roughly)\(", line)
    ]
    assert callers == []


@pytest.mark.parametrize("acceleration_mm_s2", [10.0, 500.0])
@pytest.mark.parametrize("at_mm", [0.99, 1.0, 1.001])
def test_a_host_that_dies_above_a_hard_stop_leaves_less_than_the_cell_can_bear(acceleration_mm_s2, at_mm):
    law = ForceLaw(stop_mm=1.0, stop_N_mm=1000.0)
    case = replace(QUICK, acceleration_mm_s2=acceleration_mm_s2, stiffest_N_mm=1000.0, law=law)
    force_N = press_until_gone(case, ramps([1.5], 8.0), PROBING, at_mm)
    assert force_N is not None and force_N < 0.9 * case.capacity_N


def test_the_self_test_measures_how_far_the_stage_runs_on_and_says_the_most_in_mm_and_N():
    with open_rig(replace(QUICK, stiffest_N_mm=1000.0, acceleration_mm_s2=10.0)) as (bench, _):
        findings = {str(f.what): f for f in self_test(bench) if str(f.device) == "stage"}
    maximum, measured = findings["runs on when the host dies"].value.values, findings["ran on when left alone"]
    assert QUICK.limit_N < maximum["worst_N"] <= 0.9 * QUICK.capacity_N + 0.05
    way = measured.value.values
    assert 0.5 * way["most_mm"] < way["way_mm"] <= way["most_mm"] and measured.is_good


def test_what_appears_after_the_slow_press_ends_within_the_stated_bound():
    """No software holds it below the cell's capacity: the bound is what docs/hazards.md states first."""
    case, stop_N_mm, speed_mm_s = replace(QUICK, law=ForceLaw(1.0, 1.0)), 100.0, 10.0
    with open_rig(case) as (bench, station):
        bound_N = bounds_of(bench).worst_N(speed_mm_s, case.limit_N, stop_N_mm)
        unit = LawUnit(replace(case.law, stop_mm=1.0, stop_N_mm=stop_N_mm), np.random.default_rng(1))

        def appear(progress):
            if progress.phase == PRESSING and station.rig.largest_force_N < case.limit_N:
                station.rig.mount([unit], case.surface_mm, 0.0)

        with pytest.raises(DeviceError) as stopped:
            record(bench, "R1", ramps([2.0], speed_mm_s, rest_s=0.5), True, appear)
        assert is_report_true(stopped.value, bench, station)
        assert case.capacity_N < station.rig.largest_force_N < bound_N


def test_a_controller_that_runs_on_further_than_it_was_told_is_a_fault():
    with open_rig(replace(QUICK, stiffest_N_mm=1000.0)) as (bench, station):
        declared_mm = bench.stage.runs_on_mm
        bench.stage.runs_on_mm = lambda move: declared_mm(move) - 0.1
        (finding,) = [f for f in self_test(bench) if str(f.what) == "ran on when left alone"]
    assert not finding.is_good
