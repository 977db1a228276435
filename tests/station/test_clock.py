"""Device time to host time under jitter, bursts, drift and wrap."""

import numpy as np
import pytest

from softcal.station.clock import estimate_rate_Hz, fit_clock, residual_offset_s, unwrap_ms


def arrivals(rng, count=3000, rate=1.0 + 3e-3, offset_s=812.5):
    """Device stamps and arrivals that are late by 0.04 ms ... 100 ms, in order, as on a busy host."""
    device_s = 0.731 + 0.02 * np.arange(count)
    late = rng.exponential(0.004, count) + 0.00004
    stalls = rng.random(count) < 0.01
    late[stalls] += rng.uniform(0.02, 0.1, np.count_nonzero(stalls))
    host_s = np.maximum.accumulate(offset_s + rate * device_s + late)
    return device_s, host_s


@pytest.mark.parametrize("seed", range(5))
def test_offset_and_drift_come_back_within_a_millisecond(seed):
    device_s, host_s = arrivals(np.random.default_rng(seed))
    fit = fit_clock(device_s, host_s)
    truth_s = 812.5 + (1 + 3e-3) * device_s
    assert np.max(np.abs(fit.to_host(device_s) - truth_s)) < 1e-3
    assert fit.rate == pytest.approx(1 + 3e-3, abs=2e-5)


def test_two_devices_meet_within_ten_milliseconds(rng):
    """An event both saw, each by its own clock and its own jitter, is one event on the host's clock."""
    sensor, cell = arrivals(rng, rate=1 - 2e-3), arrivals(rng, rate=1 + 4e-3)
    event_s = 830.0
    for device_s, host_s, rate in ((*sensor, 1 - 2e-3), (*cell, 1 + 4e-3)):
        device_event_s = (event_s - 812.5) / rate
        assert abs(fit_clock(device_s, host_s).to_host(np.array([device_event_s]))[0] - event_s) < 0.01


def test_the_fit_lies_under_every_arrival(rng):
    device_s, host_s = arrivals(rng, 500)
    assert np.all(host_s - fit_clock(device_s, host_s).to_host(device_s) > -1e-9)


@pytest.mark.parametrize("rate_Hz", [10.0, 50.0, 80.0])
def test_the_rate_of_a_clock_of_whole_milliseconds_is_right_even_when_lines_are_lost(rng, rate_Hz):
    device_s = np.floor(1000 * np.arange(200) / rate_Hz) / 1000
    assert estimate_rate_Hz(device_s) == pytest.approx(rate_Hz, rel=1e-3)
    received_s = device_s[rng.random(200) > 0.1]
    assert estimate_rate_Hz(received_s) == pytest.approx(rate_Hz, rel=0.01)


def test_one_pair_is_not_enough():
    with pytest.raises(ValueError):
        fit_clock(np.array([1.0]), np.array([2.0]))


def test_millis_unwraps_forward_and_a_little_backward():
    assert unwrap_ms(2**32 - 10, 10) == 2**32 + 10
    assert unwrap_ms(2**32 + 10, 30) == 2**32 + 30
    assert unwrap_ms(1000, 980) == 980


@pytest.mark.parametrize("offset_s", [-0.06, 0.0, 0.013, 0.1])
def test_residual_offset_is_found_to_ten_milliseconds(rng, offset_s):
    t_s = np.arange(0, 30, 0.02)
    corners_s = np.cumsum(rng.uniform(0.5, 1.5, 40))
    path = rng.uniform(0, 3, 40)
    force = np.interp(t_s, corners_s, path) + rng.normal(0, 0.01, len(t_s))
    output = 2.0 - 0.3 * np.interp(t_s - offset_s, corners_s, path) ** 1.2 + rng.normal(0, 0.002, len(t_s))
    assert residual_offset_s(force, output, 50.0) == pytest.approx(offset_s, abs=0.01)


def test_a_channel_that_never_changes_has_no_offset():
    assert np.isnan(residual_offset_s(np.ones(100), np.arange(100.0) ** 2, 50.0))
