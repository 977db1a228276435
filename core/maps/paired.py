"""Fit a map to pairs of windows under equal load, at equal time or stage position, through f that will read it.

Pairs are a known transport plan, so that only a regression is left. What counts is the error of the estimate, not that
of the mapped window. Over pairs (target window x_i, source window y_i, load r_i) the map minimises

    sum (f(map(x_i)) - r_i)^2 + (f(map(x_i)) - f(y_i))^2

plus penalties on its roughness, by Gauss-Newton steps with Marquardt's damping (Marquardt 1963). The first term is the
error of the estimate. The second keeps the map from bending to repair errors that f makes on its own source.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.config import MapConfig, StageMatchConfig
from softcal.core.maps.crossing import robust_range
from softcal.core.maps.curve import CurveMap, continued
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.synchrony import paired_rows
from softcal.core.messages.reason import reason
from softcal.core.metrics import rms
from softcal.core.recording import Array, Arrays, Indices, OutputRecording
from softcal.core.windows import TAPS, evenly, resting, windows

SYNCHRONOUS, STAGE_MATCHED, SHARED_LOAD = "synchronous", "stage_matched", "shared_load"


MIN_WINDOWS = 4
"""Fewer windows fix no map; so few fix little more than gain and offset."""

DAMPING = 1e-3
"""Marquardt's, at the start."""

SETTLED, IDLE_STEPS = 0.99, 3
"""The descent ends after so many steps in a row that leave more than this share of the cost: f is made of flat pieces,
and a step across an edge of them gains little before the next gains much."""


@dataclass(frozen=True, eq=False)
class DynamicMap:
    """A monotone curve on every sample (Hammerstein model), then a linear filter within the window.

    map(x) = P B P' curve(x), with P the first orthonormal polynomials over the taps. The curve is the static response;
    B is the difference in lag and creep between the two units. Changes within a window that are faster than the
    polynomials in P are taken for noise and dropped.

    Args:
        mix: (shapes, shapes) matrix B; the identity leaves every polynomial as it is.
        family: name under which the catalogue rebuilds it.
    """

    curve: CurveMap
    mix: Array
    family: str

    def apply(self, windows: Array) -> Array:
        return np.asarray(self.curve(windows) @ self.matrix)

    @property
    def matrix(self) -> Array:
        """(taps, taps) linear part, applied from the right to a window after the curve."""
        shapes = window_shapes(len(self.mix))
        return np.asarray(shapes @ self.mix.T @ shapes.T)

    def apply_signal(self, signal: Array) -> Array:
        return np.asarray(windows(self.curve(signal)) @ self.matrix)

    def arrays(self) -> Arrays:
        """Return the curve's knots and values and the mix."""
        return {**self.curve.arrays(), "mix": self.mix}

    def settings(self) -> Settings:
        return {}


PairedMap = CurveMap | DynamicMap


def paired_map_from_arrays(arrays: Arrays, settings: Settings, family: str) -> PairedMap:
    """Rebuild a map fitted to pairs, with or without its dynamic part."""
    curve = CurveMap.from_arrays(arrays, settings, family)
    return DynamicMap(curve, np.asarray(arrays["mix"], np.float64), family) if "mix" in arrays else curve


def window_shapes(count: int) -> Array:
    """Return the first orthonormal polynomials over the taps: (TAPS, count); level first, then slope, curvature."""
    tap = np.linspace(-1.0, 1.0, TAPS)
    return np.asarray(np.linalg.qr(np.vander(tap, count, increasing=True))[0])


def fit_synchronous(problem: FitProblem) -> PairedMap:
    """Pair windows taken at the same time, under one load, and regress the source's on the target's."""
    synchrony = problem.synchrony
    if not synchrony.is_synchronous:
        raise UnitRefused(reason("not_synchronous", correlation=synchrony.rank_correlation))
    source_rows, target_rows = paired_rows(problem.source.unlabelled, problem.target, synchrony)
    if len(target_rows) < (enough := MIN_WINDOWS):
        raise UnitRefused(reason("few.times", windows=len(target_rows), enough=enough))
    return fit_pairs(problem, source_rows, target_rows, SYNCHRONOUS)


