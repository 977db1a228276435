"""Monotone transport sample by sample: equal quantiles of the two outputs (one-dimensional optimal transport)."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.config import MapConfig
from softcal.core.maps.crossing import CACHED, robust_range
from softcal.core.maps.curve import CurveMap, continued
from softcal.core.maps.dwell import paced_time
from softcal.core.maps.ends import match_ends
from softcal.core.maps.interface import FitProblem
from softcal.core.messages.reason import reason
from softcal.core.metrics import quantile, rms
from softcal.core.recording import Array, LabelledRecording, OutputRecording

MONOTONE, AVERAGED = "monotone", "averaged"


def fit_monotone(problem: FitProblem) -> CurveMap:
    """Carry each quantile of the target's samples onto the source's: exact where both ran the same programme.

    The monotone rearrangement is the optimal transport in one dimension for every convex cost (Santambrogio 2015,
    section 2.2). Quantiles of quantised outputs are taken between the steps of the converter. So the steps of one
    unit do not become steps of the map.
    """
    return _equal_quantiles(problem, _quantiles)


def _equal_quantiles(problem: FitProblem, quantiles: Callable[[OutputRecording, MapConfig], Array]) -> CurveMap:
    config = problem.config.curve
    target = quantiles(problem.target, problem.config)
    if np.ptp(target) <= 0:
        raise UnitRefused(reason("still", level=float(target[0]), unit=problem.target.output_unit))
    source = quantiles(problem.source.unlabelled, problem.config)
    # Quantised outputs repeat; a curve has one value at each of them.
    knots, index = np.unique(target, return_inverse=True)
    means = np.bincount(index, source) / np.bincount(index)
    # Equal quantiles rise already; this takes out rounding only, where isotonic regression would cost more.
    curve = CurveMap(knots, np.maximum.accumulate(means), MONOTONE)
    return continued(curve, float(np.ptp(source)), config)


def fit_averaged(problem: FitProblem) -> CurveMap:
    """Average the line through rest and peak with two curves of equal quantiles: of all time, and without dwell.

    The line takes a unit to be bent exactly as its source. The first curve takes its time to be spent exactly as the
    source's. The second is blind to where a programme waits, and takes a source that goes slowly through some levels in
    every passage to be bent. From outputs alone a bend and a dwell look alike, so none can be shown to be right: line
    and curves err by as much. The line errs by the uncertainty of its gain beside (`EndMatch.gain_error`): recordings
    of few presses do not show how hard the hardest is.
    """
    match, curve, config = problem.ends, fit_monotone(problem), problem.config
    curves = (curve.values + _equal_quantiles(problem, _paced_quantiles)(curve.knots)) / 2
    line = match.offset + match.gain * curve.knots
    output = match.offset + match.gain * problem.target.output
    rest = quantile(output, config.crossing.robust_range[0 if problem.source.direction > 0 else 1])
    gain = match.gain_error * rms(output - rest) / robust_range(problem.source.unlabelled.output, config.crossing)
    error = config.curve.match_error
    share, _ = weigh_line(float(np.hypot(error, gain)), error, config.curve.match_correlation)
    return CurveMap(curve.knots, (1.0 - share) * curves + share * line, AVERAGED)


def weigh_line(line_error: float, curve_error: float, correlation: float) -> tuple[float, float]:
    """Weigh a line beside a curve so that their mean errs least (Bates and Granger 1969).

    Args:
        line_error, curve_error: standard uncertainties of both, in one unit.
        correlation: of both errors.

    Returns:
        The weight of the line, and the standard uncertainty of the mean.
    """
    common = correlation * line_error * curve_error
    share = (curve_error**2 - common) / (line_error**2 + curve_error**2 - 2.0 * common)
    share = float(np.clip(share, 0.0, 1.0))
    rest = 1.0 - share
    variance = (share * line_error) ** 2 + (rest * curve_error) ** 2 + 2.0 * share * rest * common
    return share, float(np.sqrt(variance))


@lru_cache(maxsize=CACHED)
def _quantiles(recording: OutputRecording, config: MapConfig) -> Array:
    """Return the quantiles of a recording's output that become knots."""
    return interpolated_quantiles(recording.output, _shares(config))


@lru_cache(maxsize=CACHED)
def _paced_quantiles(recording: OutputRecording, config: MapConfig) -> Array:
    """Return the same quantiles of the time that is left once a programme's dwell is taken out."""
    bridged = recording.bridged
    return interpolated_quantiles(bridged.output, _shares(config), paced_time(bridged, config))


def _shares(config: MapConfig) -> Array:
    # Chebyshev spacing: the ends, where rest and peak levels lie, are resolved best.
    spacing = (1 - np.cos(np.linspace(0, np.pi, config.curve.knots))) / 2
    end = config.ends.rest_share
    return np.asarray(end + (1 - 2 * end) * spacing)


def interpolated_quantiles(samples: Array, shares: Array, weights: Array | None = None) -> Array:
    """Return quantiles of quantised samples, each with a weight, interpolated between neighbouring steps."""
    levels, index = np.unique(samples, return_inverse=True)
    counts = np.bincount(index, weights)
    middles = (np.cumsum(counts) - counts / 2) / counts.sum()
    return np.interp(shares, middles, levels)


def shape_distance(source: LabelledRecording, target: OutputRecording, config: MapConfig) -> float:
    """Return how far two outputs are from one another once rest and peak are matched, as a share of the source's range.

    The mean distance of equal quantiles (Wasserstein distance of order 1). It holds how the units are bent and how
    their time was spent. Sources that were pressed alike share the second, so the nearest of them is the one that is
    bent most like the unit.

    Raises:
        UnitRefused: the unit's output makes no swing that stands out of its noise.
    """
    match = match_ends(source, target, config)
    shares = np.linspace(*config.curve.shares, config.curve.knots)
    mapped = match.offset + match.gain * interpolated_quantiles(target.output, shares)
    source_output = source.unlabelled.output
    span = robust_range(source_output, config.crossing)
    return float(np.mean(np.abs(interpolated_quantiles(source_output, shares) - mapped))) / span
