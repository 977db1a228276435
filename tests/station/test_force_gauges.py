"""Mark-10 gauges, Loadstar interfaces, indicators: bytes of their manuals, then the drivers on simulated far ends."""

import pytest

from softcal.core.errors import BadReply, CommandRefused, NoReply
from softcal.station.drivers import loadstar
from softcal.station.drivers.indicator import IndicatorCell, parse_N
from softcal.station.drivers.loadstar import LoadstarCell
from softcal.station.drivers.mark10 import Mark10Gauge
from softcal.station.simulated.force_gauge import SimulatedIndicator, SimulatedLoadstar, SimulatedMark10
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import World
from softcal.station.wire.frames import gcl2
from softcal.station.wire.link import Link


def test_readings_of_the_manual_in_newtons():
    assert gcl2.parse_reading_N(b"-18.78 lbF\r") == pytest.approx(-83.54, abs=0.005)  # 1 lbf = 4.448222 N
    assert gcl2.parse_reading_N(b"2.500 N") == 2.5
    assert gcl2.parse_reading_N(b"+0.250 kgF") == pytest.approx(2.4517, abs=1e-4)


def test_settings_of_the_manual():
    settings = gcl2.parse_settings(b"V1.00;LBF;CUR;FLTC8;FLTP1;AOUT00;AOFF5;FULL;MIT;POL;B0")
    assert settings == gcl2.GaugeSettings("LBF", "CUR", has_units=True, has_sign=True)


@pytest.mark.parametrize("line", [b"*10", b"*22", b"", b"-18.78", b"-18.7", b"8.78 lb F", b"\xff", b"1.0 Nm"])
def test_an_error_code_a_cut_line_or_a_foreign_unit_is_no_force(line):
    with pytest.raises(BadReply):
        gcl2.parse_reading_N(line)


def test_indicator_lines():
    assert parse_N(b"ST,GS,+  4.876kg") == pytest.approx(4.876 * 9.80665)
    assert parse_N(b"US,NT,-0.100kg") == pytest.approx(-0.980665)
    for line in (b"OL,GS,+ 99.999kg", b"GS,+  4.876kg"):
        with pytest.raises(BadReply):
            parse_N(line)


@pytest.fixture
def rig(rng):
    """A world, a wire, and a force that grows by 1 N/s."""
    world, wire = World(), Wire(rng)
    yield world, wire, lambda now_s: now_s
    wire.close()


def collect(world, reader, seconds):
    samples, end_s = [], world.now_s() + seconds
    reader.start()
    while world.now_s() < end_s:
        world.sleep_s(0.005)
        samples += reader.poll()
    return samples


def test_a_gauge_left_in_peak_mode_and_pounds_is_set_right_and_read_in_newtons(rig):
    world, wire, force = rig
    gauge = SimulatedMark10(wire, force)
    world.add(gauge)
    reader = Mark10Gauge(Link(wire.port, world), 50.0)
    assert (gauge.unit, gauge.mode) == ("N", "CUR")
    samples = collect(world, reader, 2.0)
    assert len(samples) > 60
    assert all(s.values[0] == pytest.approx(s.host_s, abs=0.06) for s in samples)


def test_inverted_polarity_is_turned(rig):
    world, wire, _ = rig
    world.add(SimulatedMark10(wire, lambda now_s: -3.0))
    assert collect(world, Mark10Gauge(Link(wire.port, world), 50.0, sign=-1.0), 0.2)[0].values == (3.0,)


def test_a_gauge_that_hides_its_unit_is_refused_before_anything_moves(rig):
    world, wire, force = rig
    gauge = SimulatedMark10(wire, force)
    gauge.is_numeric_only = True
    world.add(gauge)
    with pytest.raises(CommandRefused):
        Mark10Gauge(Link(wire.port, world), 50.0)


def test_a_unit_changed_by_hand_in_mid_run_is_still_newtons(rig):
    world, wire, _ = rig
    gauge = SimulatedMark10(wire, lambda now_s: 2.0)
    world.add(gauge)
    reader = Mark10Gauge(Link(wire.port, world), 50.0)
    world.at(0.3, lambda: setattr(gauge, "unit", "LBF"))
    assert all(s.values[0] == pytest.approx(2.0, abs=0.003) for s in collect(world, reader, 1.0))


def test_an_indicator_stream_in_newtons_until_it_is_overloaded(rig):
    world, wire, force = rig
    indicator = SimulatedIndicator(wire, force)
    indicator.capacity_N = 2.0
    world.add(indicator)
    reader = IndicatorCell(Link(wire.port, world), 20.0)
    samples = collect(world, reader, 1.5)
    assert all(s.values[0] == pytest.approx(s.host_s, abs=0.12) for s in samples)
    with pytest.raises(BadReply) as over:
        collect(world, reader, 1.5)
    assert over.value.reason.code == "indicator.overloaded"


def test_loadstar_lines_of_its_command_set():
    assert loadstar.parse_N(b"3.04", "N") == 3.04
    assert loadstar.parse_N(b"-0.000456\r", "kgf") == pytest.approx(-0.000456 * 9.80665)
    assert loadstar.parse_unit(b"lb\r") == "lb"
    for line in (b"E", b"", b"A", b"3.0.4", b"\xff"):
        with pytest.raises(BadReply):
            loadstar.parse_N(line, "N")
    with pytest.raises(BadReply, match="'psi'"):
        loadstar.parse_unit(b"psi")


@pytest.mark.parametrize("model", ["FCM DI-1000", "FCM DI-100"])
def test_a_loadstar_stream_in_pounds_is_read_in_newtons(rig, model):
    world, wire, force = rig
    far_end = SimulatedLoadstar(wire, force)
    far_end.model = model
    world.add(far_end)
    reader = LoadstarCell(Link(wire.port, world), 50.0)
    samples = collect(world, reader, 2.0)
    assert len(samples) > 140
    assert all(s.values[0] == pytest.approx(s.host_s, abs=0.12) for s in samples)
    reader.close()
    world.sleep_s(0.1)
    assert far_end.next_event_s() == float("inf")  # The stream has ended.


def test_a_loadstar_that_only_reports_errors_is_no_load_cell(rig):
    world, wire, force = rig
    far_end = SimulatedLoadstar(wire, force)
    world.add(far_end)
    reader = LoadstarCell(Link(wire.port, world), 50.0)
    far_end.is_faulty = True
    with pytest.raises(BadReply, match="'E'"):
        collect(world, reader, 1.0)


@pytest.mark.parametrize(("name", "value", "error"), [("model", "PS-100", NoReply), ("unit", "psi", BadReply)])
def test_a_loadstar_of_another_kind_is_refused_before_anything_moves(rig, name, value, error):
    world, wire, force = rig
    far_end = SimulatedLoadstar(wire, force)
    setattr(far_end, name, value)
    world.add(far_end)
    with pytest.raises(error):
        LoadstarCell(Link(wire.port, world), 50.0)
