"""Error figures against closed forms."""

import numpy as np
import pytest

from softcal.core.metrics import quantile, rmse


def test_rmse_of_a_constant_offset_is_the_offset_and_skips_warm_up() -> None:
    reference = np.linspace(0, 4, 9)
    estimate = np.where(np.arange(9) < 2, np.nan, reference + 0.5)
    assert rmse(estimate, reference) == pytest.approx(0.5)


def test_rmse_of_nothing_is_not_a_number() -> None:
    assert np.isnan(rmse(np.full(3, np.nan), np.zeros(3)))


@pytest.mark.parametrize("count", [1, 2, 3, 17, 1250, 8501])
def test_quantiles_are_those_of_numpy_to_the_last_digit(count: int, rng: np.random.Generator) -> None:
    shares = np.concatenate([[0.0, 0.5, 1.0], rng.uniform(0.0, 1.0, 20)])
    for values in (rng.normal(2.0, 0.3, count), rng.integers(0, 4, count) * 0.1, np.full(count, 0.1)):
        assert quantile(values, shares).tobytes() == np.quantile(values, shares).tobytes()
        assert [float(quantile(values, share)) for share in shares] == np.quantile(values, shares).tolist()


def test_a_quantile_of_what_is_not_a_number_is_none() -> None:
    assert np.isnan(quantile(np.array([0.0, np.nan, 1.0]), (0.0, 0.5))).all()
