"""A few known loads on the unit refine any map."""

from dataclasses import dataclass

import numpy as np
import scipy

from softcal.core.errors import InputError
from softcal.core.identity import Settings
from softcal.core.maps.config import AnchorConfig, MapConfig
from softcal.core.maps.interface import Anchors, FitProblem, UnitMap
from softcal.core.metrics import rms
from softcal.core.recording import Array, Arrays, LabelledRecording
from softcal.core.windows import TAPS, resting


@dataclass(frozen=True, eq=False)
class AnchoredMap:
    """A map followed by a gain and an offset, in the source's output unit, that known loads asked for."""

    inner: UnitMap
    gain: float
    offset: float

    @property
    def family(self) -> str:
        return self.inner.family

    def apply(self, windows: Array) -> Array:
        return self.offset + self.gain * self.inner.apply(windows)

    def apply_signal(self, signal: Array) -> Array:
        return self.offset + self.gain * self.inner.apply_signal(signal)

    def arrays(self) -> Arrays:
        line = {"anchor_gain": np.array(self.gain), "anchor_offset": np.array(self.offset)}
        return {**self.inner.arrays(), **line}

    def settings(self) -> Settings:
        return self.inner.settings()


@dataclass(frozen=True, eq=False)
class Anchoring:
    """What known loads made of a map, and how well they fix it.

    Args:
        gain_error: standard uncertainty of the gain, as a share of it.
        rest_error: the same of the level at rest, in the source's output unit.
        misfit: RMS distance of the loads from the source's levels after the fit, in standard uncertainties.
    """

    unit_map: AnchoredMap
    gain_error: float
    rest_error: float
    misfit: float


def refine(problem: FitProblem, unit_map: UnitMap, anchors: Anchors, kind: str) -> Anchoring:
    """Correct gain and level of a map so that the unit under a known load looks like the source under it.

    Minimises sum ((x_k - y_0 - a - e^b (y_k - y_0)) / sigma_k)^2 + (a / s_level)^2 + (b / s_gain)^2: x_k is what the
    map makes of the output at rest under load k, y_k and sigma_k are level and spread of the source's own visits to
    that load, y_0 is its level at rest, s_level and s_gain are how far the map may be off before any load is seen. What
    was read is regressed on what is known, and the line inverted: y = y_0 + (x - y_0 - a) e^-b. So a load at zero moves
    the level alone, however far the map is off there, and several fix both numbers.

    f is left out on purpose: it misreads a load at rest by its own error, and where it is flat no gain or offset of
    any size would make it read the load. A map from pairs was fitted behind f and differs from the source's levels by
    what f misreads at rest: there that is in sigma_k, and the map is left as it is unless the loads contradict it. Of
    what K loads ask for a part 1 - K / sum z_k^2 is taken, with z_k = (x_k - y_k) / sigma_k: none of what the errors
    explain (James and Stein 1961, positive part). So loads that were read in motion, whose scatter is that of sigma_k,
    change little.

    Args:
        kind: how its loads are known: `paired`, `stage`, or empty for anything else (`core/unit/correspondence.py`).
    """
    config, source = problem.config.anchors, problem.source
    low, high = np.quantile(source.unlabelled.output, problem.config.crossing.robust_range)
    rest, _ = source_level(source, float(source.reference.min()), config)
    spreads = {name: (gain, level) for name, gain, level in config.spread}
    # Pairs pressed with another load than the source's know the gain no better than the output alone does.
    spread, (gain_spread, share) = spreads[""][0], spreads[kind]
    level = share * float(high - low)
    mapped = unit_map.apply(resting(np.asarray(anchors.output, np.float64))).mean(axis=1)
    expected, sigma = np.array([source_level(source, load, config) for load in anchors.reference]).T
    if kind:
        misread = problem.network.evaluate(resting(expected)) - anchors.reference
        sigma = np.hypot(sigma, misread * _mean_slope(source))
    shrinkage = 1.0 - expected.size / max(float(np.sum(((mapped - expected) / sigma) ** 2)), expected.size)
    size, scale = np.array([spread, level]), np.array([gain_spread, level])

    def misses(theta: Array) -> Array:
        """Return what the loads miss the line by, and the unknowns: in standard deviations, all of them."""
        log_gain, move = size * theta
        return np.append((mapped - rest - move - np.exp(log_gain) * (expected - rest)) / sigma, theta)

    solution = scipy.optimize.least_squares(misses, np.zeros(2), method="lm")
    log_gain, move = shrinkage * size * solution.x
    gain = float(np.exp(-log_gain))
    offset = rest - gain * (rest + float(move))
    misfit = rms((offset + gain * mapped - expected) / sigma)
    # Loads that do not fit a gain and an offset know neither better than they fit.
    variance = np.diag(np.linalg.inv(solution.jac.T @ solution.jac)) * max(misfit, 1.0) ** 2
    # The level counts where the map is now: behind the gain.
    gain_error, rest_error = np.sqrt(shrinkage * variance * size**2 + (1.0 - shrinkage) * scale**2) * [1.0, gain]
    return Anchoring(AnchoredMap(unit_map, gain, offset), float(gain_error), float(rest_error), misfit)


def _mean_slope(source: LabelledRecording) -> float:
    return float(np.ptp(source.unlabelled.output) / np.ptp(source.reference))


