"""Any map γ in a small form: a curve on samples with few knots, a mix of shapes on windows.

The form is chosen by its effect: the change of the estimate on the unit's own recording.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from softcal.core.errors import UnitRefused
from softcal.core.export.integer_network import CODE_MAX, MAX_KNOTS, Integers
from softcal.core.export.shape_mix import Mix, fit_mix
from softcal.core.maps.interface import UnitMap
from softcal.core.network.network import Network
from softcal.core.recording import Array, OutputRecording
from softcal.core.windows import TAPS, resting

FINE_KNOTS = 256
"""Knots of the form for machines with floating point (ONNX)."""

GRID = 1024
MARGIN = 0.25
"""A map is compiled this share of the unit's output span beyond it, then constant."""

CLEAR = 0.05
"""A form that deviates by less than this share of the limit is taken at once."""

SHAPES = (5, 6)
"""Shapes of a mix; with 32 knots beside it a file takes at most 512 bytes."""

RIDGE = 1e-6
"""Keeps the affine fit near γ's mean gain where the recording never moved a tap alone."""


@dataclass(frozen=True)
class InputScale:
    """Scale of the 16-bit codes of a device: output = zero + lsb * code."""

    zero: float
    lsb: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.zero) and math.isfinite(self.lsb) and self.lsb > 0):
            raise ValueError(f"input scale zero {self.zero}, lsb {self.lsb}; finite numbers, lsb > 0, were expected")

    def codes(self, output: Array) -> Integers:
        """Return the nearest code of each output, clamped to 0 ... 65535 as by a converter."""
        return np.clip(np.rint((output - self.zero) / self.lsb), 0, CODE_MAX).astype(np.int64)

    def outputs(self, codes: Integers) -> Array:
        return np.asarray(self.zero + self.lsb * codes, dtype=np.float64)

    @classmethod
    def from_converter(cls, bits: int, full_scale: float) -> "InputScale":
        """Codes of an ADC, left-aligned to 16 bits: full_scale / (2^bits - 1) per ADC step."""
        return cls(0.0, full_scale / ((2**bits - 1) * 2 ** (16 - bits)))

    @classmethod
    def cover_range(cls, network: Network, output: Array) -> "InputScale":
        """A round full scale (1, 2 or 5 times a power of ten) that holds source and unit."""
        half_range = 6 * network.output_scale
        low = min(float(output.min()), float(network.output_mean - half_range))
        high = max(float(output.max()), float(network.output_mean + half_range))
        largest = max(abs(low), abs(high))
        decade = 10.0 ** math.floor(math.log10(largest))
        top = next(step * decade for step in (1, 2, 5, 10) if largest <= step * decade * (1 + 1e-12))
        return cls(-top if output.min() < 0 else 0.0, (2 if output.min() < 0 else 1) * top / CODE_MAX)


@dataclass(frozen=True, eq=False)
class Curve:
    """γ sample by sample: monotone and piecewise linear between knots, constant beyond them.

    Args:
        outputs: (k,) target outputs, strictly increasing.
        values: (k,) source outputs, monotone.
    """

    outputs: Array
    values: Array

    def apply(self, windows: Array) -> Array:
        """Carry outputs of any shape."""
        return np.interp(windows, self.outputs, self.values)


@dataclass(frozen=True, eq=False)
class Linear:
    """γ window by window: offset + matrix @ window, the window newest sample last.

    Args:
        matrix: (TAPS, TAPS)
        offset: (TAPS,) in the output unit.
    """

    matrix: Array
    offset: Array

    def apply(self, windows: Array) -> Array:
        return windows @ self.matrix.T + self.offset


@dataclass(frozen=True, eq=False)
class MapForm:
    """A map as a curve on samples, a linear part on windows, or the curve and then the linear part."""

    curve: Curve | None
    linear: Linear | Mix | None = None

    def apply(self, windows: Array) -> Array:
        curved = windows if self.curve is None else self.curve.apply(windows)
        return curved if self.linear is None else self.linear.apply(curved)


@dataclass(frozen=True, eq=False)
class CompiledMap:
    """Device form of γ with its size and error.

    Args:
        rms_deviation, max_deviation: of f after the form against f∘γ, in reference units.
    """

    form: MapForm
    rms_deviation: float
    max_deviation: float


