"""How wrong an estimate may be: the source's residuals by load band and direction, widened by the map's doubt.

The interval grows where a window lies outside the region of window shapes that the source has visited.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softcal.core.identity import Settings
from softcal.core.network.network import CHUNK
from softcal.core.recording import Array, Arrays, Indices
from softcal.core.unit.method import LEVELS
from softcal.core.windows import TAPS

NORMAL_90 = 1.645
"""Half-width of a 90 % interval in standard deviations of a normal distribution."""

DIRECTIONS = ("unloading", "hold", "loading")
_OF_SUPPORT = "support_"
"""Begins the names of a support's fields among those of its interval, as a calibration keeps them."""


def _polynomials() -> Array:
    """Return level, slope and bend of a window as (TAPS, 3) orthogonal columns whose coefficients are RMS values."""
    columns = np.vander(np.linspace(-1, 1, TAPS), 3, increasing=True)
    # Signs of a QR are arbitrary; positive diagonals make slope mean rising everywhere.
    basis, triangular = np.linalg.qr(columns)
    return np.asarray(basis * np.sign(np.diag(triangular)) / np.sqrt(TAPS))


BASIS = _polynomials()


@dataclass(frozen=True, eq=False)
class WindowShape:
    """What a window looks like, in standard deviations of the source's output (RMS over the taps).

    Args:
        slope: (n,) linear part, positive when the newest samples are the highest.
        curvature: (n,) quadratic part.
        roughness: (n,) what neither explains: noise, steps, fast dynamics.
    """

    level: Array
    slope: Array
    curvature: Array
    roughness: Array


@dataclass(frozen=True, eq=False)
class Support:
    """The region of window shapes the source has visited: a map of distances over level and slope, bounds on the rest.

    Args:
        output_mean, output_scale: standardise windows in the source's space, as the network does.
        origin, step: (2,) lower edge and cell size of the grid over (level, slope).
        distance_grid: (levels, slopes) distance of each cell to the nearest visited one; 0 where visited.
        curvature_limit, roughness_limit: largest familiar values.
    """

    output_mean: float
    output_scale: float
    origin: Array
    step: Array
    distance_grid: Array
    curvature_limit: float
    roughness_limit: float

    def shape(self, windows: Array) -> WindowShape:
        """Describe (n, TAPS) windows in the source's space, newest sample last."""
        level, slope, curvature, roughness = (np.empty(len(windows)) for _ in range(4))
        for start in range(0, len(windows), CHUNK):
            rows = slice(start, start + CHUNK)
            z = ((windows[rows] - self.output_mean) / self.output_scale).astype(np.float32)
            parts = z @ BASIS.astype(np.float32)
            level[rows], slope[rows], curvature[rows] = parts.T
            # Pythagoras instead of the residual itself: no second (n, TAPS) array is made.
            residual = np.einsum("ij,ij->i", z, z) / TAPS - np.einsum("ij,ij->i", parts, parts)
            roughness[rows] = np.sqrt(np.maximum(residual, 0))
        return WindowShape(level, slope, curvature, roughness)

    def distance(self, shape: WindowShape) -> Array:
        """Return how far each window lies outside the source's support, in the units of `WindowShape`; 0 inside."""
        row, beyond_level = _cell(shape.level, self.origin[0], self.step[0], self.distance_grid.shape[0])
        column, beyond_slope = _cell(shape.slope, self.origin[1], self.step[1], self.distance_grid.shape[1])
        parts = (
            self.distance_grid[row, column],
            beyond_level,
            beyond_slope,
            np.maximum(np.abs(shape.curvature) - self.curvature_limit, 0),
            np.maximum(shape.roughness - self.roughness_limit, 0),
        )
        return np.sqrt(sum((part * part for part in parts), start=np.zeros(len(shape.level))))


def _cell(value: Array, origin: float, step: float, cells: int) -> tuple[Indices, Array]:
    """Return the cell each value falls in, the outermost one beyond the grid, and how far beyond its middle it is."""
    position = (value - origin) / step
    # Off the grid the distance goes on in a straight line from its outermost cell.
    inside = np.clip(position, 0.5, cells - 0.5)
    return inside.astype(np.int64), np.abs(position - inside) * step


