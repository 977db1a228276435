"""Estimates: against the sensor's closed form, batch against stream, and every flag by its fault."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import FitProblem
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import estimate
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.state import UnitState
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.windows import TAPS
from tests.unit_states import with_fitted


@pytest.fixture(scope="module")
def calibration(source_model, linear_network, press) -> UnitState:
    unit = press(2, gain=1.3, offset_V=0.05).unlabelled
    problem = FitProblem(source_model.source, linear_network, unit)
    calibration_state = calibrate(UnitProblem(source_model, problem.target, anchors=problem.anchors))
    exact = AffineMap(gain=1 / 1.3, offset=-0.05 / 1.3)
    return with_fitted(
        calibration_state, unit_map=exact, output_limits=OutputLimits(-np.inf, np.inf, stuck_samples=100)
    )


def test_estimates_follow_the_load_and_the_interval_encloses_them(linear_network, calibration, press):
    audit = press(3, gain=1.3, offset_V=0.05)
    result = estimate(linear_network, calibration, audit.unlabelled)
    trusted = result.flag == ""
    assert trusted.mean() > 0.95
    assert np.sqrt(np.mean((result.estimate - audit.reference)[trusted] ** 2)) < 0.03
    assert np.all(result.lower[trusted] <= result.estimate[trusted])
    assert np.all(result.estimate[trusted] <= result.upper[trusted])
    covered = (result.lower <= audit.reference) & (audit.reference <= result.upper)
    assert covered[trusted].mean() > 0.85


def test_rows_before_the_first_full_window_are_nan_and_flagged(linear_network, calibration, press):
    result = estimate(linear_network, calibration, press(3).unlabelled)
    assert np.isnan(result.estimate[: TAPS - 1]).all() and np.isfinite(result.estimate[TAPS - 1])
    assert set(result.flag[: TAPS - 1]) == {"warm-up"}


def test_no_window_reaches_across_a_gap(linear_network, calibration, press):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    late = replace(recording, t_s=recording.t_s + np.where(np.arange(len(recording)) >= 500, 3.0, 0.0))
    result = estimate(linear_network, calibration, late)
    assert set(result.flag[500 : 500 + TAPS - 1]) == {"gap"}
    assert np.isnan(result.estimate[500 : 500 + TAPS - 1]).all() and np.isfinite(result.estimate[500 + TAPS - 1])


def test_a_frozen_output_is_flagged_stuck(linear_network, calibration, press):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    output = recording.output.copy()
    output[1000:1300] = output[1000]
    flag = estimate(linear_network, calibration, replace(recording, output=output)).flag
    assert set(flag[1000 + 99 : 1300]) == {"stuck"} and "stuck" not in flag[:1000]


def test_a_sample_at_a_rail_is_flagged_saturated(linear_network, calibration, press):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    clipped = with_fitted(calibration, output_limits=OutputLimits(-np.inf, 0.9, stuck_samples=10_000))
    flag = estimate(linear_network, clipped, replace(recording, output=np.minimum(recording.output, 0.9))).flag
    at_rail = recording.output[TAPS - 1 :] >= 0.9
    assert at_rail.any() and set(flag[TAPS - 1 :][at_rail]) == {"saturated"}


def test_a_load_beyond_the_source_is_out_of_range_and_its_interval_wider(linear_network, calibration, press):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    doubled = estimate(linear_network, calibration, replace(recording, output=0.7 + 2 * (recording.output - 0.7)))
    normal = estimate(linear_network, calibration, recording)
    beyond = doubled.flag == "out of range"
    assert beyond.any() and np.all(doubled.estimate[beyond] > 3.0)
    assert np.median((doubled.upper - doubled.lower)[beyond]) > 2 * np.nanmedian(normal.upper - normal.lower)


def test_fast_chatter_is_unfamiliar(linear_network, calibration, press, rng):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    noisy = replace(recording, output=recording.output + rng.normal(0, 0.05, len(recording)))
    assert np.mean(estimate(linear_network, calibration, noisy).flag == "unfamiliar") > 0.5


def test_calibration_of_another_network_is_refused(linear_network, calibration, press):
    other = replace(linear_network, reference_mean=1.0)
    with pytest.raises(InputError, match=f"{linear_network.id[:12]}.*{other.id[:12]}"):
        estimate(other, calibration, press(3).unlabelled)


def test_output_in_another_unit_is_refused(linear_network, calibration, press):
    with pytest.raises(InputError, match="counts.* V"):
        estimate(linear_network, calibration, replace(press(3).unlabelled, output_unit="counts"))
