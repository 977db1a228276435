"""Mark-10 ESM stand: bytes of its manual, then stage and gauge on one simulated port."""

import pytest

from softcal.core.errors import BadReply, CommandRefused, DeviceError, InputError, NoReply
from softcal.station.bench.bench import open_bench
from softcal.station.devices.config import ReadoutConfig, StageConfig, StationConfig
from softcal.station.drivers.esm import EsmConfig, EsmGauge, EsmGaugeConfig, EsmStage
from softcal.station.interfaces import Move
from softcal.station.simulated.esm import SimulatedEsm
from softcal.station.simulated.force_gauge import SimulatedMark10
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import World
from softcal.station.wire.frames import esm
from softcal.station.wire.link import Link


def test_commands_of_the_manual():
    # ESM303 User's Guide, section 6.2: e0200.3 = 200.3 mm/min, g-007.52 = -7.52 mm, h010.70 = 10.7 mm.
    assert esm.speed(200.3 / 60) == b"e0200.3"
    assert esm.lower_limit(-7.52) == b"g-007.52"
    assert esm.upper_limit(10.7) == b"h010.70"
    assert esm.to_gauge("LIST") == b"/LIST\\"


def test_answers_of_the_manual():
    assert esm.parse_status(b"SMUL") == esm.StandStatus("S", "M", "UL")
    assert esm.parse_status(b"D L") == esm.StandStatus("D", "L", "")
    assert esm.parse_travel_mm(b"-7.52 mm") == -7.52
    assert esm.parse_travel_mm(b"-0.550 in") == pytest.approx(-13.97)


@pytest.mark.parametrize("line", [b"", b"X", b"-18.78 lbF", b"\xff", b"7.5.2"])
def test_anything_else_is_no_answer(line):
    with pytest.raises(BadReply):
        esm.parse_status(line)
    with pytest.raises(BadReply):
        esm.parse_travel_mm(line)


@pytest.fixture
def stand(rng):
    world, wire, nowhere = World(), Wire(rng), Wire(rng)
    axis = Axis(200.0)
    axis.position_mm = 12.0
    far_end = SimulatedEsm(wire, axis, SimulatedMark10(nowhere, lambda now_s: axis.position_mm / 10))
    world.add(far_end)
    yield world, far_end
    wire.close()
    nowhere.close()


@pytest.fixture
def stage(stand):
    world, far_end = stand
    return EsmStage(Link(far_end.wire.port, world))


def finish(stage, world):
    while stage.is_moving:
        world.sleep_s(0.005)
        stage.poll()


def test_home_is_the_upper_limit_switch(stage, stand):
    _, far_end = stand
    stage.home()
    assert far_end.axis.position_mm == pytest.approx(0.0, abs=1e-6)
    assert stage.position_mm == pytest.approx(0.0, abs=0.01)


def test_a_missing_switch_is_reported(stage, stand):
    _, far_end = stand
    far_end.is_switch_missing = True
    with pytest.raises(DeviceError):
        stage.home()
    assert not stage.is_position_known
    assert not far_end.axis.is_moving


def test_out_of_range_sends_nothing(stage, stand):
    world, far_end = stand
    stage.home()
    for move, code in ((Move(101.0, 4.0), "rig.outside.travel"), (Move(5.0, 30.0), "rig.outside.speed")):
        with pytest.raises(CommandRefused) as refused:
            stage.begin(move)
        assert refused.value.reason.code == code
    world.sleep_s(0.2)
    assert not far_end.axis.is_moving


def test_stop_stands_at_once_and_keeps_the_position(stage, stand):
    world, far_end = stand
    stage.home()
    stage.begin(Move(50.0, 15.0))
    world.sleep_s(1.0)
    began_s = world.now_s()
    stage.stop()
    assert world.now_s() - began_s < 0.5
    assert not far_end.axis.is_moving
    assert stage.is_position_known
    assert stage.position_mm == pytest.approx(far_end.axis.position_mm, abs=0.01)


def test_a_stop_at_the_panel_is_no_finished_move(stage, stand):
    world, far_end = stand
    stage.home()
    stage.begin(Move(50.0, 10.0))
    world.at(world.now_s() + 1.0, far_end.press_panel)
    with pytest.raises(DeviceError, match="50.00 mm"):
        finish(stage, world)


def test_the_gauge_answers_through_the_stand_while_it_moves(stage, stand):
    world, far_end = stand
    stage.home()
    gauge = EsmGauge(stage.port, 50.0, 1.0, 50.0)
    stage.begin(Move(40.0, 10.0))
    gauge.start()
    samples, polls = [], []
    while stage.is_moving:
        world.sleep_s(0.005)
        polls += stage.poll()
        samples += gauge.poll()
    assert len(samples) > 150
    assert len(polls) > 60
    # 10 mm/s and 0.1 N/mm: a reading 20 ms off its time would be 0.02 N off.
    assert samples[-1].values[0] == pytest.approx(4.0, abs=0.03)


def test_a_gauge_on_a_stand_needs_the_stand(stand):
    with pytest.raises(InputError, match="/dev/a"):
        StationConfig(StageConfig("/dev/a"), ReadoutConfig("/dev/b"), EsmGaugeConfig("/dev/a"))
    world, far_end = stand
    config = StationConfig(EsmConfig(far_end.wire.port), ReadoutConfig("/dev/b"), EsmGaugeConfig("/dev/a"))
    with pytest.raises(NoReply, match="ESM"), open_bench(config, world):
        pass