def fit_stage_matched(problem: FitProblem) -> PairedMap:
    """Pair windows whose stage histories agree and regress the source's on the target's.

    The station knows the stage position of both recordings, although the load on the unit is not measured. Assumes that
    equal travel means equal load: true for pads from one mould, not for units of different stiffness.
    """
    return fit_pairs(
        problem, *paired_by_stage(problem.source.unlabelled, problem.target, problem.config), STAGE_MATCHED
    )


def fit_pairs(problem: FitProblem, source_rows: Indices, target_rows: Indices, family: str) -> PairedMap:
    """Fit a map to pairs of windows under equal load, in time order.

    The number of window polynomials is chosen by blocked cross-validation: a dynamic part is kept only where it lowers
    the error on held-out blocks.
    """
    config = problem.config.pairs
    rows = evenly(len(target_rows), config.pairs)
    pairs = _Pairs(problem, source_rows[rows], target_rows[rows], family)
    everything, shapes = np.arange(pairs.count), 0
    if pairs.count >= config.blocks * TAPS:
        # Whole blocks of time are held out: neighbouring windows share samples, so single rows would be no test.
        is_held_out = everything * config.blocks // pairs.count % config.every == 1
        held_out, training = everything[is_held_out], everything[~is_held_out]
        min_error = pairs.error(pairs.fit(training, 0), held_out)
        for more, needed in config.shapes:
            error = pairs.error(pairs.fit(training, more), held_out)
            if error < needed * min_error:
                shapes, min_error = more, error
    fitted = pairs.fit(everything, shapes)
    span = robust_range(problem.source.unlabelled.output, problem.config.crossing)
    if isinstance(fitted, DynamicMap):
        return DynamicMap(continued(fitted.curve, span, problem.config.curve), fitted.mix, family)
    return continued(fitted, span, problem.config.curve)


