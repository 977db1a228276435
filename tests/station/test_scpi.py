"""Bench instruments over SCPI: answers of their manuals, then the driver over TCP, a serial line and PyVISA."""

import numpy as np
import pytest

from softcal.core.errors import BadReply, CommandRefused, InputError, NoReply
from softcal.core.profiles import moves
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.clock import HostClock
from softcal.station.devices.driver import Opening
from softcal.station.drivers.scpi import DRIVERS, DmmConfig, LcrConfig, dmm_setup, lcr_setup, parse_reading
from softcal.station.simulated.scpi import SimulatedDmm, SimulatedLcr
from softcal.station.simulated.wire import SocketEnd, Wire, serial_line
from softcal.station.simulated.world import World
from softcal.station.tasks.acquisition import record
from softcal.station.wire.link import Link

DMM, LCR = DRIVERS


def test_answers_of_the_manuals():
    assert parse_reading(b"+1.04530000E+03") == 1045.3
    assert parse_reading(b"-4.27150000E-03\r") == -0.0042715
    assert parse_reading(b"+1.05928E-11,+1.00342E-02,+0") == pytest.approx(10.5928e-12)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"+9.90000000E+37", "scpi.overload"),
        (b"-9.90000000E+37", "scpi.overload"),
        (b"nan", "scpi.overload"),
        (b"+9.90000E+37,+9.90000E+37,+1", "scpi.overloaded"),
        (b"+1.0E-11,+1.0E-02,+4", "scpi.level"),
        (b"+1.0E-11,+1.0E-02,-1", "scpi.no_data"),
        (b"+1.0E-11,+1.0E-02,+9", "scpi.status.other"),
        (b"+1.0E-11,+1.0E-02,x", "scpi.whole"),
        (b"", "scpi.reading"),
        (b"Keysight Technologies,34461A", "scpi.reading"),
        (b"\xff\xfe", "scpi.reading"),
    ],
)
def test_what_is_no_reading_is_not_taken_for_one(line, code):
    with pytest.raises(BadReply) as refused:
        parse_reading(line)
    why = refused.value.reason
    assert why.values.get("why", why).code == code


@pytest.mark.parametrize(
    ("config", "keys", "message"),
    [
        (DmmConfig, {"quantity": "current"}, r"\.quantity.* voltage, resistance, resistance_4w"),
        (DmmConfig, {"cycles": 0.5}, r"\.cycles.* 0.02, 0.2, 1, 10, 100"),
        (DmmConfig, {"cycles": 1.0}, r"\.rate_Hz.* 40 "),
        (DmmConfig, {"rate_Hz": 500.0}, r"\.rate_Hz.* 200 "),
        (DmmConfig, {"channels": 2}, r"\.channels .*2"),
        (DmmConfig, {"full_scale": 0.0}, r"\.full_scale .*0"),
        (LcrConfig, {"quantity": "inductance"}, r"\.quantity.* capacitance, resistance"),
        (LcrConfig, {"frequency_Hz": 5e6}, r"\.frequency_Hz.*\[20, 2e\+06\]"),
        (LcrConfig, {"level_V": 0.0}, r"\.level_V.*\(0, 20\]"),
    ],
)
def test_what_the_instrument_cannot_do_is_refused_when_the_file_is_read(config, keys, message):
    with pytest.raises(InputError, match=message):
        config("tcp://10.0.0.1:5025", **keys)


@pytest.fixture
def wired(rng):
    """`wired(kind of far end, value)` -> world, far end behind a socket."""
    wires = []

    def make(kind, value, medium=None):
        world, wire = World(), Wire(rng, medium=medium or SocketEnd())
        wires.append(wire)
        far_end = kind(wire, value)
        world.add(far_end)
        return world, far_end

    yield make
    for wire in wires:
        wire.close()


def opened(driver, config, clock):
    return driver.open(config, Opening(clock))


def collect(clock, reader, seconds):
    samples, end_s = [], clock.now_s() + seconds
    reader.start()
    while clock.now_s() < end_s:
        clock.sleep_s(0.005)
        samples += reader.poll()
    return samples


