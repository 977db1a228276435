"""One link over serial ports, sockets and VISA resources: real ones of this machine, and what happens when they go."""

import socket
import threading
import time

import numpy as np
import pytest

from softcal.core.errors import NoReply
from softcal.core.profiles import moves
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.clock import HostClock
from softcal.station.simulated.wire import SocketEnd, Wire
from softcal.station.simulated.world import World
from softcal.station.tasks.acquisition import record
from softcal.station.wire.link import Link, link_for_driver
from softcal.station.wire.transport import VisaTransport, wire_of

USB_DEVICE = """
spec: "1.0"
devices:
  meter:
    eom:
      USB INSTR:
        q: "\\n"
        r: "\\n"
    error: ERROR
    dialogues:
      - q: "*IDN?"
        r: "softcal,meter,1,0"
      - q: "CONF:RES"
resources:
  USB0::0x2A8D::0x1301::MY1::INSTR:
    device: meter
"""


class Echo:
    """Answers every line with itself."""

    def __init__(self, wire):
        self.wire, self._received = wire, b""

    def receive(self, now_s):
        *lines, self._received = (self._received + self.wire.receive()).split(b"\n")
        for line in lines:
            self.wire.send(line + b"\n", now_s)

    def next_event_s(self):
        return self.wire.next_arrival_s

    def advance(self, now_s):
        self.wire.deliver(now_s)


@pytest.fixture
def echo(rng):
    world, wire = World(), Wire(rng, medium=SocketEnd())
    far_end = Echo(wire)
    world.add(far_end)
    yield world, wire
    wire.close()


@pytest.mark.parametrize(
    ("port", "kind"),
    [
        ("/dev/ttyACM0", "serial"),
        ("COM5", "serial"),
        ("tcp://192.168.0.7:5025", "tcp"),
        ("TCPIP0::192.168.0.7::5025::SOCKET", "visa"),
        ("USB0::0x2A8D::0x1301::MY53200001::INSTR", "visa"),
        ("GPIB::17::INSTR", "visa"),
        ("ASRL/dev/ttyUSB0::INSTR", "serial"),
    ],
)
def test_a_port_says_what_wire_it_is(port, kind):
    # pyvisa writes ASRL1::INSTR; a path behind ASRL is a serial port written the wrong way and is told so when opened.
    assert wire_of(port) == kind


def test_lines_cross_a_socket_as_they_cross_a_serial_port(echo):
    world, wire = echo
    link = Link(wire.port, world, name="readout")
    link.write(b"one\r\ntw")
    assert link.next_line(0.5).text == b"one"
    link.write(b"o\n")
    assert link.next_line(0.5).text == b"two"
    with pytest.raises(NoReply, match=r"readout \(tcp://.* 0\.1 s"):
        link.next_line(0.1)
    link.close()
    link.close()


def test_everything_that_has_arrived_on_a_socket_is_read_at_once(echo):
    world, wire = echo
    link = Link(wire.port, world)
    link.write(b"".join(b"%06d\n" % k for k in range(2000)))
    lines = []
    while len(lines) < 2000:
        world.sleep_s(0.005)
        lines += link.read_lines()
    assert [int(line.text) for line in lines] == list(range(2000))
    link.close()


def test_a_device_that_closes_its_socket_is_gone(echo):
    world, wire = echo
    link = Link(wire.port, world, name="readout")
    link.write(b"x\n")
    link.next_line(0.5)
    wire.unplug()
    with pytest.raises(NoReply) as caught:
        link.next_line(1.0)
    assert caught.value.reason.code == "rig.gone"


def test_what_was_sent_before_the_end_is_still_read():
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = Link(f"tcp://127.0.0.1:{server.getsockname()[1]}", HostClock())
        device, _ = server.accept()
        device.sendall(b"last words\n")
        device.close()
        assert link.next_line(2.0).text == b"last words"
        with pytest.raises(NoReply):
            link.next_line(2.0)


def test_an_address_where_nothing_listens_is_named():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(NoReply, match=rf"stage \(tcp://127.0.0.1:{port}\)"):
        Link(f"tcp://127.0.0.1:{port}", HostClock(), name="stage")


@pytest.mark.parametrize("port", ["tcp://localhost", "tcp://localhost:0", "tcp://localhost:70000", "tcp://:5025"])
def test_a_badly_written_address_is_refused_with_an_example(port):
    with pytest.raises(NoReply, match=r"tcp://192\.168\.0\.7:5025"):
        Link(port, HostClock())


def test_a_driver_that_refuses_its_device_gives_the_port_back(rng):
    wire = Wire(rng)
    with pytest.raises(KeyboardInterrupt), link_for_driver(wire.port, World(), 9600, "stage"):
        raise KeyboardInterrupt
    Link(wire.port, World()).close()
    wire.close()


def test_questions_and_answers_over_a_visa_socket(echo, require):
    pytest.importorskip("pyvisa_py")
    world, wire = echo
    port = wire.port.rpartition(":")[2]
    with world.in_background():
        link = Link(f"TCPIP0::127.0.0.1::{port}::SOCKET", HostClock())
        for k in range(20):
            link.write(b"READ? %d\n" % k)
            assert link.next_line(3.0).text == b"READ? %d" % k
        link.close()
        link.close()


