"""The random-walk filter (Kalman 1960) that drift is followed with; each activity is a witness with a bias of its own.

The state is the drift d, (2,) shift and log gain, and for each known activity k the bias b_k of what its cycles say:
they measure d + b_k. An activity learnt in use was told the drift as it was known then: its bias is the error of that,
fully correlated with the drift. So it never knows the drift better than that, and what it sees move is known well.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softcal.core.recording import Array


@dataclass(frozen=True, eq=False)
class DriftFilter:
    """Drift and biases as they are known.

    Args:
        mean: (2 + 2 K,) drift, then the bias of each of K activities.
        covariance: (2 + 2 K, 2 + 2 K) of their errors.
    """

    mean: Array
    covariance: Array

    @classmethod
    def start(cls, doubt: Array) -> "DriftFilter":
        """Return no drift, known to standard deviations (2,), and no activity."""
        return cls(np.zeros(2), np.diag(doubt**2))

    @property
    def drift(self) -> Array:
        """(2,) shift and log gain."""
        return self.mean[:2]

    def doubt(self) -> Array:
        """Return the (2, 2) covariance of the drift."""
        return self.covariance[:2, :2]

    def moved(self, variance: Array) -> "DriftFilter":
        """Return the filter after the drift may have moved, (2, 2) variance."""
        covariance = self.covariance.copy()
        covariance[:2, :2] += variance
        return DriftFilter(self.mean, covariance)

    def seen_by(self, index: int) -> tuple[Array, Array]:
        """Return mean and covariance of what an activity's cycles measure, without their own noise."""
        sight = self._sight(index)
        return sight @ self.mean, sight @ self.covariance @ sight.T

    def measured(self, index: int, value: Array, noise: Array) -> "DriftFilter":
        """Return the filter after an activity measured (2,) a value with (2, 2) noise."""
        sight = self._sight(index)
        expected, covariance = self.seen_by(index)
        gain = self.covariance @ sight.T @ np.linalg.inv(covariance + noise)
        kept = np.eye(len(self.mean)) - gain @ sight
        # Joseph's form stays symmetric and positive however often it is applied.
        left = kept @ self.covariance @ kept.T + gain @ noise @ gain.T
        return DriftFilter(self.mean + gain @ (value - expected), left)

    def with_independent(self, variance: Array) -> "DriftFilter":
        """Return the filter with one activity more, whose bias is independent of the drift."""
        n = len(self.mean)
        covariance = np.zeros((n + 2, n + 2))
        covariance[:n, :n], covariance[n:, n:] = self.covariance, variance
        return DriftFilter(np.append(self.mean, [0.0, 0.0]), covariance)

    def with_learnt(self, variance: Array) -> "DriftFilter":
        """Return the filter with one activity more, that was told the drift as it is known now."""
        n = len(self.mean)
        told = np.vstack([np.eye(n), np.zeros((2, n))])
        told[n:, :2] = -np.eye(2)
        covariance = told @ self.covariance @ told.T
        covariance[n:, n:] += variance
        return DriftFilter(np.append(self.mean, [0.0, 0.0]), covariance)

    def without(self, index: int) -> "DriftFilter":
        """Return the filter with one activity less."""
        kept = np.delete(np.arange(len(self.mean)), [2 + 2 * index, 3 + 2 * index])
        return DriftFilter(self.mean[kept], self.covariance[np.ix_(kept, kept)])

    def _sight(self, index: int) -> Array:
        sight = np.zeros((2, len(self.mean)))
        sight[:, :2] = sight[:, 2 + 2 * index : 4 + 2 * index] = np.eye(2)
        return sight

    def state(self) -> dict[str, object]:
        """Return all fields as JSON values."""
        return {"mean": self.mean.tolist(), "covariance": self.covariance.tolist()}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> "DriftFilter":
        """Rebuild from `state()`."""
        return cls(np.array(state["mean"]), np.array(state["covariance"]))
