"""The host's clock, and device time to host time: offset and drift from (device, arrival) pairs."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Event

import numpy as np

from softcal.core.recording import Array

CLOCK_SHARE = 0.02
"""A device clock further off than this share is broken, or its rate is declared wrong."""

WRAP_MS = 2**32
"""`millis()` of an Arduino starts again at 0 after 49.7 days."""


class HostClock:
    """The real clock."""

    def now_s(self) -> float:
        # On Linux the monotonic clock leaves out the time a laptop sleeps, and devices go on meanwhile.
        return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()

    def sleep_s(self, seconds: float) -> None:
        time.sleep(max(0.0, seconds))

    def wait(self, event: Event, seconds: float) -> None:
        event.wait(max(0.0, seconds))


@dataclass(frozen=True)
class ClockFit:
    """Linear clock model host_s = offset_s + rate * device_s, with the distribution of line delays.

    Args:
        offset_s: host time at device time 0.
        rate: host seconds per device second; 1 + drift.
        late_s: median delay of a line behind the earliest possible arrival.
        latest_s: the largest such delay.
    """

    offset_s: float
    rate: float
    late_s: float
    latest_s: float

    def to_host(self, device_s: Array) -> Array:
        return self.offset_s + self.rate * device_s


def fit_clock(device_s: Array, host_s: Array) -> ClockFit:
    """Fit offset and drift of a device clock from arrival times that are late by a random amount, never early.

    The line lies under all points and as close to them as it can (least sum of delays): it is the edge of the lower
    convex hull above the mean device time (Moon, Skelly, Towsley, INFOCOM 1999). Bursts and stalls leave it alone.

    Args:
        device_s: (n,) device time stamps, unwrapped, strictly increasing, n >= 2.
    """
    if len(device_s) < 2:
        raise ValueError(f"{len(device_s)} pairs of device and host time; at least 2 are needed")
    # Lists: NumPy's scalars, compared one by one, take four times as long.
    hull = _lower_hull(device_s.tolist(), host_s.tolist())
    middle = float(np.mean(device_s))
    right = int(np.clip(np.searchsorted(device_s[hull], middle), 1, len(hull) - 1))
    a, b = hull[right - 1], hull[right]
    rate = float((host_s[b] - host_s[a]) / (device_s[b] - device_s[a]))
    offset_s = float(host_s[a] - rate * device_s[a])
    late = host_s - (offset_s + rate * device_s)
    return ClockFit(offset_s, rate, float(np.median(late)), float(np.max(late)))


def _lower_hull(x: Sequence[float], y: Sequence[float]) -> list[int]:
    hull: list[int] = []
    for k in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2:]
            if (y[b] - y[a]) * (x[k] - x[a]) < (y[k] - y[a]) * (x[b] - x[a]):
                break  # It turns up.
            hull.pop()
        hull.append(k)
    return hull


def unwrap_ms(previous_ms: int, reported_ms: int) -> int:
    """Return a 32-bit counter of ms, continued past its wrap from the last unwrapped value."""
    step = (reported_ms - previous_ms) % WRAP_MS
    return previous_ms + (step if step < WRAP_MS // 2 else step - WRAP_MS)


def estimate_rate_Hz(device_s: Array) -> float:
    """Return the sample rate of a stream by the device's clock, not counting lost samples.

    A clock of whole milliseconds shows 80 Hz as steps of 12 and 13 ms: their mean is right, no single one is.

    Args:
        device_s: (n,) device time stamps, n >= 2.
    """
    steps = np.sort(device_s[1:] - device_s[:-1])
    # The median by hand: a run asks for this at every sample, and NumPy's general one costs more than all the rest.
    median_s = (steps[(len(steps) - 1) // 2] + steps[len(steps) // 2]) / 2
    return float(1.0 / steps[: np.searchsorted(steps, 1.5 * median_s)].mean())


CHANGE_SAMPLES = 5
MAX_OFFSET_S = 0.5
"""An offset is looked for up to so much, either way."""


def residual_offset_s(leading: Array, following: Array, rate_Hz: float) -> float:
    """Estimate how much later `following` shows the same event as `leading`, from their rates of change.

    Both are differentiated, so that offset and slow drift do not count; the peak of the cross-correlation is refined by
    a parabola. Lag and creep of the sensor are in the estimate too: it is stored beside a recording, never applied.

    Args:
        leading: (n,) signal on a uniform grid.

    Returns:
        Offset in s, positive when `following` is late; NaN where one of them never changes.
    """
    # Changes over some samples: the rate of change with the noise of one sample step would drown it.
    a, b = (signal[CHANGE_SAMPLES:] - signal[:-CHANGE_SAMPLES] for signal in (leading, following))
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    if scale == 0.0:
        return float("nan")
    max_lag = min(int(MAX_OFFSET_S * rate_Hz), len(a) - 1)
    lags = range(-max_lag, max_lag + 1)
    # The sum of a[k]·b[k + lag] over all k where both exist.
    pairs = ((a[max(0, -lag) : len(a) - max(0, lag)], b[max(0, lag) : len(b) - max(0, -lag)]) for lag in lags)
    correlation = np.array([abs(float(np.dot(one, other))) for one, other in pairs]) / scale
    k = int(np.argmax(correlation))
    shift = 0.0
    if 0 < k < len(lags) - 1:
        before, peak, after = correlation[k - 1 : k + 2]
        curvature = before - 2 * peak + after
        shift = 0.5 * float((before - after) / curvature) if curvature else 0.0
    return float((lags[k] + shift) / rate_Hz)
