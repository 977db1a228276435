"""Error figures against closed forms."""

import numpy as np
import pytest

from softcal.core.metrics import hysteresis_pct_fs, nrmse, r_squared, rmse


def test_rmse_of_a_constant_offset_is_the_offset_and_skips_warm_up() -> None:
    reference = np.linspace(0, 4, 9)
    estimate = np.where(np.arange(9) < 2, np.nan, reference + 0.5)
    assert rmse(estimate, reference) == pytest.approx(0.5)
    assert nrmse(estimate, reference) == pytest.approx(0.125)
    assert np.isnan(rmse(np.full(3, np.nan), np.zeros(3)))


def test_mean_explains_nothing_and_truth_everything() -> None:
    reference = np.linspace(0, 4, 9)
    assert r_squared(np.full(9, reference.mean()), reference) == pytest.approx(0.0)
    assert r_squared(reference, reference) == 1.0


def test_hysteresis_is_the_gap_between_the_branches() -> None:
    phase = np.linspace(0, 2 * np.pi, 4000)
    reference = 1 - np.cos(phase)
    output = reference + 0.2 * (np.sin(phase) > 0)
    assert hysteresis_pct_fs(output, reference) == pytest.approx(100 * 0.2 / np.ptp(output), rel=0.05)
