"""A monotone curve applied to every sample: piecewise linear between knots, straight on beyond them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.recording import Array
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
        slopes = np.diff(self.values) / np.diff(self.knots)
        below = np.minimum(samples - self.knots[0], 0.0) * slopes[0]
        above = np.maximum(samples - self.knots[-1], 0.0) * slopes[-1]
        return np.asarray(inside + below + above)

    def apply(self, windows: Array) -> Array:
        """Carry (n, taps) target windows into the source's window space."""
        return self(windows)

    def apply_signal(self, signal: Array) -> Array:
        """Carry every full window of a gap-free signal: (n - taps + 1, taps)."""
        return windows(self(signal))

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return knots and values."""
        return {"knots": self.knots, "values": self.values}

    def settings(self) -> Settings:
        """Nothing beside the arrays."""
        return {}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]], family: str) -> "CurveMap":
        """Rebuild a curve from its arrays."""
        return cls(np.asarray(arrays["knots"], np.float64), np.asarray(arrays["values"], np.float64), family)


def monotone_curve(knots: Array, values: Array, family: str) -> CurveMap:
    """Make a curve from a cloud of knots: ties are averaged and the values made monotone.

    Args:
        knots: (m,) target outputs in any order.
        values: (m,) source outputs beside them.
    """
    order = np.argsort(knots, kind="stable")
    unique, place = np.unique(knots[order], return_inverse=True)
    means = np.bincount(place, values[order]) / np.bincount(place)
    return CurveMap(unique, np.maximum.accumulate(means), family)
