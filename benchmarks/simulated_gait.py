"""A simulated insole sensor on a walking person, for the long-term benchmarks: no code of softcal's twin in it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from softcal.core.recording import Array

RATE_HZ = 50.0
LAG_S = 0.05
NOISE_V = 0.003


@dataclass(frozen=True)
class Drift:
    """What happens to the sensor: functions of time in s; the sensor gives gain x output + offset_V."""

    gain: Callable[[Array], Array] = lambda t_s: np.ones_like(t_s)
    offset_V: Callable[[Array], Array] = lambda t_s: np.zeros_like(t_s)


@dataclass(frozen=True)
class Walk:
    """How the person walks.

    Args:
        body_N: force of a stance.
        stride_s: duration of a stride.
        variation: relative scatter of force and duration from stride to stride.
        pause_every_s: mean time between pauses of standing still; None never stops.
    """

    body_N: float = 2.0
    stride_s: float = 1.1
    variation: float = 0.04
    pause_every_s: float | None = None


def stance(phase: Array) -> Array:
    """Return the double-humped force of one stride, 1 at its top; stance takes 62 % of it."""
    inside = phase < 0.62
    x = np.where(inside, phase / 0.62, 0.0)
    shape = np.sin(np.pi * x) * (1.0 - 0.45 * np.sin(np.pi * x) ** 8) / 0.86
    return np.where(inside, np.maximum(shape, 0.0), 0.0)


def walk(seconds: float, rng: np.random.Generator, style: Walk = Walk()) -> Array:  # noqa: B008 - frozen
    """Return the force of a walk, (n,) in N at `RATE_HZ`."""
    n = round(seconds * RATE_HZ)
    parts: list[Array] = []
    length = 0
    while length < n:
        if style.pause_every_s is not None and rng.random() < style.stride_s / style.pause_every_s:
            part = np.full(round(rng.uniform(5, 30) * RATE_HZ), 0.5 * style.body_N)
        else:
            samples = max(20, round(style.stride_s * (1 + style.variation * rng.normal()) * RATE_HZ))
            height = style.body_N * (1 + style.variation * rng.normal())
            part = height * stance(np.arange(samples) / samples)
        parts.append(part)
        length += len(part)
    return np.concatenate(parts)[:n]


@dataclass
class Sensor:
    """A sensor with lag and a curved characteristic; keeps its state between pieces."""

    rng: np.random.Generator
    drift: Drift = field(default_factory=Drift)
    gain: float = 1.0
    samples: int = 0
    state: Array = field(default_factory=lambda: np.zeros(1))

    def read(self, force_N: Array) -> tuple[Array, Array]:
        """Return t_s and output_V of further samples."""
        t_s = (self.samples + np.arange(len(force_N))) / RATE_HZ
        self.samples += len(force_N)
        weight = 1.0 - np.exp(-1.0 / (LAG_S * RATE_HZ))
        lagged, self.state = lfilter([weight], [1.0, weight - 1.0], force_N, zi=self.state)
        clean = 0.8 + 0.55 * self.gain * np.maximum(lagged, 0.0) ** 0.85
        noise = NOISE_V * self.rng.normal(size=len(force_N))
        return t_s, self.drift.gain(t_s) * clean + self.drift.offset_V(t_s) + noise


def pieces(total: int, size: int) -> Iterator[int]:
    """Yield piece lengths that add up to `total`."""
    for start in range(0, total, size):
        yield min(size, total - start)
