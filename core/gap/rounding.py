"""An ADC that is coarse against its noise: the mean of its codes is a soft staircase of the clean output.

With noise σ before a rounding to steps q, E[round(V + n)] = V + Σ (−1)ᵏ·q/(πk)·sin(2πkV/q)·exp(−2(πkσ/q)²), and the
variance around that mean, averaged over V, is σ² + q²/12 − Σ q²/(2π²k²)·exp(−(2πkσ/q)²) (Widrow and Kollár,
Quantization Noise, 2008). From σ = 0.45 q on the stairs are below 1 % of a step.
"""

import numpy as np
from scipy.optimize import brentq

from softcal.core.recording import Array
from softcal.core.twin.signals import compiled

SMOOTH = 0.45
"""Noise, in steps, from which the staircase is a straight line."""

SHARPEST = 0.05
"""Least noise, in steps, that is told apart: sharper stairs than that have no slope to fit by."""

HARMONICS = 12


def dither_V(sigma_V: float, step_V: float) -> float | None:
    """Return the noise before the ADC from that of its codes around their mean, None where the stairs are smooth."""
    target = (sigma_V / step_V) ** 2
    if target >= _variance(SMOOTH):
        return None
    if target <= _variance(SHARPEST):
        return SHARPEST * step_V
    return step_V * float(brentq(lambda noise: _variance(noise) - target, SHARPEST, SMOOTH))


def _variance(noise: float) -> float:
    """Return the variance of the codes in steps², for noise in steps."""
    k = np.arange(1, 40)
    return float(noise**2 + 1 / 12 - np.sum(np.exp(-((2 * np.pi * k * noise) ** 2)) / (2 * np.pi**2 * k**2)))


@compiled
def mean_code_V(clean_V: Array, noise_V: float, step_V: float) -> Array:
    """Return the mean of the codes, (n,) V, for a clean output and noise before the ADC."""
    out = clean_V.copy()
    for k in range(1, HARMONICS + 1):
        height = step_V / (np.pi * k) * np.exp(-2.0 * (np.pi * k * noise_V / step_V) ** 2)
        # Higher harmonics die out faster than exponentially: the rest is below a ten-thousandth of a step.
        if height < 1e-4 * step_V:
            break
        height = -height if k % 2 else height
        for i in range(len(out)):
            out[i] += height * np.sin(2.0 * np.pi * k * clean_V[i] / step_V)
    return out
