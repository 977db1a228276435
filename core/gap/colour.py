"""Noise that is not white: a part that fades beside a white one, found by likelihood.

The fading part is a first-order process, correlation exp(−t/τ). A Kalman filter turns the sum into
independent values of variance 1; it is the exact likelihood, for any step of time and with samples
left out (Brockwell and Davis, Time Series: Theory and Methods, 2nd ed. 1991, ch. 12).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from softcal.core.recording import Array
from softcal.core.settings import setting
from softcal.core.twin.signals import compiled

COMMON_STEP_s = 0.02
"""Time between two samples of a common rig."""


@dataclass(frozen=True)
class Colour:
    """The part of a channel's noise that fades: its SD, and the time to a correlation of 1/e."""

    spread: float
    fading_s: float

    def slow_variance(self, step_s: float) -> float:
        """Return the variance of white noise that is as strong as this one near zero frequency."""
        keep = float(np.exp(-step_s / self.fading_s))
        return float(self.spread**2 * (1.0 + keep) / (1.0 - keep))


@dataclass(frozen=True, eq=False)
class Stretch:
    """A residual of one channel of one run, or a part: (n,) each; `use` is 1 where a sample counts."""

    error: Array
    step_s: Array
    use: Array


@dataclass(frozen=True)
class Noise:
    """White and fading noise of one channel; `gain` is log likelihood above white noise alone."""

    white: float
    colour: Colour
    log_likelihood: float
    gain: float


@dataclass(frozen=True)
class ColourConfig:
    """How noise is read from a residual.

    Args:
        shortest_s, longest_s: fading times that are told from white noise and from a drift. Load cells
            filter over 0.05–2 s; a room wanders over minutes.
        ratios, fading_s: where the search begins: one start per decade of what a rig shows.
        gain: log likelihood to be gained by a fading part; two parameters pay ln(n) ≈ 9 at n = 8,000.
    """

    shortest_s: float = setting(0.04)
    longest_s: float = setting(6.0)
    ratios: tuple[float, ...] = setting((0.3, 1.0, 3.0))
    fading_s: tuple[float, ...] = setting((0.1, 0.4, 1.6))
    gain: float = setting(12.0)

    def slower(self, times: float) -> "ColourConfig":
        """Return the same for a rig that is so many times slower than a common one."""
        fading_s = tuple(times * tau_s for tau_s in self.fading_s)
        return replace(self, shortest_s=times * self.shortest_s, longest_s=times * self.longest_s, fading_s=fading_s)


def read_noise(stretches: Sequence[Stretch], config: ColourConfig) -> Noise:
    """Return the likeliest noise; the white part sets the scale: two numbers are searched for."""
    error, step_s, use = (np.concatenate([getattr(s, name) for s in stretches]) for name in ("error", "step_s", "use"))
    begins = np.zeros(len(error))
    begins[np.cumsum([0, *(len(s.error) for s in stretches)])[:-1]] = 1.0
    count = max(float(use.sum()), 1.0)

    def scale(ratio: float, fading_s: float) -> tuple[float, float]:
        squares, log_det = _likelihood(error, step_s, use, begins, ratio, fading_s)
        variance = max(squares / count, 1e-300)
        return variance, -0.5 * (count * (1.0 + float(np.log(variance))) + log_det)

    def lost(x: Array) -> float:
        outside = max(np.log(config.shortest_s) - x[1], x[1] - np.log(config.longest_s), 0.0)
        held = float(np.exp(np.clip(x[1], np.log(config.shortest_s), np.log(config.longest_s))))
        return float(count * outside**2 - scale(float(np.exp(x[0])), held)[1])

    starts = [np.log([ratio, fading_s]) for ratio in config.ratios for fading_s in config.fading_s]
    start = min(starts, key=lost)
    # Half a natural logarithm: less than the distance of two starts.
    simplex = start + 0.5 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"xatol": 0.02, "fatol": 0.05, "initial_simplex": simplex}
    minimum = minimize(lost, start, method="Nelder-Mead", options=options)
    ratio, fading_s = float(np.exp(minimum.x[0])), float(np.exp(minimum.x[1]))
    fading_s = float(np.clip(fading_s, config.shortest_s, config.longest_s))
    variance, log_likelihood = scale(ratio, fading_s)
    white = float(np.sqrt(variance))
    alone = scale(0.0, 1.0)[1]
    return Noise(white, Colour(ratio * white, fading_s), log_likelihood, log_likelihood - alone)


def log_likelihood(stretches: Sequence[Stretch], white: float, colour: Colour) -> float:
    """Return the log likelihood of stretches under noise that is given."""
    total = 0.0
    for s in stretches:
        begins = np.zeros(len(s.error))
        begins[:1] = 1.0
        squares, log_det = _likelihood(s.error, s.step_s, s.use, begins, colour.spread / white, colour.fading_s)
        total -= 0.5 * (squares / white**2 + log_det + float(s.use.sum()) * 2.0 * float(np.log(white)))
    return total


@compiled
def _likelihood(
    error: Array, step_s: Array, use: Array, begins: Array, ratio: float, fading_s: float
) -> tuple[float, float]:
    """Return Σ e²/S and Σ ln S of innovations; white noise has variance 1, the other `ratio`²."""
    squares, log_det = 0.0, 0.0
    level = ratio * ratio
    mean, variance = 0.0, level
    for k in range(len(error)):
        if begins[k] > 0.0:
            mean, variance = 0.0, level
        else:
            keep = np.exp(-step_s[k] / fading_s)
            mean, variance = keep * mean, keep * keep * variance + level * (1.0 - keep * keep)
        if use[k] > 0.0:
            total = variance + 1.0
            off = error[k] - mean
            squares += off * off / total
            log_det += np.log(total)
            mean += variance / total * off
            variance -= variance * variance / total
    return squares, log_det


@compiled
def filter_of(noise: Array, use: Array, step_s: Array, spread: float, fading_s: float) -> Array:
    """Return (3, n): what the filter keeps of its state, takes of an innovation, divides it by."""
    out = np.zeros((3, len(noise)))
    variance = spread * spread
    for k in range(len(noise)):
        keep = np.exp(-step_s[k] / fading_s) if k > 0 else 0.0
        if k > 0:
            variance = keep * keep * variance + spread * spread * (1.0 - keep * keep)
        out[0, k] = keep
        if use[k] > 0.0:
            total = variance + noise[k] * noise[k]
            out[1, k], out[2, k] = variance / total, 1.0 / np.sqrt(total)
            variance -= variance * variance / total
    return out


@compiled
def filtered(values: Array, steps: Array) -> Array:
    """Return (n,) innovations over their standard deviation; 0 where a sample is left out."""
    out = np.empty(len(values))
    mean = 0.0
    for k in range(len(values)):
        mean = steps[0, k] * mean
        off = values[k] - mean
        out[k] = off * steps[2, k]
        mean += steps[1, k] * off
    return out
