"""Discrete transport between windows: the paper's two plans, and the map each gives to windows it has not seen."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from softcal.core.identity import Settings
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import Array, Arrays
from softcal.core.windows import evenly, windows

EXACT, JOINT = "exact", "joint"


# The cost of a plan and no more: no verdict of the sets of benchmarks/sensitivity.py moves with them.
MAX_WINDOWS, MAX_JOINT_WINDOWS, MAX_JOINT_ROUNDS = 1500, 1000, 5
"""Windows per side of an exact and of a joint plan, and rounds of the joint problem's descent."""

NEIGHBOURS = 8
"""Stored windows that an unseen one moves with."""

RIDGE_PER_WINDOW = 1e-4


@dataclass(frozen=True, eq=False)
class TransportMap:
    """Stored target windows and how far the plan moved each; unseen windows move with their neighbours.

    map(x) = x + sum_k w_k (T(x_k) - x_k) over the nearest stored windows x_k, w_k proportional to the inverse squared
    distance. The paper's nearest neighbour alone would repeat a stored window; its displacement carries what is new.

    Args:
        stored: (m, taps) target windows of the plan.
        displacement: (m, taps) T(x_k) - x_k.
        family: name under which the catalogue rebuilds it.
    """

    stored: Array
    displacement: Array
    family: str
    neighbours: int = NEIGHBOURS

    @cached_property
    def _tree(self) -> "scipy.spatial.cKDTree":
        return scipy.spatial.cKDTree(self.stored)

    def apply(self, windows: Array) -> Array:
        distance, row = self._tree.query(windows, k=min(self.neighbours, len(self.stored)))
        distance, row = distance.reshape(len(windows), -1), row.reshape(len(windows), -1)
        # The small term keeps a stored window, at distance 0, finite: it then outweighs all others.
        closeness = 1.0 / (distance**2 + 1e-12 * (1.0 + float(np.ptp(self.stored)) ** 2))
        share = closeness / closeness.sum(axis=1, keepdims=True)
        return np.asarray(windows + np.einsum("nk,nkt->nt", share, self.displacement[row]))

    def apply_signal(self, signal: Array) -> Array:
        return self.apply(windows(signal))

    def arrays(self) -> Arrays:
        return {"stored": self.stored, "displacement": self.displacement}

    def settings(self) -> Settings:
        """Return how many neighbours an unseen window moves with."""
        return {"neighbours": self.neighbours}

    @classmethod
    def from_arrays(cls, arrays: Arrays, settings: Settings, family: str) -> "TransportMap":
        neighbours = int(str(settings["neighbours"]))
        stored, displacement = (np.asarray(arrays[name], np.float64) for name in ("stored", "displacement"))
        return cls(stored, displacement, family, neighbours)


def exact_map(target: Array, source: Array, positions: Array) -> TransportMap:
    """Couple target windows with source windows at least squared distance, and carry them to where the source stands.

    The paper's map: barycentric projection of the exact plan (Kim et al. 2020, eq. 3).

    Args:
        target: (m, taps) windows.
        source: (n, taps) windows they are coupled with.
        placed: (n, taps) where these stand in the space f reads; the source windows themselves, unless they were moved.
    """
    rows = evenly(len(source), MAX_WINDOWS)
    target, source, positions = target[evenly(len(target), MAX_WINDOWS)], source[rows], positions[rows]
    plan = solve_exact(_squared_distances(target, source))
    return TransportMap(target, barycentric(plan, positions) - target, EXACT)


def fit_exact(problem: FitProblem) -> TransportMap:
    """Solve for the plan of least squared distance, then move each window to the mean of what it is coupled to.

    Assumes that both units were pressed under one distribution of loads. Long recordings are thinned evenly
    (`MAX_WINDOWS`).
    """
    source = problem.source.windows
    return exact_map(problem.target.windows, source, source)


def fit_joint(problem: FitProblem) -> TransportMap:
    """Transport windows and labels together (Courty et al. 2017; Kim et al. 2020, eq. 5).

    min over plan and f_t of sum plan_ij (|x_i - y_j|^2 / s^2 + (f_t(x_i) - r_j)^2 / s_r^2) + ridge |f_t|^2, by block
    coordinate descent: the plan for fixed f_t is a transport problem; f_t for a fixed plan is kernel ridge regression
    on the labels the plan carries over, as in the authors' own implementation. Each round lowers the objective or
    stops. The lot shares one f, so the f_t of this unit is only a tool: what is kept is the plan, as a map into the
    windows that the shared f reads. Descent starts from f read through matched means and scales.
    """
    source_rows = evenly(len(problem.source.windows), MAX_JOINT_WINDOWS)
    source = problem.source.windows[source_rows]
    label = problem.source.window_reference[source_rows] / problem.network.reference_scale
    target = problem.target.windows[evenly(len(problem.target.windows), MAX_JOINT_WINDOWS)]
    distance = _squared_distances(target, source)
    # Windows and labels are both made free of units, or one of them would decide alone.
    distance /= float(np.mean(np.var(source, axis=0))) * source.shape[1]
    # The problem has many local minima: descent starts where means and scales already agree.
    matched = (target - target.mean()) / max(float(target.std()), 1e-12) * source.std() + source.mean()
    estimate = problem.network.evaluate(matched) / problem.network.reference_scale
    smoother = _smoother(target, RIDGE_PER_WINDOW * len(target))
    plan, best = np.empty((0, 0)), np.inf
    for _ in range(MAX_JOINT_ROUNDS):
        cost = distance + (estimate[:, None] - label[None, :]) ** 2
        trial = solve_exact(cost)
        total = float(np.sum(trial * cost))
        # Each step lowers the objective; below a ten-thousandth it only trades rounding.
        if total >= best * (1 - 1e-4):
            break
        plan, best = trial, total
        carried = barycentric(plan, label[:, None])[:, 0]
        # The ridge draws towards 0: centred, it draws towards the mean load instead.
        middle = float(carried.mean())
        estimate = middle + smoother @ (carried - middle)
    return TransportMap(target, barycentric(plan, source) - target, JOINT)


def _smoother(inputs: Array, ridge: float) -> Array:
    """Return the (m, m) matrix of kernel ridge regression on (m, k) fixed windows: labels to fitted values."""
    # The median heuristic: the kernel is as wide as windows usually are apart, whatever their unit.
    squared = _squared_distances(inputs, inputs)
    kernel = np.exp(-squared / max(float(np.median(squared)), 1e-12))
    return np.asarray(np.linalg.solve(kernel + ridge * np.eye(len(inputs)), kernel).T)


def solve_exact(cost: Array) -> Array:
    """Return the plan of least total cost between uniform weights (Kantorovich; POT's network simplex)."""
    # POT brings torch and scikit-learn along, seconds and 250 MB: only who solves a plan pays.
    import ot

    rows, columns = cost.shape
    return np.asarray(ot.emd(np.full(rows, 1 / rows), np.full(columns, 1 / columns), cost, numItermax=2_000_000))


def _squared_distances(a: Array, b: Array) -> Array:
    """Return (m, n) squared Euclidean distances between (m, k) and (n, k) rows."""
    import ot

    return np.asarray(ot.dist(a, b))


def barycentric(plan: Array, source: Array) -> Array:
    """Return where the plan sends each target window on average: (m, taps)."""
    return np.asarray(plan @ source / plan.sum(axis=1, keepdims=True))
