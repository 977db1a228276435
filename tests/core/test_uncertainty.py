"""Intervals and support: coverage on fresh recordings, closed forms of window shapes, lossless storage."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.maps.affine_map import AffineMap
from softcal.core.unit.correspondence import find_correspondence
from softcal.core.unit.evidence import OtherMaps, gather_evidence
from softcal.core.unit.forecast import forecast_error, variance_table
from softcal.core.unit.health import output_limits
from softcal.core.unit.lot_fit_part import LotFitPart
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import conformal_quantile, fit_support, source_residuals
from softcal.core.unit.uncertainty import Interval
from softcal.core.windows import TAPS, windows

METHOD = Method()
BLIND = find_correspondence({}, METHOD.correspondence)


def half_widths(interval, network, mapped):
    shape = interval.support.shape(mapped)
    return interval.half(network.evaluate(mapped), shape, interval.support.distance(shape))


def test_the_conformal_quantile_is_the_rank_of_the_definition():
    scores = np.arange(1.0, 20.0)
    assert conformal_quantile(scores) == 18.0  # ceil(20 * 0.9) = 18
    assert conformal_quantile(np.array([3.0, 1.0])) == 3.0


def test_conformal_coverage_on_fresh_draws_is_at_least_ninety_percent(rng):
    hits = [np.abs(rng.normal()) <= conformal_quantile(np.abs(rng.normal(size=50))) for _ in range(4000)]
    # At least 0.9, at most 0.9 + 1 / 51 (Lei et al. 2018, theorem 2); 0.0047 is one standard deviation.
    assert 0.885 < np.mean(hits) < 0.935


def test_the_interval_holds_on_another_recording_of_the_source(source_model, linear_network, press):
    fresh = press(9, seconds=120.0)
    half = half_widths(source_model.interval, linear_network, fresh.windows)
    error = np.abs(linear_network.evaluate(fresh.windows) - fresh.window_reference)
    assert 0.87 < np.mean(error <= half) < 0.93


def test_the_interval_follows_the_band_where_the_noise_is(linear_network, press, rng):
    clean = press(4, seconds=120.0)
    reference = clean.reference + np.where(clean.reference > 1.5, rng.normal(0, 0.2, len(clean)), 0)
    noisy = replace(clean, reference=reference)
    interval, *_ = source_residuals(
        linear_network, noisy.windows, noisy.window_reference, np.arange(0, 5000, 3), METHOD.source
    )
    low, high = (interval.half_width[1][interval.column(np.array([v]))] for v in (0.5, 2.5))
    assert high > 4 * low


def test_directions_are_distinguished(source_model, linear_network):
    rising = 0.5 + np.linspace(0.0, 0.05, 60)
    for signal, expected in ((rising, 2), (rising[::-1], 0), (np.full(60, 0.55), 1)):
        shape = source_model.interval.support.shape(windows(np.ascontiguousarray(signal)))
        assert set(source_model.interval.direction(shape)) == {expected}


def test_map_variance_adds_in_quadrature(source_model):
    interval = source_model.interval
    wider = interval.widened(np.full_like(interval.half_width, 0.04))
    np.testing.assert_allclose(wider.half_width**2, interval.half_width**2 + 1.645**2 * 0.04)


def test_the_interval_grows_off_support_and_beyond_the_range(source_model, linear_network):
    level = np.array([0.7, 0.9, 1.1, 1.3, 1.6])[:, None] * np.ones(TAPS)
    half = half_widths(source_model.interval, linear_network, level)
    assert np.all(np.diff(half[2:]) > 0) and half[-1] > 5 * half[0]


def test_interval_survives_storage_bit_by_bit(source_model, linear_network, press):
    interval = source_model.interval
    again = Interval.from_arrays(interval.arrays(), interval.settings())
    mapped = press(9).windows
    np.testing.assert_array_equal(
        half_widths(again, linear_network, mapped), half_widths(interval, linear_network, mapped)
    )


def test_window_shape_is_a_least_squares_parabola(rng):
    signals = rng.normal(size=(40, TAPS))
    shape = fit_support(signals, 0.0, 1.0, METHOD.source).shape(signals)
    abscissa = np.linspace(-1, 1, TAPS)
    for k in range(40):
        coefficients = np.polyfit(abscissa, signals[k], 2)
        residual = np.sqrt(np.mean((signals[k] - np.polyval(coefficients, abscissa)) ** 2))
        line = np.polyfit(abscissa, signals[k], 1)[0]
        assert shape.roughness[k] == pytest.approx(residual, rel=1e-4)
        assert shape.level[k] == pytest.approx(signals[k].mean(), abs=1e-6)
        assert shape.slope[k] == pytest.approx(line * np.sqrt(np.mean(abscissa**2)), abs=1e-5)


def test_the_sources_own_windows_are_familiar_and_distance_is_euclidean_outside(source_model):
    support, mapped = source_model.interval.support, source_model.source.windows
    distance = support.distance(support.shape(mapped))
    assert np.mean(distance == 0) > 0.99
    far = np.array([[0.5 + 0.1 * z] * TAPS for z in (20.0, 30.0)])
    near, further = support.distance(support.shape(far))
    assert further - near == pytest.approx(10.0, rel=0.05)


def test_a_forecast_is_the_root_of_the_sum_of_squares():
    budget = dict.fromkeys(BLIND.sensitivity, 0.0)
    alone = forecast_error({"model": 0.3, **budget}, BLIND)
    assert alone.rmse == pytest.approx(0.3) and alone.lower < 0.3 < alone.upper
    both = forecast_error({"model": 0.3, **budget, "rest": 0.4}, BLIND)
    assert both.rmse == pytest.approx(np.hypot(0.3, 0.4 * BLIND.sensitivity["rest"]))


def test_a_gain_from_matched_levels_widens_with_the_square_of_the_load(source_model, linear_network, press):
    # Rests as the source does and reaches beyond its loads: nothing of them is unseen.
    unit = press(3, gain=1.2, offset_V=-0.1, seconds=120.0).unlabelled
    limits = output_limits(unit, source_model.source.unlabelled, is_rising=True, method=METHOD)
    evidence = gather_evidence(source_model, unit, AffineMap(1.0, 0.0, "identity"), limits, OtherMaps(gain_error=0.1))
    row = variance_table(source_model, evidence)[1]
    even = variance_table(source_model, replace(evidence, budget={**evidence.budget, "gain": 0.0}))[1]
    level = source_model.interval.low + (np.arange(len(row)) + 0.5) * np.ptp(source_model.source.reference) / len(row)
    rest = np.quantile(evidence.estimate, 0.02)
    load, rms_load = np.maximum(level - rest, 0), np.sqrt(np.mean((evidence.estimate - rest) ** 2))
    np.testing.assert_allclose(even, even[0])
    base = row[0] / (1 + (load[0] / rms_load) ** 2)
    np.testing.assert_allclose(row, base * (1 + (load / rms_load) ** 2))


class LevelMap:
    """A paired map that takes the mean of a window alone: what moved within it is gone."""

    family = "shared_load"

    def apply(self, rows):
        return np.repeat(rows.mean(axis=1, keepdims=True), TAPS, axis=1)

    def apply_signal(self, signal):
        return self.apply(windows(signal))


def test_how_fast_a_unit_of_a_lot_fit_was_pressed_shows_through_a_map_that_keeps_it(source_model, press):
    unit, line = press(3, seconds=120.0).unlabelled, AffineMap(1.0, 0.0, "two_point")
    limits = output_limits(unit, source_model.source.unlabelled, is_rising=True, method=METHOD)
    part = LotFitPart(number=1, sitting="together", units=5, common_rmse=0.1, unit_rmse=0.1)
    others = OtherMaps([line], linear_map=line)
    evidence = gather_evidence(source_model, unit, LevelMap(), limits, others, lot_fit=part)
    assert evidence.speed == pytest.approx(1.0, rel=0.2)


def test_loads_the_unit_has_not_shown_are_uncertain_there_alone(source_model, linear_network, press):
    unit = press(3, seconds=120.0).unlabelled
    half = replace(unit, output=0.5 + 0.5 * (unit.output - 0.5))
    limits = output_limits(half, source_model.source.unlabelled, is_rising=True, method=METHOD)
    evidence = gather_evidence(source_model, half, AffineMap(1.0, 0.0, "identity"), limits)
    row, highest_load = variance_table(source_model, evidence)[1], np.quantile(evidence.estimate, 0.995)
    level = source_model.interval.low + (np.arange(len(row)) + 0.5) * np.ptp(source_model.source.reference) / len(row)
    covered = row[level < highest_load - 0.1]
    np.testing.assert_allclose(covered, covered[0])
    np.testing.assert_allclose(
        row[-1] - covered[0], (BLIND.sensitivity["extrapolation"] * (level[-1] - highest_load)) ** 2
    )
