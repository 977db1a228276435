"""The force as the driver of the chain where no stage position was recorded: its noise must not drive the channel.

A prediction from a noisy force improves with anything that smooths it, a lag or a clipped floor, so the force is
smoothed first, as far as that leaves its corners where they are.
"""

from dataclasses import dataclass

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.signals import compiled

HALF_WIDTH = 4
"""Samples on either side that a straight line is fitted to: 0.18 s at 50 Hz."""


@dataclass(frozen=True, eq=False)
class DrivingForce:
    """A measured force made ready to drive the chain.

    Args:
        force_N: (n,) smoothed.
        sigma_N: (n,) standard deviation of the noise that is left.
    """

    force_N: Array
    sigma_N: Array


def driving_force(measured_N: Array) -> DrivingForce:
    """Smooth a measured force by straight lines: centred where one fits, else from one side."""
    sigma_N = force_noise(measured_N)
    smooth_N, share = straightened(measured_N, sigma_N, HALF_WIDTH)
    return DrivingForce(smooth_N, sigma_N * np.sqrt(share))


def force_noise(force_N: Array) -> float:
    """Return σ of a measured force from its second differences; a straight ramp does not enter."""
    squares = np.sort(np.diff(force_N, 2) ** 2 / 6)
    # A Gaussian without its largest 20 % of squares keeps 0.438 of its variance.
    return float(np.sqrt(np.mean(squares[: max(1, int(0.8 * len(squares)))]) / 0.438))


@compiled
def straightened(signal: Array, sigma: float, half: int) -> tuple[Array, Array]:
    """Return the smoothed signal and, per sample, which share of the noise variance is left."""
    out, share = signal.copy(), np.ones(len(signal))
    for k in range(len(signal)):
        # A line that leaves more than twice the noise's variance lies across a bend: the sample stays as it is.
        best = 2.0 * sigma * sigma
        # Centred first, for it takes the most noise off; one-sided lines keep corners where they are.
        for first, last in ((k - half, k + half), (k - half, k), (k, k + half)):
            if first < 0 or last >= len(signal):
                continue
            count = last - first + 1
            middle = 0.5 * (first + last)
            spread = count * (count * count - 1.0) / 12.0
            mean, slope = 0.0, 0.0
            for j in range(first, last + 1):
                mean += signal[j] / count
                slope += (j - middle) * signal[j] / spread
            left = 0.0
            for j in range(first, last + 1):
                left += (signal[j] - mean - slope * (j - middle)) ** 2
            if left / (count - 2.0) < best:
                out[k] = mean + slope * (k - middle)
                share[k] = 1.0 / count + (k - middle) ** 2 / spread
                break
    return out, share
