"""Lines `ms,value` from the bytes to the driver's samples: cut, repeated, lost, wrapped, damaged."""

import pytest

from softcal.core.errors import BadReply
from softcal.station.drivers.hx711 import Hx711Cell
from softcal.station.drivers.text_stream import TextStream
from softcal.station.wire.frames.text_stream import StreamLine, format_line, parse
from softcal.station.wire.link import Line


class ScriptedLink:
    """A link that gives prepared lines."""

    def __init__(self, *lines: bytes) -> None:
        self._lines = [Line(text, float(k)) for k, text in enumerate(lines)]

    def discard(self) -> None: ...

    def read_lines(self) -> list[Line]:
        lines, self._lines = self._lines, []
        return lines


def stream(*lines: bytes, channels: int = 1) -> TextStream:
    device = TextStream("readout", ScriptedLink(*lines), channels, 50.0)
    device.start()
    return device


def test_lines_as_arduinos_print_them():
    assert parse(b"1020,511") == StreamLine(1020, (511,))
    assert parse(b"1020,511,12,0") == StreamLine(1020, (511, 12, 0))
    assert parse(b"88,-8388608") == StreamLine(88, (-8388608,))


def test_the_checksum_is_that_of_nmea_0183():
    # "GPGLL,..." is the standard's own example of the exclusive-or; here by hand: 0x31 ^ 0x2C ^ 0x32 = 0x2F.
    assert parse(b"1,2*2F") == StreamLine(1, (2,))
    assert format_line(StreamLine(1, (2,))) == b"1,2*2F\r\n"
    with pytest.raises(BadReply):
        parse(b"1,3*2F")


@pytest.mark.parametrize(
    "line", [b"", b"12", b"12,", b"12,a", b"12,1.5", b" 12,1", b"1_0,5", b"+1,5", b"\xff,1", b"4294967296,1"]
)
def test_noise_is_no_line(line):
    with pytest.raises(BadReply):
        parse(line)


def test_the_first_line_is_dropped_because_it_may_be_cut():
    assert [s.device_s for s in stream(b"0,511", b"1020,511", b"1040,512").poll()] == [1.02, 1.04]


def test_repeated_lines_are_counted_once():
    device = stream(b"", b"20,1", b"20,1", b"40,2")
    assert [s.values for s in device.poll()] == [(1.0,), (2.0,)]


def test_lost_lines_leave_a_step_in_the_device_clock():
    assert [s.device_s for s in stream(b"", b"20,1", b"100,2").poll()] == [0.02, 0.1]


def test_the_clock_goes_on_past_the_wrap_of_millis():
    samples = stream(b"", b"4294967276,1", b"0,2", b"20,3").poll()
    assert [b.device_s - a.device_s for a, b in zip(samples, samples[1:], strict=False)] == pytest.approx([0.02, 0.02])


def test_single_damaged_lines_are_counted_and_many_are_an_error():
    device = stream(b"", b"20,1", b"2x,1", b"60,1")
    assert len(device.poll()) == 2
    assert device.unreadable == 1
    assert stream(b"", *[b"\xff\xfe"] * 9).poll() == []
    with pytest.raises(BadReply):
        stream(b"", *[b"\xff\xfe"] * 10).poll()


def test_a_clock_that_starts_again_is_a_restart():
    with pytest.raises(BadReply):
        stream(b"", b"50000,1", b"12,1").poll()


def test_another_number_of_channels_is_not_taken():
    assert stream(b"", b"20,1,2", b"40,1", channels=2).poll()[0].values == (1.0, 2.0)


def cell(*lines: bytes) -> Hx711Cell:
    device = Hx711Cell(ScriptedLink(b"", *lines), counts_per_N=-1000.0, zero_counts=500.0, capacity_N=20.0)
    device.start()
    return device


def test_counts_become_newtons_with_the_sign_of_the_calibration():
    assert cell(b"12,-1500").poll()[0].values == (2.0,)


@pytest.mark.parametrize("count", [b"8388607", b"-8388608"])
def test_a_saturated_bridge_amplifier_is_no_force(count):
    with pytest.raises(BadReply):
        cell(b"12," + count).poll()
