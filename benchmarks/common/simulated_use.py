"""Simulated sensors of several kinds in several uses, for the harm benchmark: no code of softcal's twin in it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from softcal.core.recording import Array

LAG_S, CREEP_S, CREEP = 0.05, 4.0, 0.05
"""Lag of a sensor, and the share of its answer that comes slowly."""

NOISE = 0.004
"""Noise of the output, in shares of its span."""

CURVES: Mapping[str, Callable[[Array], Array]] = {
    "power": lambda load: 0.8 + 0.55 * load**0.85,
    "saturating": lambda load: 0.5 + 1.2 * (1 - np.exp(-1.3 * load)),
    "convex": lambda load: 0.3 + 0.4 * load + 0.4 * load**2,
    "falling": lambda load: 2.5 - 0.9 * load**0.7,
}
"""Output in V over load from 0 to about 1.6."""


@dataclass(frozen=True)
class Style:
    """How an activity is done: height of its loads, duration of its cycles, scatter of both (None: as ever)."""

    load: float = 1.0
    pace: float = 1.0
    scatter: float | None = None


def stance(phase: Array) -> Array:
    """Return the double-humped force of one stride, 1 at its top; stance takes 62 % of it."""
    inside = phase < 0.62
    x = np.where(inside, phase / 0.62, 0.0)
    shape = np.sin(np.pi * x) * (1.0 - 0.45 * np.sin(np.pi * x) ** 8) / 0.86
    return np.where(inside, np.maximum(shape, 0.0), 0.0)


def gait(phase: Array, height: Array) -> Array:
    return height * stance(phase)


def press(phase: Array, height: Array) -> Array:
    """Rest, ramp up, hold, ramp down."""
    return np.asarray(height * np.interp(phase, [0.0, 0.25, 0.4, 0.7, 0.85, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]))


def strain(phase: Array, height: Array) -> Array:
    """A triangle that turns at a preload."""
    return np.asarray(0.2 + 0.8 * height * (1 - np.abs(2 * phase - 1)))


def pump(phase: Array, height: Array) -> Array:
    return np.asarray(height * np.sin(np.pi * phase) ** 2)


Wave = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Activity:
    """A cyclic use: its wave over phase, the duration of a cycle in s, a rate in Hz for it, and its scatter."""

    wave: Wave
    cycle_s: float
    rate_Hz: float
    scatter: float = 0.04


ACTIVITIES: Mapping[str, Activity] = {
    "gait": Activity(gait, 1.1, 50.0),
    "press": Activity(press, 4.0, 25.0),
    "strain": Activity(strain, 20.0, 10.0),
    "pump": Activity(pump, 2.0, 50.0),
}


def cycles(activity: Activity, samples: int, rng: np.random.Generator, style: Style | None = None) -> Array:
    """Return (samples,) loads of an activity, every cycle a little different."""
    style = style or Style()
    scatter = activity.scatter if style.scatter is None else style.scatter
    usual = activity.cycle_s / style.pace * activity.rate_Hz
    count = int(2 * samples / usual) + 2
    lengths = np.maximum(8, usual * (1 + scatter * rng.normal(size=count))).round().astype(int)
    heights = style.load * np.maximum(0.2, 1 + scatter * rng.normal(size=count))
    index = np.repeat(np.arange(count), lengths)[:samples]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    phase = (np.arange(samples) - starts[index]) / lengths[index]
    return np.asarray(activity.wave(phase, heights[index]))


def station(samples: int, rate_Hz: float, rng: np.random.Generator) -> Array:
    """Return (samples,) loads of a compression profile: several depths and rates, holds and rests."""
    knots_s, loads = [0.0], [0.0]
    while knots_s[-1] * rate_Hz < samples:
        depth, ramp_s = rng.uniform(0.3, 1.6), rng.uniform(0.3, 2.5)
        knots_s += (knots_s[-1] + np.cumsum([ramp_s, rng.uniform(0.2, 2.0), ramp_s, rng.uniform(0.3, 2.0)])).tolist()
        loads += [depth, depth, 0.0, 0.0]
    return np.interp(np.arange(samples) / rate_Hz, knots_s, loads)


def read(
    curve: str,
    load: Array,
    rate_Hz: float,
    rng: np.random.Generator,
    gain: Array | float = 1.0,
    shift: Array | float = 0,
) -> Array:
    """Return (n,) output in V of a sensor with lag and creep.

    Args:
        gain, shift: drift of the output, (n,) or constant; the shift in shares of the sensor's span.
    """
    lagged = sum(
        share * lfilter([weight], [1.0, weight - 1.0], load)
        for share, weight in ((1 - CREEP, _weight(LAG_S, rate_Hz)), (CREEP, _weight(CREEP_S, rate_Hz)))
    )
    span = float(np.abs(CURVES[curve](np.ones(1)) - CURVES[curve](np.zeros(1)))[0])
    clean = CURVES[curve](np.maximum(lagged, 0.0))
    return np.asarray(gain * clean + span * (shift + NOISE * rng.normal(size=len(load))))


def _weight(time_s: float, rate_Hz: float) -> float:
    return 1.0 - float(np.exp(-1.0 / (time_s * rate_Hz)))
