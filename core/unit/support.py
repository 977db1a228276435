"""Where the source's windows lie, and how far another window is from there."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.network.network import CHUNK
from softcal.core.recording import Array, Indices
from softcal.core.unit.method import SourceConfig
from softcal.core.windows import TAPS


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
        level: (n,) mean.
        slope: (n,) linear part, positive when the newest samples are the highest.
        bend: (n,) quadratic part.
        roughness: (n,) what neither explains: noise, steps, fast dynamics.
    """

    level: Array
    slope: Array
    bend: Array
    roughness: Array


@dataclass(frozen=True, eq=False)
class Support:
    """The region of window shapes the source has visited: a map of distances over level and slope, bounds on the rest.

    Args:
        output_mean, output_scale: standardise windows in the source's space, as the network does.
        origin, step: (2,) lower edge and cell size of the grid over (level, slope).
        distance_grid: (levels, slopes) distance of each cell to the nearest visited one; 0 where visited.
        bend_limit, roughness_limit: largest familiar values.
    """

    output_mean: float
    output_scale: float
    origin: Array
    step: Array
    distance_grid: Array
    bend_limit: float
    roughness_limit: float

    def shape(self, windows: Array) -> WindowShape:
        """Describe (n, TAPS) windows in the source's space, newest sample last."""
        level, slope, bend, roughness = (np.empty(len(windows)) for _ in range(4))
        for start in range(0, len(windows), CHUNK):
            rows = slice(start, start + CHUNK)
            z = ((windows[rows] - self.output_mean) / self.output_scale).astype(np.float32)
            parts = z @ BASIS.astype(np.float32)
            level[rows], slope[rows], bend[rows] = parts.T
            # Pythagoras instead of the residual itself: no second (n, TAPS) array is made.
            left = np.einsum("ij,ij->i", z, z) / TAPS - np.einsum("ij,ij->i", parts, parts)
            roughness[rows] = np.sqrt(np.maximum(left, 0))
        return WindowShape(level, slope, bend, roughness)

    def distance(self, shape: WindowShape) -> Array:
        """Return how far each window lies outside the source's support, in the units of `WindowShape`; 0 inside."""
        row, beyond_level = _cell(shape.level, self.origin[0], self.step[0], self.distance_grid.shape[0])
        column, beyond_slope = _cell(shape.slope, self.origin[1], self.step[1], self.distance_grid.shape[1])
        parts = (
            self.distance_grid[row, column],
            beyond_level,
            beyond_slope,
            np.maximum(np.abs(shape.bend) - self.bend_limit, 0),
            np.maximum(shape.roughness - self.roughness_limit, 0),
        )
        return np.sqrt(sum((part * part for part in parts), start=np.zeros(len(shape.level))))

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        return {"origin": self.origin, "step": self.step, "distance_grid": self.distance_grid}

    def settings(self) -> dict[str, float]:
        return {
            "output_mean": self.output_mean,
            "output_scale": self.output_scale,
            "bend_limit": self.bend_limit,
            "roughness_limit": self.roughness_limit,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> "Support":
        origin, step, grid = (np.asarray(arrays[n], dtype=np.float64) for n in ("origin", "step", "distance_grid"))
        names = ("output_mean", "output_scale", "bend_limit", "roughness_limit")
        mean, scale, bend_limit, roughness_limit = (float(str(settings[name])) for name in names)
        return cls(mean, scale, origin, step, grid, bend_limit, roughness_limit)


def _cell(value: Array, origin: float, step: float, cells: int) -> tuple[Indices, Array]:
    """Return the cell each value falls in, the outermost one beyond the grid, and how far beyond its middle it is."""
    position = (value - origin) / step
    # Off the grid the distance goes on in a straight line from its outermost cell.
    inside = np.clip(position, 0.5, cells - 0.5)
    return inside.astype(np.int64), np.abs(position - inside) * step


def fit_support(windows: Array, output_mean: float, output_scale: float, config: SourceConfig) -> Support:
    """Find the support of the source's windows.

    Args:
        windows: (n, TAPS) of the source, newest sample last.
        output_mean, output_scale: standardisation of the network.
        config: grid and margins.
    """
    blank = Support(output_mean, output_scale, np.zeros(2), np.ones(2), np.zeros((1, 1)), np.inf, np.inf)
    shape = blank.shape(windows)
    position = np.stack([shape.level, shape.slope], axis=1)
    low, span = position.min(axis=0), np.maximum(np.ptp(position, axis=0), 1e-6)
    origin, cells = low - config.margin * span, np.array([config.level_cells, config.slope_cells])
    step = (1 + 2 * config.margin) * span / cells
    index = ((position - origin) / step).astype(np.int64)
    empty = np.ones(cells, dtype=bool)
    empty[index[:, 0], index[:, 1]] = False
    # scipy.ndimage takes a second to load: a registry that lists calibrations needs none of it.
    from scipy.ndimage import distance_transform_edt

    slack = config.slack_cells * float(step.max())
    # Cells beside visited ones are familiar too: samples never fill every cell.
    distance = np.maximum(distance_transform_edt(empty, sampling=step) - slack, 0)
    # A factor on a quantile: the maximum of a recording is set by its worst sample.
    bend_limit = config.tail_factor * float(np.quantile(np.abs(shape.bend), config.tail))
    roughness_limit = config.tail_factor * float(np.quantile(shape.roughness, config.tail))
    return Support(output_mean, output_scale, origin, step, distance, bend_limit, roughness_limit)
