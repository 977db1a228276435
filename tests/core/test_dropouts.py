"""Dropouts of an output: planted ones are found where they are, motion and noise never are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softcal.core.inspection import dropouts
from softcal.core.inspection.config import DropoutConfig

RATE_HZ = 50.0
T_S = np.arange(0.0, 40.0, 1 / RATE_HZ)


def find_dropouts(output, stage_mm=None):
    return dropouts.find_dropouts(output, stage_mm, DropoutConfig())


def pressed_mm(speed_mm_s, acceleration_mm_s2, depth_mm=3.0, rest_s=1.0):
    """Presses with constant acceleration: down, rest, up, rest."""
    way_s = depth_mm / speed_mm_s + speed_mm_s / acceleration_mm_s2
    phase_s = T_S % (2 * (way_s + rest_s)) - rest_s

    def moved_mm(t_s):
        t_s, up_s = np.clip(t_s, 0.0, way_s), speed_mm_s / acceleration_mm_s2
        end_s = way_s - up_s
        slow = 0.5 * acceleration_mm_s2 * np.minimum(t_s, up_s) ** 2
        return (
            slow
            + speed_mm_s * np.clip(t_s - up_s, 0.0, end_s - up_s)
            + np.where(t_s > end_s, speed_mm_s * (t_s - end_s) - 0.5 * acceleration_mm_s2 * (t_s - end_s) ** 2, 0.0)
        )

    return moved_mm(phase_s) - moved_mm(phase_s - way_s - rest_s)


units = st.tuples(
    st.floats(1.0, 10.0),  # speed, mm/s
    st.sampled_from([100.0, 200.0, 1000.0, 5000.0]),  # mm/s²
    st.floats(0.0, 2.0),  # output at rest, V
    st.floats(0.2, 3.0),  # its range, V
    st.floats(1.0, 2.5),  # its law
    st.sampled_from([0.0, 0.0005, 0.004]),  # noise, V
    st.sampled_from([0, 10, 16, 24]),  # bits of the converter at 5 V
    st.integers(0, 10_000),
)


def simulate_unit(unit):
    speed_mm_s, acceleration_mm_s2, rest_V, range_V, power, noise_V, bits, seed = unit
    rng, stage_mm = np.random.default_rng(seed), pressed_mm(speed_mm_s, acceleration_mm_s2)
    depth = np.maximum(0.0, stage_mm - 0.5) / 2.5
    # A stiff onset: half of the range comes in the first fifth of a millimetre.
    shape = 0.5 * np.minimum(depth / 0.08, 1.0) + 0.5 * depth**power if seed % 2 else depth**power
    output_V = rest_V + range_V * shape + rng.normal(0.0, noise_V, len(T_S))
    step_V = 5.0 / (2**bits - 1) if bits else 0.0
    return (np.round(output_V / step_V) * step_V if bits else output_V), stage_mm, rng


@given(units)
def test_no_press_however_fast_or_stiff_is_a_dropout(unit):
    output_V, stage_mm, _ = simulate_unit(unit)
    assert find_dropouts(output_V, stage_mm) == []


@given(units, st.integers(1, 3), st.sampled_from(["0 V", "halved", "rail"]))
def test_one_to_three_lost_samples_are_found_where_they_are(unit, count, kind):
    output_V, stage_mm, rng = simulate_unit((*unit[:2], max(unit[2], 1.0), unit[3], *unit[4:]))
    # In a hold or at rest: while it is pressed fast, half of the output may lie within what a press does in a sample.
    still = np.flatnonzero(np.abs(np.gradient(stage_mm)) < 1e-9)
    still = still[(still > 10) & (still < len(T_S) - 20)]
    begin = int(rng.choice([k for k in still if np.ptp(stage_mm[k - 9 : k + 12]) < 1e-9]))
    lost = slice(begin, begin + count)
    broken_V = output_V.copy()
    broken_V[lost] = {"0 V": 0.0, "halved": 0.5 * output_V[lost], "rail": 5.0}[kind]
    if kind == "rail" and output_V[begin] > 4.0:
        return
    (dropout,) = find_dropouts(broken_V, stage_mm)
    assert (dropout.begin, dropout.end) == (begin, begin + count)
    assert dropout.level in broken_V[lost]
    assert dropout.expected == pytest.approx(output_V[begin], abs=0.05)


@pytest.mark.parametrize("rate_Hz", [25.0, 50.0, 500.0, 1000.0])
def test_a_converter_that_averages_shows_the_edges_in_between(rate_Hz):
    rng, t_s = np.random.default_rng(3), np.arange(0.0, 8.0, 1 / rate_Hz)
    fine_s = np.arange(0.0, 8.0, 1e-4)
    per_sample = round(1e4 / rate_Hz)
    for at_s in rng.uniform(1.0, 7.0, 50):
        is_lost = (fine_s > at_s) & (fine_s < at_s + 0.06)
        share = is_lost.reshape(len(t_s), per_sample).mean(axis=1)
        output_V = (2.0 + 0.3 * np.sin(t_s)) * (1.0 - share) + rng.normal(0.0, 0.002, len(t_s))
        (dropout,) = find_dropouts(output_V, np.sin(t_s))
        assert dropout.begin - 1 <= int(at_s * rate_Hz) <= dropout.begin
        assert abs(dropout.end - (at_s + 0.06) * rate_Hz) <= 1.0


def test_several_dropouts_are_all_found():
    output_V = np.full(len(T_S), 1.5) + np.random.default_rng(1).normal(0.0, 0.003, len(T_S))
    for begin in (100, 120, 500, 1500):
        output_V[begin : begin + 2] = 0.0
    assert [dropout.begin for dropout in find_dropouts(output_V)] == [100, 120, 500, 1500]


@given(st.floats(0.1, 100.0), st.floats(-5.0, 5.0), units)
def test_neither_unit_nor_zero_of_the_output_matters(gain, zero, unit):
    output_V, stage_mm, _ = simulate_unit((*unit[:6], 0, unit[7]))
    output_V[1000:1002] += 10.0
    plain = find_dropouts(output_V, stage_mm)
    assert [(d.begin, d.end) for d in plain] == [(1000, 1002)]
    assert [(d.begin, d.end) for d in find_dropouts(zero + gain * output_V, stage_mm)] == [(1000, 1002)]


def test_without_the_stage_only_a_jump_over_the_whole_range_is_a_dropout():
    stage_mm = pressed_mm(5.0, 1000.0)
    output_V = 1.0 + stage_mm + np.random.default_rng(4).normal(0.0, 0.002, len(T_S))
    still = np.flatnonzero((stage_mm > 2.99) & (np.roll(stage_mm, 20) > 2.99))
    for level, is_found in ((2.5, False), (0.0, True)):
        broken_V = output_V.copy()
        broken_V[still[0] - 5 : still[0] + 5] = level
        assert len(find_dropouts(broken_V, stage_mm)) == 1
        assert len(find_dropouts(broken_V)) == is_found


def test_a_step_that_stays_a_constant_and_few_samples_are_no_dropouts():
    step = np.where(T_S > 20.0, 1.0, 2.0)
    assert find_dropouts(step) == []
    assert find_dropouts(np.ones(len(T_S))) == []
    assert find_dropouts(np.array([1.0, 1.0, 0.0, 1.0, 1.0])) == []


def test_a_short_press_is_one_only_without_its_stage():
    stage_mm = np.zeros(len(T_S))
    for begin in (500, 900, 1300):
        stage_mm[begin : begin + 3] = [1.0, 1.2, 1.0]
    output_V = 1.0 + stage_mm + np.random.default_rng(2).normal(0.0, 0.002, len(T_S))
    assert find_dropouts(output_V, stage_mm) == []
    assert len(find_dropouts(output_V)) == 3
