"""The GRBL driver on the simulated controller: refusals send nothing, stops do not wait, a dead host moves nothing."""

import numpy as np
import pytest

from softcal.core.errors import CommandRefused, DeviceError, NoReply
from softcal.station.devices.piece_feed import AHEAD_S, PIECE_S
from softcal.station.drivers.grbl import GrblStage
from softcal.station.interfaces import Move
from softcal.station.simulated.grbl import SEGMENTS_S, SimulatedGrbl
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import World
from softcal.station.wire.link import Link


@pytest.fixture
def far_end(rng):
    world, wire = World(), Wire(rng)
    controller = SimulatedGrbl(wire, Axis(200.0))
    controller.axis.position_mm = 3.0
    world.add(controller)
    yield world, controller
    wire.close()


@pytest.fixture
def homed(far_end):
    world, controller = far_end
    stage = GrblStage(Link(controller.wire.port, world))
    stage.home()
    return stage, world, controller


def poll_until_done(stage, world):
    positions = []
    while stage.is_moving:
        world.sleep_s(0.005)
        positions += stage.poll()
    return positions


def test_settings_are_read_from_the_controller(homed):
    stage, _, controller = homed
    assert (stage.travel_mm, stage.max_speed_mm_s, stage.acceleration_mm_s2) == (40.0, 25.0, 200.0)
    assert stage.is_position_known
    assert stage.position_mm == pytest.approx(controller.axis.position_mm, abs=1e-3)


def test_a_move_in_pieces_is_one_smooth_stroke(homed):
    stage, world, controller = homed
    began_s = world.now_s()
    stage.begin(Move(11.0, 5.0))
    poll_until_done(stage, world)
    assert controller.axis.position_mm == pytest.approx(11.0, abs=1e-4)
    # 10 mm at 5 mm/s with 200 mm/s²: a stop between pieces would cost far more than the line's delays.
    assert world.now_s() - began_s == pytest.approx(10 / 5 + 5 / 200, abs=0.06)


def test_positions_are_stamped_between_question_and_answer(homed):
    stage, world, controller = homed
    stage.begin(Move(21.0, 10.0))
    truth, positions = [], []
    while stage.is_moving:
        world.sleep_s(0.005)
        controller.axis.advance(world.now_s())
        truth.append((world.now_s(), controller.axis.position_mm))
        positions += stage.poll()
    at_s, at_mm = zip(*truth, strict=True)
    late_mm = [position.position_mm - np.interp(position.host_s, at_s, at_mm) for position in positions]
    assert abs(np.median(late_mm)) < 10.0 * 0.005  # the line's delay is 5 ms; a stalled answer may be worse


@pytest.mark.parametrize(
    ("move", "message"),
    [
        (Move(40.1, 5.0), r"40\.1 mm .*\[0, 40\] mm"),
        (Move(-0.1, 5.0), "-0.1 mm "),
        (Move(10.0, 26.0), r"26 mm/s .*\(0, 25\] mm/s"),
        (Move(10.0, 0.0), " 0 mm/s"),
    ],
)
def test_out_of_range_sends_nothing(homed, move, message):
    stage, world, controller = homed
    with pytest.raises(CommandRefused, match=message):
        stage.begin(move)
    world.sleep_s(0.1)
    assert not controller.axis.is_moving


def test_stop_brakes_at_once_and_keeps_the_position(homed):
    stage, world, controller = homed
    stage.begin(Move(30.0, 20.0))
    for _ in range(100):
        world.sleep_s(0.005)
        stage.poll()
    controller.axis.advance(world.now_s())
    at_mm = controller.axis.position_mm
    stage.stop()
    assert not controller.axis.is_moving
    # The motion already cut into steps runs out before the controller brakes: 0.06 s of a real one.
    assert controller.axis.position_mm - at_mm < 20.0**2 / (2 * 200.0) + 20.0 * (SEGMENTS_S + 0.01)
    assert stage.is_position_known
    assert stage.position_mm == pytest.approx(controller.axis.position_mm, abs=2e-3)


def test_when_the_host_dies_the_stage_soon_stops_by_itself(homed):
    stage, world, controller = homed
    stage.begin(Move(39.0, 10.0))
    for _ in range(100):
        world.sleep_s(0.005)
        stage.poll()
    died_s = world.now_s()
    world.sleep_s(5.0)
    assert not controller.axis.is_moving
    assert controller.axis.position_mm < 15.0
    assert controller.axis.standstills_s[-1] - died_s < AHEAD_S + PIECE_S + 0.1


def test_a_host_that_comes_back_after_a_stall_finishes_the_move(homed):
    stage, world, controller = homed
    stage.begin(Move(21.0, 10.0))
    world.sleep_s(1.0)
    poll_until_done(stage, world)
    assert controller.axis.position_mm == pytest.approx(21.0, abs=1e-4)


@pytest.mark.parametrize(("setting", "value", "cure"), [(22, 0.0, r"\$22=1"), (13, 1.0, r"\$13=0")])
def test_a_controller_that_is_not_set_up_is_refused(far_end, setting, value, cure):
    world, controller = far_end
    controller.settings[setting] = value
    with pytest.raises(CommandRefused, match=cure):
        GrblStage(Link(controller.wire.port, world))


def test_a_reset_in_mid_run_makes_the_position_unknown_until_homed_again(homed):
    stage, world, controller = homed
    stage.begin(Move(21.0, 10.0))
    world.at(world.now_s() + 0.3, controller.dip_power)
    with pytest.raises(DeviceError) as restarted:
        poll_until_done(stage, world)
    assert restarted.value.reason.code == "grbl.restarted"
    stage.stop()
    assert not stage.is_position_known
    with pytest.raises(CommandRefused):
        stage.begin(Move(1.0, 1.0))
    stage.home()
    assert stage.position_mm == pytest.approx(controller.axis.position_mm, abs=1e-3)


def test_a_port_has_one_owner_and_the_other_is_named(far_end):
    world, controller = far_end
    first = Link(controller.wire.port, world)
    with pytest.raises(NoReply, match=controller.wire.port):
        Link(controller.wire.port, world)
    first.close()
    Link(controller.wire.port, world).close()
