"""Products over long vectors, and sums over waves."""

import numpy as np
import pytest

from softcal.core.gap.linear import energy, gram, wave_sums


@pytest.fixture
def rows() -> np.ndarray:
    return np.random.default_rng(3).normal(size=(4, 1003))


def test_products_are_those_of_matrices(rows: np.ndarray) -> None:
    assert np.allclose(gram(rows), rows @ rows.T)
    assert energy(rows[0]) == pytest.approx(float(np.sum(rows[0] ** 2)))


def test_sums_over_waves_are_a_transform_at_any_times_and_frequencies(rows: np.ndarray) -> None:
    t_s = np.cumsum(np.abs(rows[2])) * 0.02
    grid_Hz = np.array([0.0, 0.31, 9.97, 50.0])
    assert np.allclose(wave_sums(grid_Hz, t_s, rows[0]), np.exp(-2j * np.pi * np.outer(grid_Hz, t_s)) @ rows[0])