@dataclass(frozen=True, eq=False)
class Interval:
    """Half-width of the 90 % interval of an estimate, by direction and load level, and where it stops to hold.

    Args:
        half_width: (3, LEVELS) in the reference unit; rows as `DIRECTIONS`, columns over [low, high].
        low, high: range of the source's reference.
        slope_limit: signed; slope / slope_limit > 1 is loading, < -1 is unloading, between is hold.
        sensitivity: |dF| in the reference unit per unit of `Support.distance`; widens the interval off support.
    """

    support: Support
    half_width: Array
    low: float
    high: float
    slope_limit: float
    sensitivity: float
    familiar_distance: float

    @property
    def levels(self) -> Array:
        """Middle of each load level: (LEVELS,) in the reference unit."""
        return self.low + (np.arange(LEVELS) + 0.5) * (self.high - self.low) / LEVELS

    def direction(self, shape: WindowShape) -> Indices:
        """Return 0 unloading, 1 hold, 2 loading for each window."""
        ratio = shape.slope / self.slope_limit
        return 1 + (ratio > 1).astype(np.int64) - (ratio < -1)

    def column(self, estimate: Array) -> Indices:
        """Return the column of `half_width` for each estimate; beyond the range the last one."""
        position = (estimate - self.low) * (LEVELS / (self.high - self.low))
        return np.clip(position, 0, LEVELS - 1).astype(np.int64)

    def half(self, estimate: Array, shape: WindowShape, distance: Array) -> Array:
        """Return the half-width of the 90 % interval of each estimate, (n,) in the reference unit."""
        inside = self.half_width[self.direction(shape), self.column(estimate)]
        # Beyond the range nothing was measured: there the interval grows by the distance itself.
        outside = np.maximum(np.maximum(self.low - estimate, estimate - self.high), 0)
        return inside + NORMAL_90 * self.sensitivity * distance + outside

    def widened(self, variance: Array) -> "Interval":
        """Return the interval with (3, LEVELS) variance of the map added in quadrature."""
        return replace(self, half_width=np.sqrt(self.half_width**2 + NORMAL_90**2 * variance))

    def arrays(self) -> Arrays:
        return {name: value for name, value in self._values().items() if isinstance(value, np.ndarray)}

    def settings(self) -> dict[str, float]:
        return {name: float(value) for name, value in self._values().items() if not isinstance(value, np.ndarray)}

    def _values(self) -> dict[str, Any]:
        support = {f"{_OF_SUPPORT}{name}": value for name, value in vars(self.support).items()}
        return {name: value for name, value in vars(self).items() if name != "support"} | support

    @classmethod
    def from_arrays(cls, arrays: Arrays, settings: Settings) -> "Interval":
        """Read what `arrays` and `settings` gave."""
        values: dict[str, Any] = {name: np.asarray(array, np.float64) for name, array in arrays.items()}
        values |= {name: float(str(number)) for name, number in settings.items()}
        of_support = [name for name in values if name.startswith(_OF_SUPPORT)]
        support = Support(**{name.removeprefix(_OF_SUPPORT): values.pop(name) for name in of_support})
        return cls(support=support, **values)


@dataclass(frozen=True)
class IntervalInflation:
    """What becomes of an interval's half-width h, in the reference unit: sqrt((scale h)^2 + added^2)."""

    scale: float = 1.0
    added: float = 0.0

    def __call__(self, half: Array) -> Array:
        return np.hypot(self.scale * half, self.added)


@dataclass(frozen=True)
class ErrorForecast:
    """The RMSE a unit will show against a reference, forecast without one.

    Args:
        rmse: best estimate, in the reference unit.
        lower, upper: its 95 % interval (k = 2), so that upper - rmse and rmse - lower are the guard bands.
    """

    rmse: float
    lower: float
    upper: float
