"""The project's own readout sketch, compiled for an ATmega328P, run in simavr, read by our driver."""

import time

import pytest

from softcal.station.clock import HostClock
from softcal.station.drivers.arduino import ArduinoReadout
from softcal.station.tasks.identify import identify
from softcal.station.wire.link import Link
from tests.station.avr_board import MISSING, can_run, running_board

CHANNELS = 2
LONGEST_S = 120.0


@pytest.fixture(scope="module")
def port(tmp_path_factory, require, require_program):
    """The pty of a running board with 1000 mV at A0 and 2500 mV at A1."""
    require_program("gcc")
    require(can_run(), MISSING)
    with running_board(
        tmp_path_factory.mktemp("avr"), "readout/readout.ino", f"CHANNELS={CHANNELS}", "1000", "2500"
    ) as port:
        yield port


def read(port, count):
    """Read so many samples: simavr may run slower than real time on a busy machine."""
    reader = ArduinoReadout(Link(port, HostClock()), channels=CHANNELS)
    reader.start()
    samples, end_s = [], time.monotonic() + LONGEST_S
    while len(samples) < count:
        assert time.monotonic() < end_s, f"{len(samples)} of {count} samples came within {LONGEST_S} s"
        time.sleep(0.01)
        samples += reader.poll()
    unreadable = reader.unreadable
    reader.close()
    return samples, unreadable


def test_the_sketch_is_read_by_the_driver(port):
    samples, unreadable = read(port, 50)
    assert unreadable == 0
    steps_ms = {round(1000 * (b.device_s - a.device_s)) for a, b in zip(samples, samples[1:], strict=False)}
    assert steps_ms == {20}
    # 10 bits at 5 V: 1000 mV reads 204, 2500 mV reads 511.
    assert samples[-1].values == pytest.approx((204 * 5 / 1023, 511 * 5 / 1023))


def test_the_sketch_is_identified(port):
    device = identify(port, HostClock())
    assert (device.role, device.kind, device.channels) == ("readout", "arduino", CHANNELS)
    assert device.rate_Hz == pytest.approx(50.0)
