"""A monotone curve applied to every sample: piecewise linear between knots, straight on beyond them."""

from dataclasses import dataclass

import numpy as np

from softcal.core.identity import Settings
from softcal.core.maps.config import CurveConfig
from softcal.core.recording import Array, Arrays
from softcal.core.windows import windows


@dataclass(frozen=True, eq=False)
class CurveMap:
    """source sample = curve(target sample), for every tap alike.

    Args:
        knots: (k,) target outputs, strictly increasing, k >= 2.
        values: (k,) source outputs, monotone.
        family: name under which the catalogue rebuilds it.
    """

    knots: Array
    values: Array
    family: str

    def __call__(self, samples: Array) -> Array:
        """Carry samples of any shape; beyond the knots the curve goes straight on."""
        inside = np.interp(samples, self.knots, self.values)
        if np.min(samples, initial=np.inf) >= self.knots[0] and np.max(samples, initial=-np.inf) <= self.knots[-1]:
            return np.asarray(inside)
        # np.interp holds its last value. A sensor pressed harder than it was calibrated must go on rising.
        slopes = np.diff(self.values) / np.diff(self.knots)
        below = np.minimum(samples - self.knots[0], 0.0) * slopes[0]
        above = np.maximum(samples - self.knots[-1], 0.0) * slopes[-1]
        return np.asarray(inside + below + above)

    def apply(self, windows: Array) -> Array:
        return self(windows)

    def apply_signal(self, signal: Array) -> Array:
        return windows(self(signal))

    def arrays(self) -> Arrays:
        return {"knots": self.knots, "values": self.values}

    def settings(self) -> Settings:
        return {}

    @classmethod
    def from_arrays(cls, arrays: Arrays, settings: Settings, family: str) -> "CurveMap":
        return cls(np.asarray(arrays["knots"], np.float64), np.asarray(arrays["values"], np.float64), family)


def continued(curve: CurveMap, source_span: float, config: CurveConfig) -> CurveMap:
    """Give a curve ends that go on sanely beyond what the unit's recording has shown.

    The slope beyond an end is the mean one of the outer third, held within a factor of two of the whole curve's gain.
    It is drawn to a gain of 1 as the recording covers less of the source's range. The less was seen, the less may
    follow from it. It is written as one far knot at either end.

    Args:
        source_span: robust range of the source's output, same unit as `curve.values`.
    """
    knots, values = curve.knots, curve.values
    if len(knots) < 2:
        return curve
    span = float(knots[-1] - knots[0])
    thirds = np.interp(knots[0] + span * np.array([0.0, 1.0, 2.0, 3.0]) / 3, knots, values)
    gain = max(float(thirds[3] - thirds[0]) / span, 1e-6)
    # Compared in the source's space, where both ranges have one unit.
    covered = min(1.0, float(thirds[3] - thirds[0]) / max(source_span, 1e-300))
    # Over a range that was not seen a slope is as free as the gain of a unit nobody has seen.
    trust = 1 / (1 + (1 - covered) ** 2)
    # Local slopes at the ends are noise; held near the whole gain they cannot run away beyond the recording.
    outer = np.clip(np.array([thirds[1] - thirds[0], thirds[3] - thirds[2]]) * 3 / span, gain / 2, gain * 2)
    # Trust scales the logarithm: no trust gives a gain of 1, whole trust the slope that was seen.
    # Any two places fix a straight line: the far knots lie ten spans away.
    away = 10 * span
    below, above = np.exp(trust * np.log(outer)) * away
    return CurveMap(
        np.concatenate([[knots[0] - away], knots, [knots[-1] + away]]),
        np.concatenate([[values[0] - below], values, [values[-1] + above]]),
        curve.family,
    )
