"""Zaber ASCII: bytes the official library sends, the official library on our simulated stage, and our own driver."""

import pytest
from zaber_motion import Units
from zaber_motion.ascii import Connection
from zaber_motion.exceptions import CommandFailedException

from softcal.core.errors import BadReply, CommandRefused, DeviceError
from softcal.station.drivers.zaber import ZaberStage
from softcal.station.interfaces import Move
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import World
from softcal.station.simulated.zaber import SimulatedZaber
from softcal.station.wire.frames import zaber
from softcal.station.wire.link import Link

SENT_BY_THE_OFFICIAL_LIBRARY = [
    (b"/0 0 01:FF", zaber.Command(0, 0, 1, "")),
    (b"/1 0 02 get comm.packet.size.max:CE", zaber.Command(1, 0, 2, "get comm.packet.size.max")),
    (b"/1 1 03 get pos:29", zaber.Command(1, 1, 3, "get pos")),
    (b"/1 1 04 move abs 1000:EC", zaber.Command(1, 1, 4, "move abs 1000")),
    (b"/1 1 05:F9", zaber.Command(1, 1, 5, "")),
]


@pytest.mark.parametrize(("line", "command"), SENT_BY_THE_OFFICIAL_LIBRARY)
def test_commands_of_the_official_library_byte_by_byte(line, command):
    assert zaber.parse_command(line) == (command, True)
    assert zaber.format_command(command) == line + b"\n"


def test_reply_of_the_manual():
    assert zaber.parse_reply(b"@01 1 03 OK IDLE -- 0") == zaber.Reply(1, 1, 3, True, False, "--", "0")
    assert zaber.parse_reply(b"@01 0 RJ BUSY WR BADCOMMAND") == zaber.Reply(1, 0, None, False, True, "WR", "BADCOMMAND")
    assert zaber.parse_reply(b"!01 1 IDLE --") is None
    assert zaber.parse_reply(b"#01 1 info") is None


@pytest.mark.parametrize(
    "line", [b"", b"@01 1", b"@01 1 03 OK IDLE -- 0:00", b"01 1 OK IDLE -- 0", b"@01 1 OK WAIT -- 0"]
)
def test_damaged_replies_are_refused(line):
    with pytest.raises(BadReply):
        zaber.parse_reply(line)


@pytest.fixture
def far_end(rng):
    world, wire = World(), Wire(rng)
    stage = SimulatedZaber(wire, Axis(200.0))
    stage.axis.position_mm = 1.0
    world.add(stage)
    yield world, stage
    wire.close()


def test_the_official_library_drives_the_simulated_stage(far_end):
    world, stage = far_end
    with world.in_background(), Connection.open_serial_port(stage.wire.port) as connection:
        device = connection.detect_devices(identify_devices=False)[0]
        axis = device.get_axis(1)
        axis.home()
        assert stage.axis.position_mm == 0.0
        axis.move_absolute(10_000, Units.NATIVE)
        assert axis.get_position(Units.NATIVE) == 10_000
        assert stage.axis.position_mm == pytest.approx(10_000 * stage.microstep_mm)
        with pytest.raises(CommandFailedException, match="BADCOMMAND"):
            axis.generic_command("dance")


@pytest.fixture
def driver(far_end):
    world, stage = far_end
    return ZaberStage(Link(stage.wire.port, world), stage.microstep_mm), world, stage


def finish(driver, world):
    while driver.is_moving:
        world.sleep_s(0.005)
        driver.poll()


def test_a_move_is_done_when_the_device_is_idle(driver):
    device, world, stage = driver
    device.home()
    device.begin(Move(5.0, 4.0))
    began_s = world.now_s()
    finish(device, world)
    assert stage.axis.position_mm == pytest.approx(5.0, abs=1e-3)
    assert device.position_mm == pytest.approx(5.0, abs=1e-3)
    assert world.now_s() - began_s == pytest.approx(5.0 / 4.0 + 4.0 / 200.0, abs=0.12)


def test_declared_quantities_agree_with_the_simulated_device(driver):
    device, _, stage = driver
    assert device.travel_mm == pytest.approx(40.0, abs=1e-3)
    assert device.acceleration_mm_s2 == pytest.approx(200.0, rel=0.01)
    assert device.max_speed_mm_s == pytest.approx(25.0, rel=1e-4)


def test_a_speed_that_no_setting_can_hold_is_never_sent(driver):
    device, _, stage = driver
    device.home()
    before, device.max_speed_mm_s = stage.settings["maxspeed"], 1e9
    with pytest.raises(CommandRefused, match="speed"):
        device.begin(Move(5.0, 1e8))
    assert stage.settings["maxspeed"] == before and not device.is_moving
    device.begin(Move(5.0, 4.0))
    assert stage.settings["maxspeed"] == pytest.approx(4.0 / 0.0001905 * 1.6384, abs=0.6)


def test_out_of_range_sends_nothing(driver):
    device, _, stage = driver
    device.home()
    for move, message in ((Move(41.0, 4.0), r"41 mm .*\[0, 40\] mm"), (Move(5.0, 400.0), "400 mm/s")):
        with pytest.raises(CommandRefused, match=message):
            device.begin(move)
    assert not stage.axis.is_moving


def test_stop_brakes_and_keeps_the_position(driver):
    device, world, stage = driver
    device.home()
    device.begin(Move(30.0, 20.0))
    world.sleep_s(0.5)
    device.stop()
    assert not stage.axis.is_moving
    assert device.is_position_known
    assert device.position_mm == pytest.approx(stage.axis.position_mm, abs=1e-3)


@pytest.mark.parametrize(("fault", "flag"), [("stall", "FS"), ("turn_knob", "NC")])
def test_a_move_that_was_not_undisturbed_is_not_good(driver, fault, flag):
    device, world, stage = driver
    device.home()
    device.begin(Move(30.0, 10.0))
    world.at(world.now_s() + 0.5, getattr(stage, fault))
    with pytest.raises(DeviceError, match=flag):
        finish(device, world)
    assert not device.is_position_known
