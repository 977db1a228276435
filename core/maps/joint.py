"""Joint transport of windows and labels by block coordinate descent (Courty et al. 2017; Kim et al. 2020, eq. 5)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.plan import TransportMap, barycentric, solve_exact, spread_rows, squared_distances
from softcal.core.recording import Array


@dataclass(frozen=True)
class Joint:
    """min over plan and f_t of sum plan_ij (|x_i - y_j|^2 / s^2 + a (f_t(x_i) - r_j)^2 / s_r^2) + ridge |f_t|^2.

    Alternate: the plan for fixed f_t is a transport problem; f_t for a fixed plan is kernel ridge regression on the
    labels the plan carries over, as in the authors' own implementation. Each round lowers the objective or stops.
    The lot shares one f, so the f_t of this unit is only a tool: what is kept is the plan, as a map into the windows
    that the shared f reads. Descent starts from f read through matched means and scales.
    """

    name: str = "joint"

    def fit(self, problem: FitProblem) -> TransportMap:
        config = problem.config.plan
        source_rows = spread_rows(len(problem.source.windows), config.joint_windows)
        source = problem.source.windows[source_rows]
        label = problem.source.window_reference[source_rows] / problem.network.reference_scale
        target = problem.target.windows[spread_rows(len(problem.target.windows), config.joint_windows)]
        distance = squared_distances(target, source)
        # Windows and labels are both made free of units, or one of them would decide alone.
        distance /= float(np.mean(np.var(source, axis=0))) * source.shape[1]
        # The problem has many local minima: descent starts where means and scales already agree.
        matched = (target - target.mean()) / max(float(target.std()), 1e-12) * source.std() + source.mean()
        estimate = problem.network.evaluate(matched) / problem.network.reference_scale
        smoother = _Smoother(target, config.ridge, config.ridge_windows)
        plan, best = np.empty((0, 0)), np.inf
        for _ in range(config.joint_rounds):
            cost = distance + config.label_weight * (estimate[:, None] - label[None, :]) ** 2
            trial = solve_exact(cost)
            total = float(np.sum(trial * cost))
            # Each step lowers the objective; below a ten-thousandth it only trades rounding.
            if total >= best * (1 - config.joint_settled):
                break
            plan, best = trial, total
            estimate = smoother(barycentric(plan, label[:, None])[:, 0])
        return TransportMap(target, barycentric(plan, source) - target, self.name, config.neighbours)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> TransportMap:
        return TransportMap.from_arrays(arrays, settings, self.name)


class _Smoother:
    """Kernel ridge regression on fixed windows: labels in, fitted values out."""

    def __init__(self, inputs: Array, ridge: float, per_windows: int) -> None:
        # The median heuristic: the kernel is as wide as windows usually are apart, whatever their unit.
        squared = squared_distances(inputs, inputs)
        kernel = np.exp(-squared / max(float(np.median(squared)), 1e-12))
        regularised = kernel + ridge * len(inputs) / per_windows * np.eye(len(inputs))
        self._hat = np.linalg.solve(regularised, kernel)

    def __call__(self, labels: Array) -> Array:
        # The ridge draws towards 0: centred, it draws towards the mean load instead.
        middle = float(labels.mean())
        return np.asarray(middle + self._hat.T @ (labels - middle))
