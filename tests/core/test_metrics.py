"""Error figures against closed forms."""

import numpy as np
import pytest

from softcal.core.metrics import rmse


def test_rmse_of_a_constant_offset_is_the_offset_and_skips_warm_up() -> None:
    reference = np.linspace(0, 4, 9)
    estimate = np.where(np.arange(9) < 2, np.nan, reference + 0.5)
    assert rmse(estimate, reference) == pytest.approx(0.5)


def test_rmse_of_nothing_is_not_a_number() -> None:
    assert np.isnan(rmse(np.full(3, np.nan), np.zeros(3)))
