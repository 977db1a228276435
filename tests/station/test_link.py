"""A serial line as the host reads it: whole lines, everything that has arrived, and one owner."""

import numpy as np
import pytest

from softcal.core.errors import NoReply
from softcal.station.clock import HostClock
from softcal.station.simulated.wire import Wire
from softcal.station.wire.link import Link


@pytest.fixture
def wire():
    wire = Wire(np.random.default_rng(1))
    yield wire
    wire.close()


def test_everything_that_has_arrived_is_read_at_once(wire):
    # A tty hands over 4095 bytes a read at most, and less when its line discipline is behind.
    link = Link(wire.port, HostClock())
    for k in range(2000):
        wire._medium.write(b"%06d\r\n" % k)
    assert [int(line.text) for line in link.read_lines()] == list(range(2000))
    link.close()


def test_a_port_that_is_not_there_is_named():
    with pytest.raises(NoReply, match=r"/dev/no-such-port"):
        Link("/dev/no-such-port", HostClock(), name="stage")