@pytest.mark.parametrize("quantity", ["voltage", "resistance", "resistance_4w"])
def test_every_quantity_of_the_multimeter(wired, quantity):
    world, far_end = wired(SimulatedDmm, lambda now_s: 3.25)
    config = DmmConfig(far_end.wire.port, quantity=quantity, full_scale=10.0)
    reader = opened(DMM, config, world)
    assert reader.unit == ("V" if quantity == "voltage" else "ohm")
    assert reader.range == (-12.0, 12.0)
    assert collect(world, reader, 0.3)[0].values == (3.25,)
    reader.close()


@pytest.mark.parametrize(("quantity", "unit", "per_unit"), [("capacitance", "pF", 1e12), ("resistance", "ohm", 1.0)])
def test_every_quantity_of_the_lcr_meter(wired, quantity, unit, per_unit):
    world, far_end = wired(SimulatedLcr, lambda now_s: 250.0 / per_unit)
    reader = opened(LCR, LcrConfig(far_end.wire.port, quantity=quantity, impedance_ohm=10_000.0), world)
    assert reader.unit == unit
    assert collect(world, reader, 0.3)[0].values[0] == pytest.approx(250.0, rel=1e-5)
    reader.close()


def test_the_instrument_is_set_as_the_file_says(wired):
    world, far_end = wired(SimulatedDmm, lambda now_s: 1.0)
    opened(DMM, DmmConfig(far_end.wire.port, cycles=0.02, full_scale=1000.0), world).close()
    assert (far_end.settings["CONF"], far_end.settings["RES:NPLC"]) == ("1000", "0.02")
    assert far_end.settings["RES:ZERO:AUTO"] == "OFF"
    world, far_end = wired(SimulatedLcr, lambda now_s: 1e-12)
    opened(LCR, LcrConfig(far_end.wire.port, frequency_Hz=1e6, level_V=0.5), world).close()
    assert (far_end.settings["FREQ"], far_end.settings["VOLT"], far_end.settings["FUNC:IMP"]) == ("1e+06", "0.5", "CPD")


def test_fifty_readings_a_second_through_its_integration(wired):
    world, far_end = wired(SimulatedDmm, lambda now_s: 100.0 * now_s)
    reader = opened(DMM, DmmConfig(far_end.wire.port), world)
    samples = collect(world, reader, 4.0)
    assert len(samples) == pytest.approx(200, abs=4)
    # 100 ohm a second: 10 ms off its time would be 1 ohm; a tick of the acquisition is 5 ms.
    late_ms = [10 * (100.0 * s.host_s - s.values[0]) for s in samples]
    assert abs(np.median(late_ms)) < 5
    reader.close()


def test_a_command_the_instrument_does_not_take_is_reported_before_anything_moves(wired):
    world, far_end = wired(SimulatedDmm, lambda now_s: 1.0)
    far_end.refuses = "TRIG:DEL"
    with pytest.raises(CommandRefused, match="-113"):
        opened(DMM, DmmConfig(far_end.wire.port), world)


def test_another_instrument_at_the_address_is_named(wired):
    world, far_end = wired(SimulatedLcr, lambda now_s: 1.0)
    with pytest.raises(NoReply, match="E4980A.*34410A"):
        opened(DMM, DmmConfig(far_end.wire.port), world)
    Link(far_end.wire.port, world).close()


def test_an_overload_ends_the_readings(wired):
    world, far_end = wired(SimulatedLcr, lambda now_s: 1e-12)
    reader = opened(LCR, LcrConfig(far_end.wire.port), world)
    collect(world, reader, 0.2)
    far_end.is_overloaded = True
    with pytest.raises(BadReply) as over:
        collect(world, reader, 0.5)
    assert over.value.reason.values["why"].code == "scpi.overloaded"
    reader.close()


def test_the_same_driver_over_a_serial_line(wired):
    world, far_end = wired(SimulatedDmm, lambda now_s: 42.0, serial_line())
    reader = opened(DMM, DmmConfig(far_end.wire.port), world)
    assert collect(world, reader, 0.3)[0].values == (42.0,)
    reader.close()