@pytest.mark.long
def test_a_visa_device_that_goes_away_is_gone(rng):
    pytest.importorskip("pyvisa_py")
    world, wire = World(), Wire(rng, medium=SocketEnd())
    world.add(Echo(wire))
    with world.in_background():
        link = Link(f"TCPIP0::127.0.0.1::{wire.port.rpartition(':')[2]}::SOCKET", HostClock(), name="readout")
        link.write(b"?\n")
        assert link.next_line(3.0).text == b"?"
        wire.unplug()
        with pytest.raises(NoReply, match="readout"):
            for _ in range(50):
                link.write(b"?\n")
                link.next_line(0.5)
        link.close()


def test_a_late_answer_is_not_taken_for_the_next(tmp_path, monkeypatch):
    class Session:
        """Leaves the first question open for too long."""

        def __init__(self):
            self.cleared, self.asked = 0, []

        def write_raw(self, content):
            self.asked.append(content)

        def read_raw(self):
            import pyvisa

            if len(self.asked) == 1:
                raise pyvisa.errors.VisaIOError(pyvisa.constants.StatusCode.error_timeout)
            return b"second\n"

        def clear(self):
            self.cleared += 1

        def close(self):
            pass

    pyvisa = pytest.importorskip("pyvisa")
    session = Session()
    monkeypatch.setattr(pyvisa.ResourceManager, "open_resource", lambda *args, **kwargs: session)
    wire = VisaTransport("USB0::1::2::3::INSTR")
    wire.write(b"first?")
    wire.write(b"second?")
    content = b""
    while not content:
        time.sleep(0.001)
        content = wire.read()
    assert content == b"second\n"
    assert session.cleared == 1
    wire.close()


def test_a_session_that_is_given_up_while_a_question_is_open_ends_quietly(monkeypatch):
    pyvisa = pytest.importorskip("pyvisa")
    has_answered = threading.Event()

    class Session:
        """Keeps the thread that asks for longer than `close` waits for it."""

        def write_raw(self, content):
            pass

        def read_raw(self):
            has_answered.wait(10)
            raise pyvisa.errors.VisaIOError(pyvisa.constants.StatusCode.error_timeout)

        def clear(self):
            raise pyvisa.errors.InvalidSession

        def close(self):
            pass

    monkeypatch.setattr(pyvisa.ResourceManager, "open_resource", lambda *args, **kwargs: Session())
    monkeypatch.setattr("softcal.station.wire.transport.VISA_ANSWER_S", 0.05)
    failed = []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    wire = VisaTransport("USB0::1::2::3::INSTR")
    wire.write(b"?")
    wire.close()
    has_answered.set()
    [asking] = [thread for thread in threading.enumerate() if thread.name.startswith("VISA USB0")] or [None]
    if asking is not None:
        asking.join(10)
    assert failed == []


def test_a_usb_instrument_through_pyvisa(tmp_path, monkeypatch):
    pytest.importorskip("pyvisa_sim")
    (tmp_path / "meter.yaml").write_text(USB_DEVICE)
    monkeypatch.setenv("PYVISA_LIBRARY", f"{tmp_path / 'meter.yaml'}@sim")
    link = Link("USB0::0x2A8D::0x1301::MY1::INSTR", HostClock(), name="readout")
    link.write(b"CONF:RES\n")
    link.write(b"*IDN?\n")
    assert link.next_line(3.0).text == b"softcal,meter,1,0"
    link.close()


def test_a_visa_resource_that_is_not_there_is_seen_at_the_first_question():
    pytest.importorskip("pyvisa_py")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    # PyVISA-py opens such a socket without a word; other libraries refuse it.
    with pytest.raises(NoReply, match=r"readout \(TCPIP0::"):
        link = Link(f"TCPIP0::127.0.0.1::{port}::SOCKET", HostClock(), name="readout")
        link.write(b"?\n")
        link.next_line(0.5)


def test_a_visa_resource_that_cannot_be_opened_is_named():
    pytest.importorskip("pyvisa_py")
    with pytest.raises(NoReply, match=r"readout \(USB0::0x0000::0x0000::NOBODY::INSTR\)"):
        Link("USB0::0x0000::0x0000::NOBODY::INSTR", HostClock(), name="readout")


def test_without_pyvisa_the_message_names_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyvisa", None)
    with pytest.raises(NoReply, match=r"pip install 'softcal\[visa\]'"):
        Link("USB0::1::2::3::INSTR", HostClock())


def test_draws_of_the_wire_do_not_depend_on_its_medium():
    wires = [Wire(np.random.default_rng(3)), Wire(np.random.default_rng(3), medium=SocketEnd())]
    for wire in wires:
        for k in range(50):
            wire.send(b"line\n", 0.01 * k)
    assert wires[0].next_arrival_s == wires[1].next_arrival_s
    for wire in wires:
        wire.close()


def test_a_run_over_sockets_is_the_run_over_serial_lines(monkeypatch):
    # What a machine without pseudo terminals does: the same bytes at the same simulated times.
    profile = moves("short", [0.0, 1.5, 0.0], [2.0, 2.0, 2.0], [0.2, 0.2, 0.2])
    recordings = []
    for _ in range(2):
        with open_simulated_bench(seed=5) as (bench, station):
            ports = [wire.port for wire in (station.stage_wire, station.force_wire, station.readout_wire)]
            recordings.append(record(bench, "A1", profile, with_reference=True))
        monkeypatch.setattr("softcal.station.simulated.wire.serial_line", SocketEnd)
    assert all(port.startswith("tcp://") for port in ports)
    for name in ("t_s", "output", "stage_mm", "force_N"):
        np.testing.assert_array_equal(getattr(recordings[0], name), getattr(recordings[1], name))