Forms = Callable[[UnitMap, Network, Array, Array], Iterator[MapForm]]
"""Forms of a map, the smallest first, given the unit's windows and their mapped ones."""


def _curves(unit_map: UnitMap, windows: Array, mapped: Array, knots: int = MAX_KNOTS) -> Iterator[MapForm]:
    yield MapForm(_from_constant_windows(unit_map, windows, knots))
    yield MapForm(_from_regression(windows, mapped, knots))


def _bases(
    unit_map: UnitMap, windows: Array, mapped: Array, knots: int, is_regressed: bool = True
) -> Iterator[tuple[Curve, Array]]:
    """Yield the curves that may precede a linear part, each with its windows."""
    if (rescaled := _rescaled_curve(unit_map, windows, mapped, knots)) is not None:
        yield rescaled, rescaled.apply(windows)
    if is_regressed:
        regressed = _from_regression(windows, mapped, knots)
        yield regressed, regressed.apply(windows)


def curve_forms(unit_map: UnitMap, network: Network, windows: Array, mapped: Array) -> Iterator[MapForm]:
    """Yield the forms that fit into 256 bytes: curves."""
    yield from _curves(unit_map, windows, mapped)


def mix_forms(unit_map: UnitMap, network: Network, windows: Array, mapped: Array) -> Iterator[MapForm]:
    """Yield the forms that fit into 512 bytes: curves, then curves with a mix of shapes."""
    yield from _curves(unit_map, windows, mapped)
    for curve, curved in _bases(unit_map, windows, mapped, MAX_KNOTS, is_regressed=False):
        for shapes in SHAPES:
            if (mix := fit_mix(shapes, curved, mapped, network)) is not None:
                yield MapForm(curve, mix)


def matrix_forms(unit_map: UnitMap, network: Network, windows: Array, mapped: Array) -> Iterator[MapForm]:
    """Yield the forms that fit into 1024 bytes: curves, then a curve with a whole matrix."""
    yield from _curves(unit_map, windows, mapped)
    for curve, curved in _bases(unit_map, windows, mapped, MAX_KNOTS):
        yield MapForm(curve, _linear(curved, mapped))


def fine_forms(unit_map: UnitMap, network: Network, windows: Array, mapped: Array) -> Iterator[MapForm]:
    """Yield the forms for floating point, where many knots and a whole matrix cost nothing."""
    yield from _curves(unit_map, windows, mapped, FINE_KNOTS)
    yield MapForm(None, _linear(windows, mapped))
    for curve, curved in _bases(unit_map, windows, mapped, FINE_KNOTS, is_regressed=False):
        yield MapForm(curve, _linear(curved, mapped))


SIZED_FORMS: tuple[Forms, ...] = (curve_forms, mix_forms, matrix_forms)
"""Forms of a map, from those of the smallest file to those of the largest."""


def _rescaled_curve(unit_map: UnitMap, windows: Array, mapped: Array, knots: int) -> Curve | None:
    """The curve of constant windows, drawn to the source's range by the best gain and offset."""
    curve = _from_constant_windows(unit_map, windows, knots)
    curved = curve.apply(windows)
    if np.ptp(curved) <= 1e-9 * np.ptp(mapped):
        return None
    gain, offset = np.polyfit(curved.ravel(), mapped.ravel(), 1)
    return Curve(curve.outputs, offset + gain * curve.values)


def compile_map(
    unit_map: UnitMap,
    network: Network,
    recording: OutputRecording,
    limit: float,
    forms: Forms = mix_forms,
    clear: float = math.inf,
) -> CompiledMap:
    """Compile γ: the first form that is as good as exact, else the nearest in the limit.

    Args:
        recording: the unit's own recording; the deviation is measured on its windows.
        limit: largest rms deviation of the estimate, in the network's reference unit.
        clear: largest deviation of a form that is taken without trying others.

    Raises:
        UnitRefused: no form stays within the limit; the message states the best one's deviation.
    """
    windows = recording.windows
    mapped = unit_map.apply(windows)
    exact = network.evaluate(mapped)
    best: CompiledMap | None = None
    for form in forms(unit_map, network, windows, mapped):
        error = network.evaluate(form.apply(windows)) - exact
        compiled = CompiledMap(form, float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()))
        if compiled.rms_deviation <= CLEAR * limit and compiled.max_deviation <= clear:
            return compiled
        if best is None or compiled.rms_deviation < best.rms_deviation:
            best = compiled
    if best is not None and best.rms_deviation <= limit:
        return best
    smallest = np.inf if best is None else best.rms_deviation
    raise UnitRefused(
        f"map of family {unit_map.family} of unit {recording.serial} has no device form: the best one changes the "
        f"estimate by {smallest:.3g} {network.reference_unit} rms, {limit:.3g} is allowed; calibrate with another map "
        "family or allow more"
    )