@pytest.mark.parametrize(
    ("driver", "kind"),
    [(DMM, SimulatedDmm), pytest.param(LCR, SimulatedLcr, marks=pytest.mark.long)],
    ids=["dmm", "lcr"],
)
def test_the_same_driver_through_pyvisa_in_real_time(wired, driver, kind):
    pytest.importorskip("pyvisa_py")
    world, far_end = wired(kind, lambda now_s: 1e-10 if kind is SimulatedLcr else 100.0)
    port = f"TCPIP0::127.0.0.1::{far_end.wire.port.rpartition(':')[2]}::SOCKET"
    clock = HostClock()
    with world.in_background():
        reader = opened(driver, driver.config(port, rate_Hz=20.0), clock)
        samples = collect(clock, reader, 1.0)
        reader.close()
    assert len(samples) >= 5
    assert {sample.values for sample in samples} == {(100.0,)}


@pytest.mark.parametrize(("setup", "kind"), [(dmm_setup, SimulatedDmm), (lcr_setup, SimulatedLcr)], ids=["dmm", "lcr"])
def test_pyvisa_itself_drives_the_far_end(wired, setup, kind):
    pyvisa = pytest.importorskip("pyvisa")
    pytest.importorskip("pyvisa_py")
    world, far_end = wired(kind, lambda now_s: 2.5e-12)
    port = far_end.wire.port.rpartition(":")[2]
    with world.in_background():
        manager = pyvisa.ResourceManager("@py")
        session = manager.open_resource(f"TCPIP0::127.0.0.1::{port}::SOCKET", read_termination="\n", timeout=3000)
        session.write_termination = "\n"
        assert "Keysight" in session.query("*IDN?")
        for command in setup(DmmConfig("x") if kind is SimulatedDmm else LcrConfig("x")):
            session.write(command)
        assert session.query("SYST:ERR?").startswith("+0")
        session.write("VOLTS 3")
        assert session.query("SYST:ERR?").startswith("-113")
        query = "READ?" if kind is SimulatedDmm else "TRIG:IMM;:FETC?"
        assert float(session.query(query).split(",")[0]) == pytest.approx(2.5e-12)
        session.close()
        manager.close()


@pytest.mark.parametrize(
    ("kind", "unit", "per_V"),
    [pytest.param("scpi_dmm", "ohm", 1000.0, marks=pytest.mark.long), ("scpi_lcr", "pF", 100.0)],
)
def test_a_unit_is_pressed_and_recorded_through_a_bench_instrument(kind, unit, per_V):
    profile = moves("short", [0.0, 2.0, 0.0], [2.0, 2.0, 2.0], [0.5, 0.5, 0.5])
    with open_simulated_bench(seed=3, readout_kind=kind) as (bench, station):
        # An answer that a line holds back for 30 ms is a reading less: what counts here is that all others come.
        station.readout_wire.jitter_s = station.readout_wire.stall_s = 0.0
        recording = record(bench, "A1", profile, with_reference=True)
    assert recording.output_unit == unit
    assert recording.lost == 0
    assert len(recording.t_s) == pytest.approx(50 * profile.duration_s, abs=5)
    with open_simulated_bench(seed=3) as (bench, _):
        plain = record(bench, "A1", profile, with_reference=True)
    # The same unit through another instrument: what differs is the converter's step of 4.9 mV and the unit's drift.
    assert np.ptp(recording.output) / per_V == pytest.approx(np.ptp(plain.output), rel=0.05)
    assert np.corrcoef(recording.output[:, 0], recording.force_N)[0, 1] > 0.95


def test_an_instrument_switched_off_while_pressing_aborts_the_run():
    profile = moves("short", [0.0, 2.0, 0.0], [2.0, 2.0, 2.0], [0.5, 0.5, 0.5])
    with open_simulated_bench(seed=3, readout_kind="scpi_lcr") as (bench, station):
        callbacks = {"pressing": station.readout_wire.unplug}
        with pytest.raises(NoReply) as caught:
            record(bench, "A1", profile, True, lambda progress: callbacks.pop(progress.phase, lambda: None)())
        assert caught.value.reason.values["why"].code == "rig.gone"
        assert not station.axis.is_moving