class _Pairs:
    """Paired windows, and what every fit to a part of them shares: knots, starting values and labels."""

    def __init__(self, problem: FitProblem, source_rows: Indices, target_rows: Indices, family: str) -> None:
        self.count = len(target_rows)
        self.config = problem.config.pairs
        network = self._network = problem.network
        self._family = family
        self._target = target = problem.target.windows[target_rows]
        source = problem.source.windows[source_rows]
        # Both terms of the cost in one: (e - r)^2 + (e - f(y))^2 is 2 (e - mean of r and f(y))^2 plus a constant.
        label = (network.evaluate(source) + problem.source.window_reference[source_rows]) / 2
        self._label = label / network.reference_scale
        low, high = np.quantile(target, self.config.knot_range)
        # A curve needs three knots to bend, and ten pairs to each.
        count = np.clip(len(target) // 10, 3, self.config.knots)
        self._knots = np.linspace(low, high, int(count))
        if self._knots[-1] <= self._knots[0]:
            level, unit = self._knots[0], problem.target.output_unit
            raise UnitRefused(reason("still.shared", level=float(level), unit=unit))
        self._start = _static_regression(target, source, self._knots, self.config.curve_stiffness)
        self._curvature = _curvature(len(self._knots))

    def error(self, unit_map: PairedMap, rows: Indices) -> float:
        """Return the root mean square difference of the estimates over some pairs, in standard deviations."""
        estimate = self._network.evaluate(unit_map.apply(self._target[rows])) / self._network.reference_scale
        return rms(estimate - self._label[rows])

    def fit(self, rows: Indices, shapes: int) -> PairedMap:
        """Fit the curve, and the mix of the first `shapes` window polynomials where that is not 0."""
        # Imported here: whoever applies a map does not wait for scipy.
        theta, count = np.concatenate([self._start, np.eye(shapes).ravel()]), len(self._knots)
        cost, damping, idle = self._cost(theta, rows, shapes), DAMPING, 0
        for _ in range(40):
            hessian, descent = self._normal_equations(theta, rows, shapes)
            first_damping = damping
            for _ in range(14):
                damped = hessian + damping * np.diag(np.diag(hessian) + 1e-9)
                trial = theta + np.linalg.solve(damped, descent)
                # Projection onto monotone curves: the cost is not convex anyway, and the projection is exact.
                trial[:count] = scipy.optimize.isotonic_regression(trial[:count]).x
                trial_cost = self._cost(trial, rows, shapes)
                if trial_cost < cost:
                    break
                damping *= 4
            else:
                break
            idle = idle + 1 if trial_cost > SETTLED * cost else 0
            theta, cost = trial, trial_cost
            damping = max(damping / (10 if damping == first_damping else 4), 1e-6)
            if idle == IDLE_STEPS:
                break
        return self._map(theta, shapes)

    def _map(self, theta: Array, shapes: int) -> PairedMap:
        curve = CurveMap(self._knots, theta[: len(self._knots)], self._family)
        if not shapes:
            return curve
        return DynamicMap(curve, theta[len(self._knots) :].reshape(shapes, shapes), self._family)

    def _cost(self, theta: Array, rows: Indices, shapes: int) -> float:
        penalty, _ = self._penalty(theta, shapes)
        return self.error(self._map(theta, shapes), rows) ** 2 + float(penalty @ penalty)

    def _penalty(self, theta: Array, shapes: int) -> tuple[Array, Array]:
        """Return the regularisation as residuals, whose squares are added to the cost, and their Jacobian."""
        count, network = len(self._knots), self._network
        estimate, slope = network.gradient(resting(theta[:count]))
        # The estimate should be smooth along the curve, not the curve itself: that must follow every kink of f's input.
        of_answer = self.config.stiffness**0.5 / network.reference_scale * self._curvature
        of_curve = self.config.curve_stiffness**0.5 / network.output_scale * self._curvature
        of_mix = self.config.tether**0.5 * np.eye(shapes * shapes)
        moved = theta[count:] - np.eye(shapes).ravel()
        residual = np.concatenate([of_answer @ estimate, of_curve @ theta[:count], of_mix @ moved])
        return residual, scipy.linalg.block_diag(np.vstack([of_answer * slope.sum(axis=1), of_curve]), of_mix)

    def _normal_equations(self, theta: Array, rows: Indices, shapes: int) -> tuple[Array, Array]:
        """Gauss-Newton matrix and descent direction of the cost."""
        count, target = len(self._knots), self._target[rows]
        unit_map = self._map(theta, shapes)
        estimate, slope = self._network.gradient(unit_map.apply(target))
        residual = estimate / self._network.reference_scale - self._label[rows]
        slope = slope / self._network.reference_scale
        per_sample = slope @ unit_map.matrix.T if isinstance(unit_map, DynamicMap) else slope
        jacobian = np.empty((len(rows), len(theta)))
        jacobian[:, :count] = _hat_gradient(target, self._knots, per_sample)
        if shapes:
            basis = window_shapes(shapes)
            curved = CurveMap(self._knots, theta[:count], self._family)(target)
            jacobian[:, count:] = ((slope @ basis)[:, :, None] * (curved @ basis)[:, None, :]).reshape(len(rows), -1)
        penalty, by_theta = self._penalty(theta, shapes)
        hessian = jacobian.T @ jacobian / len(rows) + by_theta.T @ by_theta
        gradient = jacobian.T @ residual / len(rows) + by_theta.T @ penalty
        return hessian, -gradient


def _curvature(count: int) -> Array:
    """Return B with |B g|^2 the integral of the squared second derivative of g on `count` even places in 0 ... 1.

    A second difference over h is h^2 g'', and the integral is a sum times h: the factor is h^-1.5.
    """
    return np.asarray(np.diff(np.eye(count), 2, axis=0) * (count - 1) ** 1.5)


def _locate(samples: Array, knots: Array) -> tuple[Indices, Array]:
    segment = np.clip(np.searchsorted(knots, samples) - 1, 0, len(knots) - 2)
    return segment.astype(np.int64), (samples - knots[segment]) / (knots[segment + 1] - knots[segment])


def _hat_gradient(target: Array, knots: Array, per_sample: Array) -> Array:
    """Return the derivative of each window's estimate by each knot's value: (n, k).

    A sample between two knots moves with both, by its distance from the other (hat functions).
    """
    segment, share = _locate(target, knots)
    row = np.broadcast_to(np.arange(len(target))[:, None] * len(knots), segment.shape)
    size = len(target) * len(knots)
    left = np.bincount((row + segment).ravel(), (per_sample * (1 - share)).ravel(), size)
    right = np.bincount((row + segment + 1).ravel(), (per_sample * share).ravel(), size)
    return np.asarray((left + right).reshape(len(target), len(knots)))


def _static_regression(target: Array, source: Array, knots: Array, stiffness: float) -> Array:
    """Return values at the knots from a smooth monotone regression of mean window levels: where the descent starts."""
    segment, share = _locate(target.mean(axis=1), knots)
    hats = np.zeros((len(target), len(knots)))
    hats[np.arange(len(target)), segment] = 1 - share
    hats[np.arange(len(target)), segment + 1] += share
    curvature = _curvature(len(knots))
    normal = hats.T @ hats / len(target) + stiffness * curvature.T @ curvature + 1e-9 * np.eye(len(knots))
    values = np.linalg.solve(normal, hats.T @ source.mean(axis=1) / len(target))
    return np.asarray(scipy.optimize.isotonic_regression(values).x)


def paired_by_stage(source: OutputRecording, target: OutputRecording, config: MapConfig) -> tuple[Indices, Indices]:
    """Return the windows of both recordings at equal stage position, direction and recent history.

    Returns:
        Row numbers into `source.windows` and `target.windows`, equal lengths, in the target's time order.

    Raises:
        UnitRefused: a recording has no stage position, or too few positions are shared.
    """
    if source.stage_mm is None or target.stage_mm is None:
        raise UnitRefused(reason("no_position"))
    # Imported here: whoever applies a map does not wait for scipy.
    stage = config.stage_matched
    source_histories, target_histories = (
        stage_histories(r, r.stage_mm, stage) for r in (source, target) if r.stage_mm is not None
    )
    travel_mm = float(np.ptp(target.stage_mm))
    # Twice as many as the fit reads: some of them find no partner.
    rows = evenly(len(target_histories), 2 * config.pairs.pairs)
    distance_mm, nearest = np.empty(len(rows)), np.empty(len(rows), np.int64)
    lengths = _observed_entries(target, stage)[rows]
    # One tree for each length of known history: what lies before a gap must not be compared as if it were known.
    for entries in np.unique(lengths):
        group = lengths == entries
        tree = scipy.spatial.cKDTree(source_histories[:, :entries])
        distance_mm[group], nearest[group] = tree.query(target_histories[rows[group], :entries])
    # A share of the travel, so that one number serves strokes of 1 mm and of 20 mm.
    alike = distance_mm <= stage.near_share * travel_mm
    if travel_mm <= 0 or alike.sum() < MIN_WINDOWS:
        raise UnitRefused(reason("few.positions", windows=int(alike.sum()), enough=MIN_WINDOWS))
    return nearest[alike].astype(np.int64), rows[alike]


def stage_histories(recording: OutputRecording, stage_mm: Array, config: StageMatchConfig) -> Array:
    """Return where the stage stood now and before each full window, weighted: (m, len(config.look_back)) in mm."""
    ago, weight = np.array(config.look_back).T
    past_s = recording.t_s[recording.window_rows][:, None] - ago / recording.sample_rate_Hz
    return np.asarray(np.interp(past_s, recording.t_s, stage_mm) * weight)


def _observed_entries(recording: OutputRecording, config: StageMatchConfig) -> Indices:
    """Return how many entries of each full window's history were recorded: what lies before a gap is not known.

    Before a recording begins the stage is taken to have stood where it begins.
    """
    bridged = recording.bridged
    # Nothing moved before the first sample; only gaps inside hide movements, and a few lost samples hide none.
    starts_s = np.array([-np.inf, *(bridged.t_s[segment.start] for segment in bridged.segments[1:])])
    begins_s = starts_s[np.searchsorted(starts_s, recording.t_s, side="right") - 1]
    ago_s = np.array(config.look_back)[:, 0] / recording.sample_rate_Hz
    # Half a sample of slack: times are kept in floating point.
    is_observed = recording.t_s[:, None] - ago_s >= begins_s[:, None] - 0.5 / recording.sample_rate_Hz
    return np.asarray(is_observed[recording.window_rows].sum(axis=1))
