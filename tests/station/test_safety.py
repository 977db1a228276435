"""The watches of a run on made-up streams: what a line may do to healthy samples, and how a dead channel looks."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softcal.core.errors import BadReply, NoReply
from softcal.station.devices.config import SafetyConfig
from softcal.station.interfaces import Sample
from softcal.station.motion.monitors import (
    FROZEN,
    LAGS_S,
    MISSING_S,
    PRESSED_MM,
    STUCK_MM,
    STUCK_OUTPUT_MM,
    FollowMonitor,
    StreamMonitor,
    StuckMonitor,
)

RATE_HZ = 50.0
STALL_S = 0.1
"""Longest stall that a healthy line is allowed."""


def pressed_until_raised(speed_mm_s: float, slope_V_mm: float, lsb_V: float, seed: int) -> float | None:
    """Press 3 mm deep past a watch, lines held back by stalls; return the depth at which it raised, if it did."""
    rng, monitor = np.random.default_rng(seed), StuckMonitor("sensor readout", 0.0, RATE_HZ, FROZEN * STUCK_MM)
    taken_s = np.arange(0.0, 3.0 / speed_mm_s, 1.0 / RATE_HZ)
    received_s = taken_s + 0.001
    for k in range(len(received_s)):
        if rng.random() < 0.1:
            received_s[k:] = np.maximum(received_s[k:], taken_s[k] + rng.uniform(0.0, STALL_S))
    for at_s, host_s in zip(taken_s, received_s, strict=True):
        level = round((1.0 + slope_V_mm * speed_mm_s * at_s) / lsb_V) * lsb_V
        try:
            monitor.check(level, speed_mm_s * float(host_s))
        except BadReply:
            return speed_mm_s * float(host_s)
    return None


@given(speed_mm_s=st.floats(0.5, 6.0), seed=st.integers(0, 2**31))
def test_samples_that_a_stall_held_back_are_not_taken_for_a_frozen_channel(speed_mm_s: float, seed: int) -> None:
    # The converter's step is the output's change over a fifth of a millimetre: neighbours are often equal.
    assert pressed_until_raised(speed_mm_s, slope_V_mm=0.05, lsb_V=0.01, seed=seed) is None


@given(speed_mm_s=st.floats(0.5, 6.0), seed=st.integers(0, 2**31))
def test_a_channel_that_never_changes_is_frozen(speed_mm_s: float, seed: int) -> None:
    raised_mm = pressed_until_raised(speed_mm_s, slope_V_mm=0.0, lsb_V=0.01, seed=seed)
    assert raised_mm is not None
    # The first line may come late, and the one that tells as well.
    assert raised_mm <= FROZEN * STUCK_MM + speed_mm_s * (2 * STALL_S + 2 / RATE_HZ)


def test_one_late_line_is_no_frozen_channel() -> None:
    monitor = StuckMonitor("sensor readout", 0.0, RATE_HZ, FROZEN * STUCK_MM)
    monitor.check(1.559, 0.50)
    monitor.check(1.559, 1.25)
    with pytest.raises(BadReply):
        for _ in range(10):
            monitor.check(1.559, 1.25)


def show_fast_presses(lag_s: float, speed_mm_s: float, gain_V_mm2: float, seed: int) -> float | None:
    """Press 3.2 mm deep to and fro past a watch of an output that lags; return when it raised, if it did."""
    rng, rate_Hz = np.random.default_rng(seed), 50.0
    monitor = StuckMonitor("sensor readout", 0.004, rate_Hz, STUCK_OUTPUT_MM, LAGS_S)
    t_s = np.arange(0.0, 8.0, 1.0 / rate_Hz)
    stage_mm = np.abs((speed_mm_s * t_s + 3.5) % 7.0 - 3.5) - 0.3
    level_V = 0.0
    for at_s, pressed_mm in zip(t_s, np.maximum(0.0, stage_mm), strict=True):
        level_V += (gain_V_mm2 * pressed_mm**2 - level_V) * -np.expm1(-1.0 / rate_Hz / lag_s)
        try:
            monitor.check(level_V + rng.normal(0.0, 0.004), float(pressed_mm))
        except BadReply:
            return float(at_s)
    return None


@given(st.floats(0.02, 0.4), st.floats(1.0, 8.0), st.floats(0.015, 0.05), st.integers(0, 2**31))
def test_an_output_that_lags_is_not_stuck_where_the_stage_turns(
    lag_s: float, speed_mm_s: float, gain_V_mm2: float, seed: int
) -> None:
    assert show_fast_presses(lag_s, speed_mm_s, gain_V_mm2, seed) is None


@given(st.floats(1.0, 8.0), st.integers(0, 2**31))
def test_an_output_that_stays_at_its_level_is_stuck_in_the_first_press(speed_mm_s: float, seed: int) -> None:
    raised_s = show_fast_presses(0.02, speed_mm_s, 0.0, seed)
    assert raised_s is not None and raised_s <= 7.0 / speed_mm_s


def follow(monitor: FollowMonitor, way: list[tuple[float, float]], began_s: float = 0.0) -> float | None:
    """Show a watch depths in mm and forces in N every 10 ms; return the time at which it raised, if it did."""
    for k, (pressed_mm, force_N) in enumerate(way):
        try:
            monitor.check(force_N, pressed_mm, began_s + 0.01 * k)
        except BadReply:
            return began_s + 0.01 * k
    return None


def ramp(from_mm: float, to_mm: float, force_N: float) -> list[tuple[float, float]]:
    steps = round(abs(to_mm - from_mm) / 0.02)
    return [(from_mm + (to_mm - from_mm) * k / steps, force_N) for k in range(steps + 1)]


def test_a_unit_that_relaxed_and_is_let_up_half_way_may_show_no_force_for_a_while():
    """It comes back slowly; pressed again as deep as it had been felt it must show one."""
    way = [*ramp(0.0, 2.5, 3.0), *ramp(2.5, 1.3, 0.0), *[(1.3, 0.0)] * 300]
    monitor = FollowMonitor(0.05)
    assert follow(monitor, way) is None
    again = follow(monitor, ramp(1.3, 2.5, 0.0), 10.0)
    assert again is not None and again - 10.0 <= 0.01 * PRESSED_MM / 0.02 + MISSING_S + 0.02


@pytest.mark.parametrize("at_mm", [0.9, 1.5, 2.5])
def test_a_cell_that_dies_while_the_stage_goes_down_or_holds_is_seen_at_once(at_mm):
    for after in (ramp(at_mm, 3.0, 0.0), [(at_mm, 0.0)] * 100):
        monitor = FollowMonitor(0.05)
        assert follow(monitor, ramp(0.0, at_mm, 2.0)) is None
        received_s = follow(monitor, after, 5.0)
        assert received_s is not None and received_s - 5.0 <= MISSING_S + 0.03


@pytest.mark.parametrize("ahead_s", [-5000.0, -0.5, 0.0, 0.5, 5000.0])
def test_readings_are_as_old_as_the_line_holds_them_back_wherever_the_device_began_to_count(ahead_s: float) -> None:
    def time_raised(line_s: float) -> float | None:
        """Host time of the reading at which the watch raises, the line holding them back from the third second on."""
        monitor = StreamMonitor(SimpleNamespace(name="readout", rate_Hz=RATE_HZ), SafetyConfig(), 0.0)  # type: ignore[arg-type]
        for taken_s in np.arange(0.0, 6.0, 1.0 / RATE_HZ):
            host_s = float(taken_s) + (line_s if taken_s >= 3.0 else 0.0)
            try:
                monitor.check(Sample(host_s, float(taken_s) + ahead_s, (1.0,)))
            except NoReply:
                return host_s
        return None

    assert time_raised(0.2) is None
    raised_s = time_raised(0.5)
    assert raised_s is not None and 3.5 < raised_s < 4.0
