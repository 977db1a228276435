"""The soft staircase of a coarse ADC, against rounding of drawn noise."""

import numpy as np
import pytest

from softcal.core.twin.electronics import SMOOTH, dither_V, mean_code_V

STEP_V = 0.005


@pytest.mark.parametrize("noise", [0.08, 0.2, 0.4])
def test_the_mean_code_is_that_of_rounded_noise(noise):
    clean_V = np.linspace(1.0, 1.0 + 2 * STEP_V, 23)
    noise_V = np.random.default_rng(1).normal(0.0, noise * STEP_V, (40_000, 1))
    codes = np.round((clean_V + noise_V) / STEP_V) * STEP_V
    tolerance = 5 * STEP_V * 0.5 / np.sqrt(len(noise_V))
    np.testing.assert_allclose(mean_code_V(clean_V, noise * STEP_V, STEP_V), codes.mean(axis=0), atol=tolerance)


@pytest.mark.parametrize("noise", [0.1, 0.2, 0.3, 0.4])
def test_the_noise_before_the_adc_is_found_from_that_of_the_codes(noise):
    rng = np.random.default_rng(2)
    clean_V = rng.uniform(0.0, 50 * STEP_V, 200_000)
    codes = np.round((clean_V + rng.normal(0.0, noise * STEP_V, len(clean_V))) / STEP_V) * STEP_V
    around_V = float(np.std(codes - mean_code_V(clean_V, noise * STEP_V, STEP_V)))
    assert dither_V(around_V, STEP_V) == pytest.approx(noise * STEP_V, rel=0.03)


def test_noise_of_half_a_step_leaves_no_stairs():
    assert dither_V(np.hypot(0.5, 12**-0.5) * STEP_V, STEP_V) is None
    clean_V = np.linspace(0.0, STEP_V, 50)
    assert np.abs(mean_code_V(clean_V, SMOOTH * STEP_V, STEP_V) - clean_V).max() < 0.01 * STEP_V
