"""The filter against the textbook: independent least squares, the algebra of a witness that was told, and its form."""

import json

import numpy as np
import pytest

from softcal.core.operation.drift_filter import DriftFilter
from softcal.core.operation.stored_state import from_state, to_state

NOISE = np.array([[0.04, -0.01], [-0.01, 0.02]])


def test_drift_that_stands_is_the_weighted_mean_of_what_was_measured(rng: np.random.Generator) -> None:
    prior = np.array([0.5, 0.3])
    values = rng.normal(0.2, 0.1, (7, 2))
    state = DriftFilter.start(prior).with_independent(np.zeros((2, 2)))

    for value in values:
        state = state.update(0, value, NOISE)

    precision = np.diag(1 / prior**2) + 7 * np.linalg.inv(NOISE)
    expected = np.linalg.solve(precision, np.linalg.solve(NOISE, values.sum(axis=0)))
    np.testing.assert_allclose(state.drift, expected, atol=1e-12)
    np.testing.assert_allclose(state.drift_covariance(), np.linalg.inv(precision), atol=1e-12)


def test_a_correlated_observer_is_never_surer_of_the_drift_than_its_source() -> None:
    state = DriftFilter.start(np.array([0.1, 0.05])).with_learnt(np.zeros((2, 2)))
    covariance = state.drift_covariance()

    for _ in range(200):
        state = state.update(0, np.zeros(2), NOISE)

    np.testing.assert_allclose(state.drift_covariance(), covariance, rtol=1e-9)
    assert np.trace(state.predict_measurement(0)[1]) < 1e-6


def test_a_correlated_observer_sees_what_moves_later() -> None:
    state = DriftFilter.start(np.array([0.1, 0.05])).with_learnt(np.zeros((2, 2)))
    moved = np.array([0.3, -0.1])

    state = state.predict(np.eye(2))
    for _ in range(400):
        state = state.update(0, moved, NOISE)

    np.testing.assert_allclose(state.drift, moved, atol=0.01)


def test_calibrated_witness_corrects_what_others_were_told() -> None:
    state = DriftFilter.start(np.array([0.1, 0.1])).with_independent(np.zeros((2, 2))).with_learnt(np.zeros((2, 2)))

    for _ in range(400):
        state = state.update(0, np.array([0.08, -0.03]), NOISE)

    np.testing.assert_allclose(state.drift, [0.08, -0.03], atol=0.01)
    np.testing.assert_allclose(state.predict_measurement(1)[0], [0.0, 0.0], atol=0.01)


def test_forgetting_an_activity_leaves_the_others() -> None:
    state = DriftFilter.start(np.array([0.1, 0.1]))
    for k in range(3):
        state = state.with_independent((k + 1) * NOISE)

    remaining = state.without(1)

    assert remaining.mean.shape == (6,)
    np.testing.assert_array_equal(remaining.covariance[4:, 4:], 3 * NOISE)


@pytest.mark.parametrize("steps", [4_000])
def test_covariance_stays_symmetric_and_positive(steps: int, rng: np.random.Generator) -> None:
    state = DriftFilter.start(np.array([0.1, 0.05])).with_independent(NOISE).with_learnt(NOISE)

    for k in range(steps):
        state = state.predict(1e-6 * np.eye(2)).update(k % 2, rng.normal(0, 0.1, 2), NOISE)

    np.testing.assert_allclose(state.covariance, state.covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(state.covariance).min() > -1e-15


def test_state_goes_through_json(rng: np.random.Generator) -> None:
    state = DriftFilter.start(np.array([0.1, 0.05])).with_learnt(NOISE).update(0, rng.normal(size=2), NOISE)

    other = from_state(DriftFilter, json.loads(json.dumps(to_state(state))))

    np.testing.assert_array_equal(other.mean, state.mean)
    np.testing.assert_array_equal(other.covariance, state.covariance)
