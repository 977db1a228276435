"""What of a drift is applied: closed forms of use and sensor that change in size about a level."""

import numpy as np
import pytest

from softcal.core.operation.attribution import DriftAttribution, movement
from softcal.core.operation.method import DriftTracking
from softcal.core.recording import Array

STEP = DriftTracking().attribution.step
SURE = 1e-8 * np.eye(2)
REST = -1.2


def about(level: float, log_gain: float, shift: float = 0.0) -> Array:
    """A change of size about a level that itself moves by a shift."""
    return np.array([shift - np.expm1(log_gain) * level, log_gain])


def test_movement_is_zero_at_the_level_a_gain_turns_about() -> None:
    assert movement(about(REST, 0.3), REST) == pytest.approx(0.0)
    assert movement(about(REST, 0.3, 0.2), REST) == pytest.approx(0.2)


def test_larger_cycles_about_a_rest_that_stands_are_use() -> None:
    attribution = DriftAttribution(zero=REST, rest=REST)

    np.testing.assert_allclose(attribution.applied_drift(about(REST, 0.3), SURE), [0.0, 0.0], atol=1e-9)
    assert attribution.is_operation_as_likely(about(REST, 0.3), SURE, attribution.applied_drift(about(REST, 0.3), SURE))


def test_larger_cycles_of_a_preloaded_use_are_use() -> None:
    """Turning points above zero load move when the use grows; the output at zero load does not."""
    attribution = DriftAttribution(zero=-2.0, rest=-1.5)

    np.testing.assert_allclose(attribution.applied_drift(about(-2.0, 0.3), SURE), [0.0, 0.0], atol=1e-9)


def test_shift_of_the_rest_is_applied_in_full_and_gain_as_far_as_it_vouches_for() -> None:
    drift = about(REST, 0.3, -0.2)
    attribution = DriftAttribution(zero=REST, rest=REST, rest_path=0.2)

    shift, log_gain = attribution.applied_drift(drift, SURE)

    assert movement(np.array([shift, log_gain]), REST) == pytest.approx(-0.2)
    assert log_gain == pytest.approx(0.2 / abs(REST))


@pytest.mark.parametrize(("shift", "applied"), [(0.05, 0.0), (0.3, 0.3 - STEP), (-0.05, -0.05)])
def test_rest_that_follows_the_size_of_the_use_is_its_creep(shift: float, applied: float) -> None:
    """Harder use raises the rest of a sensor that creeps, never lowers it."""
    offset, log_gain = DriftAttribution(zero=REST, rest=REST).applied_drift(about(REST, 0.3, shift), SURE)

    assert log_gain == 0
    assert offset == pytest.approx(applied)


def test_gain_that_may_be_use_is_doubted() -> None:
    applied = np.array([0.0, 0.2])

    # Half the mean square of a wrong gain of 0.2 about the rest, over a use of mean 0 and scale 1.
    assert DriftAttribution(zero=REST, rest=REST).operation_variance(applied, applied) == pytest.approx(
        0.5 * 0.2**2 * (1 + REST**2)
    )


def test_without_a_rest_nothing_is_applied() -> None:
    np.testing.assert_array_equal(DriftAttribution(zero=REST).applied_drift(about(REST, 0.3, 0.5), SURE), [0.0, 0.0])


def test_what_may_be_chance_is_not_applied() -> None:
    unsure = 0.1**2 * np.eye(2)

    np.testing.assert_array_equal(
        DriftAttribution(zero=REST, rest=REST).applied_drift(np.array([0.2, 0.0]), unsure), [0.0, 0.0]
    )


def test_gain_taken_for_drift_that_was_use_costs_no_more_than_the_shift_repaid(rng: np.random.Generator) -> None:
    """Were all of the gain use, its correction moves the mean by at most what correcting the shift saved."""
    signal = rng.normal(size=100_000)
    shift = 0.05
    attribution = DriftAttribution(zero=REST, rest=REST, rest_path=shift)

    applied = attribution.applied_drift(about(REST, 0.5, shift), SURE)

    remaining = shift - (applied[0] + np.expm1(applied[1]) * signal)
    assert abs(np.mean(remaining)) <= 1.05 * shift
