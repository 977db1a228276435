"""What every batch asks for is computed without `scipy.stats`, which takes a second to load; it gives the same."""

import numpy as np
import pytest
from scipy import stats

from softcal.core.maps.synchrony import ranks
from softcal.core.quality.acceptance import failing_share, share_beyond, tolerance_factor
from softcal.core.quality.interval_inflation import _next_unit

CLOSE = {"rel": 1e-12}


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.99])
@pytest.mark.parametrize(("checked", "failed"), [(1, 0), (9, 0), (22, 1), (100, 3), (1000, 40)])
def test_bounds_of_a_share(checked: int, failed: int, confidence: float) -> None:
    expected = stats.binomtest(failed, checked, alternative="less").proportion_ci(confidence).high
    assert failing_share(checked, failed, confidence) == pytest.approx(expected, rel=1e-8)
    beta = stats.beta.ppf(confidence, failed + 1, checked - failed)
    assert failing_share(checked, failed, confidence) == pytest.approx(beta, **CLOSE)


@pytest.mark.parametrize(("count", "rank"), [(9, 9), (10, 10), (19, 18), (40, 37)])
def test_what_lies_beyond_a_bound(count: int, rank: int) -> None:
    expected = stats.beta.ppf(0.9, count - rank + 1, rank)
    assert share_beyond(count, 0.1, 0.9) == pytest.approx(expected, **CLOSE)


@pytest.mark.parametrize("risk", [0.05, 0.1])
@pytest.mark.parametrize(("count", "degrees"), [(2, 1), (5, 4), (22, 21), (3.5, 40)])
def test_the_factor_of_a_tolerance(count: float, degrees: float, risk: float) -> None:
    shift = stats.norm.ppf(1 - risk) * np.sqrt(count)
    expected = stats.nct.ppf(0.9, degrees, shift) / np.sqrt(count)
    assert tolerance_factor(count, degrees, risk, 0.9) == pytest.approx(expected, rel=1e-9)


def test_what_one_more_value_exceeds(rng: np.random.Generator) -> None:
    values = rng.normal(size=7)
    spread = np.std(values, ddof=1) * np.sqrt(1 + 1 / 7)
    assert _next_unit(values, 0.1) == pytest.approx(values.mean() + stats.t.ppf(0.9, 6) * spread, **CLOSE)


def test_ranks_with_and_without_ties(rng: np.random.Generator) -> None:
    for values in (rng.normal(size=500), rng.integers(0, 9, 500).astype(float), np.zeros(4), np.array([2.0])):
        np.testing.assert_array_equal(ranks(values), stats.rankdata(values))
