"""Estimates: against the sensor's closed form, batch against stream, and every flag by its fault."""

import time
from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.estimate import StreamingEstimator, estimate
from softcal.core.maps.affine import AffineMap
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import OutputRecording
from softcal.core.unit.calibrate import UnitProblem, calibrate
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.health import OutputLimits
from softcal.core.windows import TAPS


@pytest.fixture(scope="module")
def calibration(source_model, linear_network, press) -> Calibration:
    unit = press(2, gain=1.3, offset_V=0.05).unlabelled
    problem = FitProblem(source_model.source, linear_network, unit)
    made = calibrate(UnitProblem(source_model, problem.target, anchors=problem.anchors))
    exact = AffineMap(gain=1 / 1.3, offset=-0.05 / 1.3)
    return replace(made, unit_map=exact, output_limits=OutputLimits(-np.inf, np.inf, stuck_samples=100))


def stream(network, calibration, recording):
    estimator = StreamingEstimator(network, calibration, recording.sample_rate_Hz)
    return [estimator.advance(t, v) for t, v in zip(recording.t_s, recording.output, strict=True)]


def with_output(recording: OutputRecording, output) -> OutputRecording:
    return replace(recording, output=output)


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


def test_stream_equals_batch_row_by_row(linear_network, calibration, press):
    recording = press(5, gain=1.3, offset_V=0.05, seconds=20.0).unlabelled
    late = replace(recording, t_s=recording.t_s + np.where(np.arange(len(recording)) >= 500, 3.0, 0.0))
    batch, rows = estimate(linear_network, calibration, late), stream(linear_network, calibration, late)
    for name in ("estimate", "lower", "upper"):
        np.testing.assert_allclose([getattr(row, name) for row in rows], getattr(batch, name), rtol=1e-5, atol=1e-5)
    assert [row.flag for row in rows] == batch.flag.tolist()


def test_stream_resumes_from_its_state_as_if_nothing_had_happened(linear_network, calibration, press):
    recording = press(5, gain=1.3, offset_V=0.05, seconds=5.0).unlabelled
    whole = stream(linear_network, calibration, recording)
    first = StreamingEstimator(linear_network, calibration, 50.0)
    for k in range(107):
        first.advance(recording.t_s[k], recording.output[k])
    second = StreamingEstimator(linear_network, calibration, 50.0)
    second.restore(first.state())
    assert second.advance(recording.t_s[107], recording.output[107]) == whole[107]


def test_stream_takes_under_a_millisecond_a_sample(linear_network, calibration, press):
    recording = press(5, seconds=10.0).unlabelled
    estimator, taken_s = StreamingEstimator(linear_network, calibration, 50.0), []
    for t, v in zip(recording.t_s, recording.output, strict=True):
        start_s = time.process_time()
        estimator.advance(t, v)
        taken_s.append(time.process_time() - start_s)
    assert np.median(taken_s) < 1e-3


@pytest.mark.parametrize(("t_s", "output"), [(np.nan, 0.5), (1.0, np.nan), (0.5, 0.5), (0.4, 0.5)])
def test_a_sample_that_cannot_be_used_is_flagged_and_enters_nothing(linear_network, calibration, t_s, output):
    estimator = StreamingEstimator(linear_network, calibration, 50.0)
    estimator.advance(0.5, 0.6)
    before = estimator.state()
    assert estimator.advance(t_s, output).flag == "invalid"
    assert estimator.state() == before


def test_a_frozen_output_is_flagged_stuck(linear_network, calibration, press):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    output = recording.output.copy()
    output[1000:1300] = output[1000]
    flag = estimate(linear_network, calibration, with_output(recording, output)).flag
    assert set(flag[1000 + 99 : 1300]) == {"stuck"} and "stuck" not in flag[:1000]


def test_a_sample_at_a_rail_is_flagged_saturated(linear_network, calibration, press):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    clipped = replace(calibration, output_limits=OutputLimits(-np.inf, 0.9, stuck_samples=10_000))
    flag = estimate(linear_network, clipped, with_output(recording, np.minimum(recording.output, 0.9))).flag
    at_rail = recording.output[TAPS - 1 :] >= 0.9
    assert at_rail.any() and set(flag[TAPS - 1 :][at_rail]) == {"saturated"}


def test_a_load_beyond_the_source_is_out_of_range_and_its_interval_wider(linear_network, calibration, press):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    doubled = estimate(linear_network, calibration, with_output(recording, 0.7 + 2 * (recording.output - 0.7)))
    normal = estimate(linear_network, calibration, recording)
    beyond = doubled.flag == "out of range"
    assert beyond.any() and np.all(doubled.estimate[beyond] > 3.0)
    assert np.median((doubled.upper - doubled.lower)[beyond]) > 2 * np.nanmedian(normal.upper - normal.lower)


def test_fast_chatter_is_unfamiliar(linear_network, calibration, press, rng):
    recording = press(3, gain=1.3, offset_V=0.05).unlabelled
    noisy = with_output(recording, recording.output + rng.normal(0, 0.05, len(recording)))
    assert np.mean(estimate(linear_network, calibration, noisy).flag == "unfamiliar") > 0.5


def test_calibration_of_another_network_is_refused(linear_network, calibration, press):
    other = replace(linear_network, reference_mean=1.0)
    with pytest.raises(InputError, match="was calibrated with network"):
        estimate(other, calibration, press(3).unlabelled)


def test_output_in_another_unit_is_refused(linear_network, calibration, press):
    with pytest.raises(InputError, match="output is in counts"):
        estimate(linear_network, calibration, replace(press(3).unlabelled, output_unit="counts"))
