"""The load cell's sketch with an HX711 and an ADS1232, in simavr with a model of either chip, read by our driver."""

import time

import pytest

from softcal.station.clock import HostClock
from softcal.station.drivers.hx711 import RAILS, Hx711Cell
from softcal.station.tasks.identify import identify
from softcal.station.wire.link import Link
from tests.station.avr_board import MISSING, can_run, running_board

COUNTS = (RAILS[0] + 1, -1, 0, 1, 4321, 0x555555, RAILS[1] - 1)
"""All bits both ways; one conversion each, in turn."""

LONGEST_S = 120.0


@pytest.fixture(scope="module", params=["hx711", "ads1232"])
def port(request, tmp_path_factory, require, require_program):
    require_program("gcc")
    require(can_run(), MISSING)
    define, counts = f"IS_ADS1232={int(request.param == 'ads1232')}", map(str, COUNTS)
    folder = tmp_path_factory.mktemp("avr")
    with running_board(folder, "cell/cell.ino", define, request.param, *counts) as port:
        yield port


def test_every_conversion_comes_once_in_order_with_its_sign(port):
    cell = Hx711Cell(Link(port, HostClock()), 1.0, 0.0, 1e9)
    cell.start()
    samples, end_s = [], time.monotonic() + LONGEST_S
    while len(samples) < 4 * len(COUNTS):
        assert time.monotonic() < end_s, f"{len(samples)} samples came within {LONGEST_S} s"
        time.sleep(0.01)
        samples += cell.poll()
    assert cell.unreadable == 0
    cell.close()
    first = COUNTS.index(samples[0].values[0])
    assert [one.values[0] for one in samples] == [COUNTS[(first + k) % len(COUNTS)] for k in range(len(samples))]
    # 80 a second, stamped in whole milliseconds of a timer that leaves one out now and then.
    steps_ms = [1000 * (b.device_s - a.device_s) for a, b in zip(samples, samples[1:], strict=False)]
    assert max(abs(step - 12.5) for step in steps_ms) < 2.6
    assert sum(steps_ms) / len(steps_ms) == pytest.approx(12.5, rel=0.02)


def test_the_sketch_is_identified(port):
    device = identify(port, HostClock())
    assert (device.role, device.kind) == ("force", "hx711")
    assert device.rate_Hz == pytest.approx(80.0, rel=0.02)
