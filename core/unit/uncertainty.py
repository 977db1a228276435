"""How wrong an estimate may be: the source's residuals by load band and direction, widened by the map's doubt."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.network.network import Network
from softcal.core.recording import Array, Indices
from softcal.core.unit.method import CONFIDENCE, LEVELS, SourceConfig
from softcal.core.unit.support import Support, WindowShape, fit_support

NORMAL_90 = 1.645
"""Half-width of a 90 % interval in standard deviations of a normal distribution."""

DIRECTIONS = ("unloading", "hold", "loading")


@dataclass(frozen=True, eq=False)
class Interval:
    """Half-width of the 90 % interval of an estimate, by direction and load level, and where it stops to hold.

    Args:
        support: where the source's windows lie.
        half_width: (3, LEVELS) in the reference unit; rows as `DIRECTIONS`, columns over [low, high].
        low, high: range of the source's reference.
        slope_limit: signed; slope / slope_limit > 1 is loading, < -1 is unloading, between is hold.
        sensitivity: |dF| in the reference unit per unit of `Support.distance`; widens the interval off support.
        familiar_distance: largest `Support.distance` of a familiar window.
    """

    support: Support
    half_width: Array
    low: float
    high: float
    slope_limit: float
    sensitivity: float
    familiar_distance: float

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

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        support = {f"support_{name}": array for name, array in self.support.arrays().items()}
        return {"half_width": self.half_width, **support}

    def settings(self) -> dict[str, float]:
        numbers = ("low", "high", "slope_limit", "sensitivity", "familiar_distance")
        support = {f"support_{name}": value for name, value in self.support.settings().items()}
        return {name: float(getattr(self, name)) for name in numbers} | support

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> "Interval":
        support = Support.from_arrays(
            {name.removeprefix("support_"): array for name, array in arrays.items()},
            {name.removeprefix("support_"): value for name, value in settings.items()},
        )
        numbers = ("low", "high", "slope_limit", "sensitivity", "familiar_distance")
        half_width = np.asarray(arrays["half_width"], dtype=np.float64)
        return cls(support, half_width, **{name: float(str(settings[name])) for name in numbers})


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


@dataclass(frozen=True, eq=False)
class SourceResiduals:
    """What f itself leaves open on the source: interval and RMS error by direction and load level.

    Args:
        interval: normalised split-conformal 90 % interval (Lei et al. 2018, section 5.2) for the source's windows.
        rmse_table: (3, LEVELS) RMS error, same cells.
        held_out_rmse: on windows that never entered a gradient.
    """

    interval: Interval
    rmse_table: Array
    held_out_rmse: float


def source_residuals(
    network: Network, windows: Array, reference: Array, held_out: Indices, config: SourceConfig
) -> SourceResiduals:
    """Tabulate the residuals of f on its source.

    All windows give the pattern over bands and directions, the held-out ones alone its size.

    Args:
        windows: (n, TAPS) of the source.
        reference: (n,) beside them.
        held_out: indices of windows kept out of the training.
    """
    estimate = network.evaluate(windows)
    # The pattern needs many rows, its size honest ones: trained rows give the first, held-out rows the second.
    residual = estimate - reference
    support = fit_support(windows, network.output_mean, network.output_scale, config)
    shape = support.shape(windows)
    blank = Interval(
        support,
        np.zeros((len(DIRECTIONS), LEVELS)),
        float(reference.min()),
        float(reference.max()),
        slope_limit=_slope_limit(shape, reference, config),
        sensitivity=_sensitivity(network, windows, config.step),
        familiar_distance=float(support.step.max()),
    )
    cells = blank.direction(shape), blank.column(estimate)
    rmse_table = np.sqrt(_tabulate(residual**2, *cells, np.mean, config))
    spread = _tabulate(np.abs(residual), *cells, lambda values: float(np.quantile(values, CONFIDENCE)), config)
    held_direction, held_column = cells[0][held_out], cells[1][held_out]
    # Divided by the local spread, so that one quantile serves quiet and noisy bands alike.
    scores = np.abs(residual[held_out]) / spread[held_direction, held_column]
    held_rmse = float(np.sqrt(np.mean(residual[held_out] ** 2)))
    expected_rmse = float(np.sqrt(np.mean(rmse_table[held_direction, held_column] ** 2)))
    return SourceResiduals(
        replace(blank, half_width=spread * conformal_quantile(scores)),
        rmse_table * held_rmse / expected_rmse,
        held_rmse,
    )


def conformal_quantile(scores: Array) -> float:
    """Return the ceil((n + 1) 0.9)-th smallest of n scores (Lei et al. 2018, algorithm 2); the largest where n < 9."""
    rank = min(int(np.ceil((len(scores) + 1) * CONFIDENCE)), len(scores))
    return float(np.sort(scores)[rank - 1])


def _slope_limit(shape: WindowShape, reference: Array, config: SourceConfig) -> float:
    # On a sensor that falls under load a falling output is loading.
    sign = 1.0 if np.corrcoef(shape.level, reference)[0, 1] >= 0 else -1.0
    return sign * max(config.slope_share * float(np.quantile(np.abs(shape.slope), config.slope_quantile)), 1e-9)


def _sensitivity(network: Network, windows: Array, share: float) -> float:
    step = share * network.output_scale
    # A finite step: the slope of a ReLU network at a point says nothing of its neighbourhood.
    rise = network.evaluate(windows + step) - network.evaluate(windows - step)
    return float(np.sqrt(np.mean((rise / (2 * share)) ** 2)))


def _tabulate(
    values: Array, direction: Indices, column: Indices, statistic: Callable[[Array], float], config: SourceConfig
) -> Array:
    """Return the statistic per direction and band on the (3, LEVELS) grid, sparse cells drawn to their neighbours."""
    bands, prior = config.bands, config.cell_prior
    band = column * bands // LEVELS
    whole = float(statistic(values))
    table = np.empty((len(DIRECTIONS), bands))
    for b in range(bands):
        in_band = band == b
        # From the whole to the band to the cell: a cell with few rows says what its neighbours say.
        level = _shrunk(values[in_band], whole, statistic, prior)
        for d in range(len(DIRECTIONS)):
            table[d, b] = _shrunk(values[in_band & (direction == d)], level, statistic, prior)
    centres = (np.arange(bands) + 0.5) * LEVELS / bands
    table = np.maximum(table, config.least_share * whole + 1e-12)
    return np.stack([np.interp(np.arange(LEVELS) + 0.5, centres, row) for row in table])


def _shrunk(values: Array, expected: float, statistic: Callable[[Array], float], prior: float) -> float:
    if not len(values):
        return expected
    return float((len(values) * statistic(values) + prior * expected) / (len(values) + prior))
