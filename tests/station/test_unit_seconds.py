"""How long a unit takes: said before it is pressed, kept to while it is, and no longer than what is known needs."""

from dataclasses import replace

import numpy as np
import pytest
from common.rig_trial import ForceLaw, RigCase, open_rig

from softcal.core.profiles import ramps, unit_profile
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.motion.monitored_bench import bounds_of
from softcal.station.tasks.acquisition import record
from softcal.station.tasks.durations import PROBING, phase_seconds, shorter, unit_s
from softcal.station.tasks.self_test import self_test

SOFT = RigCase(latency_s=0.0, stiffest_N_mm=60.0, limit_N=12.0, law=ForceLaw(0.8, 1.2))
RIGID = replace(SOFT, stiffest_N_mm=1000.0)
UNKNOWN = replace(SOFT, latency_s=UNKNOWN_S)
PROFILE = ramps([2.5, 2.5], 4.0, rest_s=0.5)


def press_two_units(case, profile=PROFILE):
    """Press two units one after the other; return each one's progress: (phase, fraction, time) as it was told."""
    reports = ([], [])
    with open_rig(case) as (bench, station):
        for one in reports:
            began_s = station.world.now_s()
            record(bench, "S1", profile, True, lambda p, one=one: one.append((p.phase, p.fraction, p.t_s)))
            one.append(("", 1.0, station.world.now_s() - began_s))
    return reports


@pytest.mark.parametrize("case", [SOFT, RIGID, UNKNOWN])
def test_progress_never_runs_back_and_a_unit_takes_no_longer_than_is_reported(case):
    first, second = press_two_units(case)
    for one in (first, second):
        fractions = [fraction for _, fraction, _ in one]
        assert fractions == sorted(fractions) and fractions[-1] == 1.0
    with open_rig(case) as (bench, _):
        predicted_s = unit_s(bench.config, bounds_of(bench), PROFILE)
    assert 0.3 * predicted_s < second[-1][2] < 1.1 * predicted_s


def test_the_second_unit_takes_at_most_half_again_as_long_as_the_pressing_itself():
    profile = unit_profile(np.random.default_rng(0), 25.0)
    _, second = press_two_units(SOFT, profile)
    assert second[-1][2] <= 1.5 * profile.duration_s


@pytest.mark.long
def test_a_slow_press_is_as_fast_as_the_force_so_far_allows():
    first, _ = press_two_units(RIGID)
    took_s = max(t for phase, _, t in first if phase == PROBING) - min(t for phase, _, t in first if phase == PROBING)
    with open_rig(RIGID) as (bench, _):
        slowest_s = PROFILE.deepest_mm / bounds_of(bench).unknown_mm_s
    assert took_s < 0.6 * slowest_s


@pytest.mark.long
def test_a_hard_layer_that_a_slow_press_meets_half_way_is_searched_from_the_top_and_pressed():
    hard = replace(RIGID, law=ForceLaw(0.4, 1.0, stop_mm=0.9, stop_N_mm=5.0))
    with open_rig(hard) as (bench, station):
        recording = record(bench, "S1", ramps([2.0, 2.0], 1.0, rest_s=0.5), True)
        assert station.rig.largest_force_N < hard.limit_N
    assert recording.force_N.max() == pytest.approx(hard.law.force_N(recording.stage_mm.max() - 0.3), rel=0.1)


def test_the_self_test_says_the_seconds_a_unit_takes_and_what_would_shorten_them():
    with open_rig(replace(RIGID, latency_s=UNKNOWN_S)) as (bench, _):
        findings = self_test(bench, may_move=False, profile=PROFILE)
        bounds = bounds_of(bench)
        all_s = unit_s(bench.config, bounds, PROFILE)
        assert {key for key, _, shorter_s in shorter(bench.config, bounds, PROFILE) if shorter_s < all_s} == {
            "latency_s", "stiffest_N_mm", "force_N",
        }  # fmt: skip
    reason_values = [finding.value.values for finding in findings if finding.value.code == "found.unit_seconds"]
    assert [values["all_s"] for values in reason_values] == [all_s] and reason_values[0][
        "stiffest_N_mm"
    ] == RIGID.stiffest_N_mm
    assert sum(finding.value.code == "found.shorter" for finding in findings) == 3


def test_each_shortening_does_what_it_promises():
    for case in (RIGID, UNKNOWN):
        with open_rig(case) as (bench, _):
            for key, value, shorter_s in shorter(bench.config, bounds_of(bench), PROFILE):
                field = {"latency_s": "latency_s", "stiffest_N_mm": "stiffest_N_mm", "force_N": "limit_N"}[key]
                with open_rig(replace(case, **{field: value})) as (changed, _):
                    assert unit_s(changed.config, bounds_of(changed), PROFILE) == pytest.approx(shorter_s)


def test_a_stage_that_must_be_homed_is_planned_for():
    with open_rig(SOFT) as (bench, _):
        homed_seconds = phase_seconds(bench.config, bounds_of(bench), PROFILE, bench.config.fixture.approach_mm)
        unknown = phase_seconds(bench.config, bounds_of(bench), PROFILE, None)
    assert sum(homed_seconds.values()) < sum(unknown.values())
