"""A Kalman filter for the drift of one sensor (Kalman 1960): a random walk, measured with a bias by each activity.

The state is the drift d, (2,) shift and log gain, and for each known activity k the bias b_k of its cycles: a cycle of
activity k measures d + b_k plus noise. The calibrated activity has an independent bias. An activity learnt in use took
the drift as it was estimated then as its zero, so its bias is the error of that estimate, fully correlated with the
drift. Its cycles therefore never make the drift better known than it was then, but show well how it moves on.
"""

from dataclasses import dataclass, field

import numpy as np

from softcal.core.operation.stored_state import array_field
from softcal.core.recording import Array, Indices


@dataclass(frozen=True, eq=False)
class DriftFilter:
    """Estimated drift, then the biases of K activities, (2 + 2 K,), with the covariance of their errors."""

    mean: Array = field(metadata=array_field("n"))
    covariance: Array = field(metadata=array_field("n", "n"))

    @classmethod
    def start(cls, estimate_uncertainty: Array) -> "DriftFilter":
        """Return no drift, known to standard deviations (2,), and no activity."""
        return cls(np.zeros(2), np.diag(estimate_uncertainty**2))

    @property
    def drift(self) -> Array:
        """(2,) shift and log gain."""
        return self.mean[:2]

    def drift_covariance(self) -> Array:
        """Return the (2, 2) covariance of the drift."""
        return self.covariance[:2, :2]

    def predict(self, variance: Array) -> "DriftFilter":
        """Return the filter after a step of the random walk with (2, 2) process noise."""
        covariance = self.covariance.copy()
        covariance[:2, :2] += variance
        return DriftFilter(self.mean, covariance)

    def predict_measurement(self, index: int) -> tuple[Array, Array]:
        """Return mean and covariance of what an activity's cycles measure, without their own noise."""
        measurement = self._measurement_matrix(index)
        return measurement @ self.mean, measurement @ self.covariance @ measurement.T

    def update(self, index: int, value: Array, noise: Array) -> "DriftFilter":
        measurement = self._measurement_matrix(index)
        expected, covariance = self.predict_measurement(index)
        gain = self.covariance @ measurement.T @ np.linalg.inv(covariance + noise)
        retained = np.eye(len(self.mean)) - gain @ measurement
        # Joseph's form stays symmetric and positive however often it is applied.
        posterior = retained @ self.covariance @ retained.T + gain @ noise @ gain.T
        return DriftFilter(self.mean + gain @ (value - expected), posterior)

    def with_independent(self, variance: Array) -> "DriftFilter":
        """Return the filter with one activity more, whose bias is independent of the drift."""
        covariance = np.pad(self.covariance, (0, 2))
        covariance[-2:, -2:] = variance
        return DriftFilter(np.append(self.mean, [0.0, 0.0]), covariance)

    def with_learnt(self, variance: Array) -> "DriftFilter":
        """Return the filter with one activity more, whose zero is the drift as it is estimated now."""
        n = len(self.mean)
        # b = -(d - estimate of d) + error of the mean over the cycles it was learnt from.
        observed = np.vstack([np.eye(n), np.zeros((2, n))])
        observed[n:, :2] = -np.eye(2)
        covariance = observed @ self.covariance @ observed.T
        covariance[n:, n:] += variance
        return DriftFilter(np.append(self.mean, [0.0, 0.0]), covariance)

    def without(self, index: int) -> "DriftFilter":
        """Return the filter with one activity less."""
        others = np.delete(np.arange(len(self.mean)), self._bias_rows(index))
        return DriftFilter(self.mean[others], self.covariance[np.ix_(others, others)])

    def _measurement_matrix(self, index: int) -> Array:
        """Return the (2, n) measurement matrix of an activity: drift plus its bias."""
        measurement = np.zeros((2, len(self.mean)))
        measurement[:, :2] = measurement[:, self._bias_rows(index)] = np.eye(2)
        return measurement

    def _bias_rows(self, index: int) -> Indices:
        """Return the (2,) places of an activity's bias in the state."""
        return 2 * (index + 1) + np.arange(2)