def source_level(source: LabelledRecording, load: float, config: AnchorConfig) -> tuple[float, float]:
    """Return the source's output under a load, and its standard uncertainty, both in the source's output unit.

    A straight line through the samples whose load is near. How far the means of single visits to that load scatter
    about it is what lag, loop and drift of the source do not settle; noise averages out over a visit.
    """
    away = source.reference - load
    span = float(np.ptp(source.reference))
    within = np.count_nonzero(np.abs(away) <= config.near * span)
    # Thirty samples hold a straight line and their scatter.
    near = np.sort(np.argsort(np.abs(away), kind="stable")[: max(within, 30)])
    slope, level = np.polyfit(away[near], source.unlabelled.output[near], 1)
    rest = source.unlabelled.output[near] - level - slope * away[near]
    # Samples that a window holds together are of one visit.
    visit = np.cumsum(np.diff(near, prepend=near[0]) > TAPS)
    count = np.bincount(visit)
    means = np.bincount(visit, rest) / count
    # One visit shows no other; its samples stand for what it cannot show.
    scatter = float(np.sqrt(np.average(means**2, weights=count))) if len(count) > 1 else float(np.std(rest))
    # A load is known to so much only: a source that repeats well must not make two anchors overrule a good map.
    return float(level), float(np.hypot(scatter, config.load_error * span * _mean_slope(source)))


@dataclass(frozen=True, eq=False)
class SourceLevels:
    """What a source puts out at rest under (k,) loads, evenly spaced and rising: a straight line between neighbours."""

    load: Array
    output: Array

    def at(self, load: Array) -> Array:
        """Return the output under loads within the table."""
        return np.interp(load, self.load, self.output)

    @classmethod
    def from_source(cls, source: LabelledRecording, config: AnchorConfig) -> "SourceLevels":
        """Take them from a recording, and two more at each end, where its line goes on."""
        count = config.levels
        low, high = float(source.reference.min()), float(source.reference.max())
        step = (high - low) / (count - 1)
        load = low + step * np.arange(-2.0, count + 2)
        inside = load[2:-2]
        distance = np.array([np.min(np.abs(source.reference - one)) for one in inside])
        # A source that was held at a few loads shows nothing between them.
        visited = inside[distance <= config.near * (high - low)]
        output = np.interp(inside, visited, [source_level(source, one, config)[0] for one in visited])
        first, last = output[0] - output[1], output[-1] - output[-2]
        before, after = output[0] + first * np.array([2.0, 1.0]), output[-1] + last * np.array([1.0, 2.0])
        return cls(load, np.concatenate([before, output, after]))


def source_curvature(source: LabelledRecording, config: MapConfig) -> float:
    """Return how far the source's output over load is from a straight line, RMS, as a share of its rise."""
    low, high = np.quantile(source.reference, config.curve.shares)
    loads = np.linspace(float(low), float(high), config.anchors.levels // 2 + 1)
    levels = np.array([source_level(source, float(load), config.anchors)[0] for load in loads])
    chord = levels[0] + (levels[-1] - levels[0]) * (loads - low) / (high - low)
    return rms((levels - chord)[1:-1]) / max(abs(float(levels[-1] - levels[0])), 1e-12)


def check_values(source: LabelledRecording, load: Array, nothing: str, config: AnchorConfig) -> None:
    """Refuse known loads, whatever was read under them, that are out of the source's range, or one twice.

    Args:
        load: (k,) in the source's reference unit.
        nothing: what was not done, the end of the message.

    Raises:
        InputError: which row is wrong, what was expected, and that nothing was changed.
    """
    unit = source.reference_unit
    low, high = float(source.reference.min()), float(source.reference.max())
    margin = config.beyond * (high - low)
    for row, value in enumerate(load, start=1):
        if not low - margin <= value <= high + margin:
            raise InputError(
                f"load {row}: {value:g} {unit} is outside what the source knows, {low:.3g} to "
                f"{high:.3g} {unit}; is it stated in another unit? {nothing}"
            )
    order = np.argsort(load)
    for earlier, later in zip(order[:-1], order[1:], strict=True):
        # Nearer than a hundredth of the range they are one load stated twice.
        if load[later] - load[earlier] < 0.01 * (high - low):
            rows = sorted((int(earlier) + 1, int(later) + 1))
            raise InputError(
                f"loads {rows[0]} and {rows[1]} are the same, {load[earlier]:g} {unit}; state one "
                f"load once, as the mean of its readings; {nothing}"
            )


def check_loads(source: LabelledRecording, loads: Anchors, nothing: str, config: AnchorConfig) -> None:
    """Refuse known loads that cannot be true: as `check_values`, or against the source's direction.

    Raises:
        InputError: which row is wrong, what was expected, and that nothing was changed.
    """
    output, load = np.asarray(loads.output, np.float64), np.asarray(loads.reference, np.float64)
    check_values(source, load, nothing, config)
    order = np.argsort(load)
    if np.any(source.direction * np.diff(output[order]) <= 0):
        word = "rises" if source.direction > 0 else "falls"
        raise InputError(
            f"the output of a unit like the source {word} with the load, these do not in the order of their loads; "
            f"rows or columns are exchanged; {nothing}"
        )
