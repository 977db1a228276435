"""A blocking library behind a thread: readings in time, and stale data said, whatever the library does."""

import threading
import time

import pytest

from softcal.core.errors import BadReply, NoReply
from softcal.station.clock import HostClock
from softcal.station.wire.threaded_reader import Reading, ThreadedReader


class Library:
    """A library whose `read` waits until the test lets a reading through."""

    def __init__(self):
        self.readings, self.has_one = [], threading.Condition()
        self.closed = 0

    def give(self, item):
        with self.has_one:
            self.readings.append(item)
            self.has_one.notify()

    def read(self):
        with self.has_one:
            self.has_one.wait_for(lambda: self.readings or self.closed)
            if not self.readings:
                raise OSError("closed")
            item = self.readings.pop(0)
        if isinstance(item, Exception):
            raise item
        return item

    def close(self):
        with self.has_one:
            self.closed += 1
            self.has_one.notify()


class HandClock:
    """Host time that the test sets."""

    def __init__(self):
        self.time_s = 100.0

    def now_s(self):
        return self.time_s

    def sleep_s(self, seconds):
        self.time_s += seconds

    def wait(self, event, seconds):
        event.wait(seconds)


@pytest.fixture
def library():
    return Library()


@pytest.fixture
def clock():
    return HandClock()


@pytest.fixture
def reader(library, clock):
    reader = ThreadedReader("meter", "V", 1000.0, clock, library.read, library.close)
    yield reader
    library.give(OSError("closed"))
    reader.close()


def until(condition, within_s=120.0):
    end_s = time.monotonic() + within_s
    while not (result := condition()):
        assert time.monotonic() < end_s, "did not come"
        time.sleep(0.001)
    return result


def fault(reader):
    """The error that poll comes to raise."""
    try:
        reader.poll()
    except (NoReply, BadReply) as error:
        return error
    return None


def test_a_reading_is_from_the_middle_of_its_call(reader, library, clock):
    clock.time_s = 100.2
    library.give(Reading((1.5,)))
    (sample,) = until(reader.poll)
    assert (sample.host_s, sample.device_s, sample.values) == (pytest.approx(100.1), None, (1.5,))


def test_poll_returns_at_once_while_the_library_waits(reader):
    # A poll that waited for the library would never come back.
    assert reader.poll() == []


def test_a_call_that_does_not_return_is_stale_data(reader, library, clock):
    library.give(Reading((1.0,)))
    until(reader.poll)
    clock.time_s += 0.4
    assert reader.poll() == []
    clock.time_s += 0.2
    with pytest.raises(NoReply, match=r"meter.* 0\.60 s"):
        reader.poll()


def test_the_same_reading_again_is_no_new_one(reader, library, clock):
    for device_s in (7.0, 7.0, 7.0, 7.02):
        library.give(Reading((1.0,), device_s))
    samples = []
    until(lambda: samples.extend(reader.poll()) or not library.readings)
    until(lambda: samples.extend(reader.poll()) or len(samples) >= 2)
    assert [sample.device_s for sample in samples] == [7.0, 7.02]


def test_a_library_that_repeats_its_last_reading_for_ever_is_stale(reader, library, clock):
    library.give(Reading((1.0,), 7.0))
    until(reader.poll)
    for _ in range(20):
        clock.time_s += 0.1
        library.give(Reading((1.0,), 7.0))
    until(lambda: not library.readings)
    assert isinstance(until(lambda: fault(reader)), NoReply)


def test_the_librarys_own_error_is_reported_in_one_sentence(reader, library):
    library.give(RuntimeError("LJME_RECONNECT_FAILED"))
    error = until(lambda: fault(reader))
    assert "meter" in str(error) and "RuntimeError: LJME_RECONNECT_FAILED" in str(error) and "\n" not in str(error)


def test_an_error_of_the_driver_comes_through_as_it_is(reader, library):
    library.give(BadReply("meter: overload"))
    assert str(until(lambda: fault(reader))) == "meter: overload"


def test_readings_before_the_error_are_not_lost(reader, library):
    for item in (Reading((1.0,)), Reading((2.0,)), RuntimeError("gone")):
        library.give(item)
    until(lambda: not reader._thread.is_alive())
    assert [sample.values for sample in reader.poll()] == [(1.0,), (2.0,)]
    assert fault(reader) is not None


def test_what_was_asked_before_the_start_does_not_count(reader, library, clock):
    clock.time_s = 101.0
    reader.start()  # A call has been open since 100.0.
    library.give(Reading((1.0,)))
    library.give(Reading((2.0,)))
    samples = []
    until(lambda: samples.extend(reader.poll()) or samples)
    assert [sample.values for sample in samples] == [(2.0,)]


def test_close_ends_the_thread_and_the_library_once(library, clock):
    reader = ThreadedReader("meter", "V", 1000.0, clock, library.read, library.close, stale_s=0.05)
    thread = reader._thread
    reader.close()
    reader.close()
    assert library.closed == 1
    until(lambda: not thread.is_alive())


def test_a_library_that_cannot_close_a_device_that_is_gone_does_not_end_the_program(library, clock):
    def close():
        library.close()
        raise OSError("Transport endpoint is not connected")

    reader = ThreadedReader("meter", "V", 1000.0, clock, library.read, close, stale_s=0.05)
    reader.close()
    assert library.closed == 1


def test_a_call_that_hangs_for_ever_does_not_hang_close(clock):
    hangs = threading.Event()
    reader = ThreadedReader("meter", "V", 10.0, clock, lambda: hangs.wait() and Reading(()), lambda: None, stale_s=0.05)
    reader.close()
    hangs.set()
    until(lambda: not reader._thread.is_alive())


def test_the_rate_is_kept_on_average_when_calls_take_time():
    reader = ThreadedReader("meter", "V", 50.0, HostClock(), lambda: time.sleep(0.008) or Reading((1.0,)), lambda: None)
    try:
        samples = until(lambda: len(reader._samples) >= 100 and reader.poll())
    finally:
        reader.close()
    span_s = samples[-1].host_s - samples[0].host_s
    # A machine that is busy may be late, and never early.
    assert (len(samples) - 1) / span_s < 50.5
    assert all(later.host_s > sooner.host_s for sooner, later in zip(samples, samples[1:], strict=False))