def _from_constant_windows(unit_map: UnitMap, windows: Array, knots: int) -> Curve:
    """Read γ off constant windows: exact for every family that works sample by sample."""
    knots_of_map = np.asarray(unit_map.arrays().get("knots", ()), dtype=np.float64)
    grid = _grid(windows)
    breakpoints = np.unique(knots_of_map[(knots_of_map > grid[0]) & (knots_of_map < grid[-1])])
    if 0 < len(breakpoints) <= knots - 2:
        ends = np.concatenate([grid[:1], breakpoints, grid[-1:]])
        values = unit_map.apply(resting(ends))[:, -1]
        if np.array_equal(_monotone(values, np.ones(len(ends))), values):
            return Curve(ends, values)
    values = unit_map.apply(resting(grid))[:, -1]
    return _with_few_knots(grid, _monotone(values, np.ones(len(grid))), windows, knots)


def _from_regression(windows: Array, mapped: Array, knots: int) -> Curve:
    """Return the regression of mapped on raw samples: the best per-sample form of a γ on windows."""
    grid = _grid(windows)
    cell = np.clip(np.searchsorted(grid, windows.ravel()), 0, len(grid) - 1)
    count = np.bincount(cell, minlength=len(grid)).astype(float)
    total = np.bincount(cell, weights=mapped.ravel(), minlength=len(grid))
    has_samples = count > 0
    means = np.interp(grid, grid[has_samples], _monotone(total[has_samples] / count[has_samples], count[has_samples]))
    return _with_few_knots(grid, means, windows, knots)


def _grid(windows: Array) -> Array:
    low, high = float(windows.min()), float(windows.max())
    margin = MARGIN * (high - low) or max(abs(high), 1.0) * 1e-3
    return np.linspace(low - margin, high + margin, GRID)


def _monotone(values: Array, weights: Array) -> Array:
    """Return the nearest rising or falling sequence (pool adjacent violators)."""
    # Imported here: whoever reads a file back does not wait for scipy.
    fits = [
        np.asarray(scipy.optimize.isotonic_regression(values, weights=weights, increasing=rising).x, dtype=np.float64)
        for rising in (True, False)
    ]
    return min(fits, key=lambda fit: float(np.sum(weights * (fit - values) ** 2)))


def _with_few_knots(grid: Array, values: Array, windows: Array, knots: int) -> Curve:
    """Thin a dense curve: add the knot where the error, weighted by use, is largest."""
    density = np.histogram(windows, bins=np.concatenate([grid - (grid[1] - grid[0]) / 2, [np.inf]]))[0]
    weight = 1.0 + np.minimum(density / max(1.0, float(np.quantile(density, 0.9))), 4.0)
    chosen = [0, len(grid) - 1]
    span = float(np.ptp(values))
    while len(chosen) < knots:
        error = weight * np.abs(np.interp(grid, grid[chosen], values[chosen]) - values)
        worst = int(np.argmax(error))
        if error[worst] <= 1e-7 * span:
            break
        chosen = sorted([*chosen, worst])
    return Curve(grid[chosen], values[chosen])


def _linear(windows: Array, mapped: Array) -> Linear:
    """Least squares over the recording, drawn to the mean gain along unseen directions."""
    gain, offset = np.polyfit(windows.ravel(), mapped.ravel(), 1)
    centre = windows.mean(axis=0)
    moved = windows - centre
    residual = mapped - (offset + gain * windows)
    ridge = RIDGE * float(np.mean(moved**2)) * len(windows) * np.eye(TAPS)
    correction = np.linalg.solve(moved.T @ moved + ridge, moved.T @ (residual - residual.mean(axis=0))).T
    matrix = gain * np.eye(TAPS) + correction
    return Linear(matrix, offset + residual.mean(axis=0) - correction @ centre)
