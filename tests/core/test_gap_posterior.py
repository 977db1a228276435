"""How hypotheses are weighed where every equation may be a little wrong."""

import numpy as np
import pytest

from softcal.core.gap.fit import misfit
from softcal.core.gap.method import METHOD


def test_a_small_excess_counts_as_in_white_noise():
    assert misfit(3.0, METHOD.evidence.modes) - misfit(1.0, METHOD.evidence.modes) == pytest.approx(2.0)


def test_a_large_excess_counts_by_its_factor():
    assert misfit(4e5, METHOD.evidence.modes) - misfit(1e5, METHOD.evidence.modes) == pytest.approx(
        misfit(4e3, METHOD.evidence.modes) - misfit(1e3, METHOD.evidence.modes)
    )


def test_it_is_twice_the_negative_log_likelihood_of_modes_of_the_best_size():
    excess = 700.0
    sizes = np.geomspace(1.0, 1e4, 20_000)
    by_size = METHOD.evidence.modes * np.log(sizes) + excess / sizes
    assert misfit(excess, METHOD.evidence.modes) == pytest.approx(by_size.min(), rel=1e-6)
