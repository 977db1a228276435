"""A load cell behind a low pass: delay and bandwidth are two things, labels that a filter spoils are refused."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from softcal.core.errors import BadReply
from softcal.core.profiles import moves, ramps, source_profile
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import EffectSetting, Twin, simulate
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.motion.monitored_bench import MonitoredBench
from softcal.station.record.method import METHOD
from softcal.station.record.response import columns_at, fit_response
from softcal.station.tasks.acquisition import record
from softcal.station.testing.faults import filter_cell, limit_speed
from tests.layers import layered

FAST = ramps([2.0, 3.0, 3.0], 4.0, rest_s=0.5)
RELAXING = Twin(BaseParameters(), (EffectSetting("stress_relaxation", {"g": 0.3, "tau": 0.12}),))


def press_with_lag(constant_s, late_s=0.0, latency_s=0.0, unit=None, profile=FAST, with_reference=True):
    """Press a unit whose load cell is behind a low pass, and late; return the recording and its true force."""
    twin = unit or Twin()
    with open_simulated_bench(twin, seed=3) as (bench, station):
        if constant_s:
            filter_cell(station, constant_s)
        station.force_wire.delay_s += late_s
        config = replace(bench.config, force=replace(bench.config.force, latency_s=latency_s))
        recording = record(replace(bench, config=config), "A0", profile, with_reference)
        surface_mm = recording.contact_mm - bench.config.fixture.clearance_mm - station.rig.clearance_mm
    true_N, _ = simulate(twin, recording.t_s, recording.stage_mm + surface_mm)
    return recording, true_N


def refused(*arguments, **options):
    with pytest.raises(BadReply) as bad:
        press_with_lag(*arguments, **options)
    return bad.value.reason.values["why"]


@pytest.mark.parametrize("latency_s", [0.0, UNKNOWN_S])
@pytest.mark.parametrize("constant_s", layered((0.1, 0.12, 0.06, 0.2, 0.3), (0.1, 0.12)))
@pytest.mark.parametrize("unit", [None, RELAXING])
def test_a_cell_behind_a_low_pass_gives_no_labels(constant_s, latency_s, unit):
    why = refused(constant_s, latency_s=latency_s, unit=unit)
    assert why.code == "rig.low_pass" or (why.code == "rig.behind" and latency_s == 0.0)
    if why.code == "rig.low_pass":
        assert why.values["constant_s"] == pytest.approx(constant_s, rel=0.35)


@pytest.mark.parametrize("late_s", layered((0.06, 0.2), (0.06,)))
@pytest.mark.parametrize("constant_s", layered((0.1, 0.3), (0.1,)))
def test_a_delay_hides_no_low_pass(late_s, constant_s):
    for latency_s in (late_s, late_s + constant_s, UNKNOWN_S):
        why = refused(constant_s, late_s, latency_s)
        assert why.code == "rig.low_pass" or (why.code == "rig.behind" and latency_s == late_s)


@pytest.mark.parametrize("constant_s", [0.1, 0.3])
def test_a_filtered_cell_is_never_taken_for_a_prompter_one(constant_s, monkeypatch):
    """What a stop in the fast presses holds rests on it; a slow press that does not tell leaves the latest there is."""
    learned_s = []
    monkeypatch.setattr(MonitoredBench, "learn_latency", lambda monitored, late_s: learned_s.append(late_s))
    refused(constant_s, 0.06, UNKNOWN_S)
    assert all(late_s > 0.06 + constant_s - 0.02 for late_s in learned_s)


@pytest.mark.parametrize("seconds", layered((40.0, 170.0), (40.0,)))
def test_the_profile_of_a_source_shows_the_low_pass(seconds):
    profile = source_profile(np.random.default_rng(0), seconds, 3.0)
    why = refused(0.1, 0.06, UNKNOWN_S, profile=profile)
    assert why.code == "rig.low_pass"
    assert why.values["constant_s"] == pytest.approx(0.1, rel=0.25)


def test_a_slight_low_pass_is_reported_with_its_time_constant_and_what_it_leaves():
    slow = moves("slow", [0.0, 3.0, 0.0, 3.0, 0.0], [1.0, 1.0, 1.0, 2.5, 2.5], [0.5, 0.5, 0.5, 0.0, 1.0])
    recording, true_N = press_with_lag(0.03, latency_s=UNKNOWN_S, profile=slow)
    assert recording.alignment.force_time_constant_s == pytest.approx(0.03, rel=0.4)
    error_N = np.sqrt(np.mean((recording.force_N - true_N) ** 2))
    # The rest is where the contact was found, and the cell's noise.
    assert 0.0 < recording.alignment.force_response_N < error_N < 0.02 * np.ptp(true_N)


def test_a_run_that_keeps_no_force_may_be_pressed_behind_a_low_pass_that_is_stated():
    recording, _ = press_with_lag(0.1, 0.0, 0.1, with_reference=False)
    assert recording.alignment.force_time_constant_s == pytest.approx(0.1, rel=0.25)


@pytest.mark.parametrize("late_s", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("unit", [None, RELAXING])
def test_a_late_cell_has_no_low_pass(late_s, unit):
    recording, _ = press_with_lag(0.0, late_s, UNKNOWN_S, unit)
    assert recording.alignment.force_time_constant_s == recording.alignment.force_response_N == 0.0


@pytest.mark.parametrize(("relaxation_s", "tolerance"), [(1.0, 0.2), (0.1, 0.35)])
@pytest.mark.parametrize("constant_s", [0.03, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("late_s", [0.0, 0.2])
@pytest.mark.parametrize("samples_Hz", [40.0, 80.0])
def test_delay_and_time_constant_are_distinguished(constant_s, late_s, samples_Hz, relaxation_s, tolerance, rng):
    """A unit that relaxes as fast as the cell follows takes off some of what the filter does, and is taken for that."""
    fine_s = np.arange(0.0, 30.0, 0.001)
    turns_s, turns_mm = [0.0, 1.0, 1.4, 1.8, 3.5, 4.0, 5.0, 5.3, 6.0], [0, 3, 3, 0, 3, 1, 1, 3, 0]
    stage_mm = np.interp(fine_s % 6.0, turns_s, turns_mm)
    elastic_N = 0.8 * stage_mm**1.6
    force_N = elastic_N - 0.25 * behind_low_pass(elastic_N, relaxation_s)
    filtered_N = behind_low_pass(force_N, constant_s)
    t_s = np.arange(1.0, 29.0, 1.0 / samples_Hz)
    shown_N = np.interp(t_s - late_s, fine_s, filtered_N) + rng.normal(0, 0.005, len(t_s))
    response = fit_response(t_s, shown_N, lambda at_s: np.interp(at_s, fine_s, stage_mm), 0.0, METHOD)
    assert response.time_constant_s == pytest.approx(constant_s, rel=tolerance, abs=0.01)
    assert response.lag_s == pytest.approx(late_s + constant_s, abs=0.04)
    error_N = np.sqrt(np.mean((filtered_N - force_N)[1000:-1000] ** 2))
    assert response.error_N(late_s) == pytest.approx(error_N, rel=tolerance)


@pytest.mark.parametrize("fastest_N_s", [1.5, 3.0])
def test_a_cell_that_follows_no_faster_than_so_gives_no_labels(fastest_N_s):
    """A limit of speed is neither delay nor low pass; slower presses do not reach it."""
    for profile, is_refused in ((FAST, True), (ramps([0.1, 0.15], 3.0, rest_s=0.5), False)):
        with open_simulated_bench(Twin(), seed=3) as (bench, station):
            limit_speed(station, fastest_N_s)
            with pytest.raises(BadReply) if is_refused else nullcontext():
                record(bench, "A0", profile, True)


def behind_low_pass(values, constant_s):
    """In steps of a millisecond."""
    decay = np.exp(-0.001 / constant_s)
    return lfilter([1.0 - decay], [1.0, -decay], values, zi=[decay * values[0]])[0]


def test_columns_are_interpolated_as_numpy_does_to_the_last_digit(rng):
    grid_s, columns = np.arange(3.0, 13.0, 0.01), rng.normal(0.0, 1.0, (1000, 5))
    at_s = np.concatenate([rng.uniform(2.0, 14.0, 3000), grid_s, [3.0, grid_s[-1]]])
    expected = np.column_stack([np.interp(at_s, grid_s, column) for column in columns.T])
    assert columns_at(at_s, grid_s, columns).tobytes() == expected.tobytes()
