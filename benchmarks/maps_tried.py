"""What else was tried for the map of a unit that was pressed otherwise than its source, beside the default.

python benchmarks/maps_tried.py [egain|skin|insole ...] [--methods NAME ...] [--every N] [--cache DIR]

The cases are those of maps_other.py, errors are after / own. No constant of softcal was chosen on this table. Tried are

- the families averaged, each with the weight 1 / forecast^2, in place of a choice;
- unbalanced transport (POT, Kullback-Leibler on both sides) and partial transport (nine tenths of the mass),
  carried to new windows as EMDTransport does;
- pairs from an alignment in time (dynamic time warping of both outputs between rest and peak), the idea of
  Match-And-Deform for one series a side, and softcal's own fit to pairs behind it;
- f trained on copies of the source with drawn gains and levels, without a map and with the default map.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import ot
from common.command import parser_of
from common.map_methods import METHODS, summary, thinned
from common.tables import print_table
from maps_other import SETS, Case, Networks

from softcal.core.errors import UnitRefused
from softcal.core.maps.choose import choose_map
from softcal.core.maps.config import MapConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.paired import fit_pairs
from softcal.core.metrics import rmse
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.unit_problem import UnitProblem

FAMILIES = ("identity", "affine", "two_point", "monotone", "averaged")
REFERENCE_METHODS = ("before (no map)", "softcal default", "ot.da.EMDTransport")
COPIES, GAIN_SPREAD, LEVEL_SPREAD = 6, 0.25, 0.1
"""Copies of the source; spread of log gain; spread of the level over the source's span."""

MASS, MARGINAL = 0.9, 1.0
"""Share that partial transport carries; price of mass that unbalanced transport leaves, over the mean cost."""

ALIGNED = 600
"""Samples a side that are aligned."""

TrialMethod = Callable[[Case, FitProblem, Networks], Array]


def weighted_families(case: Case, problem: FitProblem, networks: Networks) -> Array:
    estimates, weights = [], []
    for name in FAMILIES:
        method = replace(Method(), map=MapConfig(name))
        try:
            calibration = calibrate(
                UnitProblem(make_source_model(case.source, problem.network, method=method), case.unit)
            )
        except UnitRefused:
            continue
        estimates.append(problem.network.evaluate(calibration.unit_map.apply(case.test.windows)))
        weights.append(calibration.forecast.rmse**-2)
    return np.average(estimates, axis=0, weights=weights)


def carried(problem: FitProblem, case: Case, plan_of: Callable[[Array], Array]) -> Array:
    """Estimate behind a plan between windows; a new window moves as the nearest one that the plan moved."""
    target, source = thinned(problem.target.windows), thinned(problem.source.windows)
    cost = ot.dist(target, source)
    plan = plan_of(cost / cost.mean())
    mass = plan.sum(axis=1)
    moved = mass > 1e-3 * mass.max()
    target, landed = target[moved], plan[moved] @ source / mass[moved, None]
    new = np.asarray(case.test.windows)
    nearest = np.concatenate(
        [ot.dist(part, target).argmin(axis=1) for part in np.array_split(new, len(new) // 500 + 1)]
    )
    return problem.network.evaluate(new + (landed - target)[nearest])


def unbalanced(case: Case, problem: FitProblem, networks: Networks) -> Array:
    return carried(
        problem,
        case,
        lambda cost: ot.unbalanced.mm_unbalanced(
            ot.unif(len(cost)), ot.unif(cost.shape[1]), cost, MARGINAL, div="kl", numItermax=300
        ),
    )


def partial(case: Case, problem: FitProblem, networks: Networks) -> Array:
    def plan_of(cost: Array) -> Array:
        masses = ot.unif(len(cost)), ot.unif(cost.shape[1])
        return np.asarray(ot.partial.partial_wasserstein(*masses, cost, m=MASS, nb_dummies=50))

    try:
        return carried(problem, case, plan_of)
    except ValueError:
        # POT's solver does not end on some sets of equal windows.
        return np.full(len(case.test.windows), np.nan)


def aligned_in_time(case: Case, problem: FitProblem, networks: Networks) -> Array:
    source, target = problem.source.unlabelled, problem.target
    source_at, target_at = (np.linspace(0, len(one.windows) - 1, ALIGNED).astype(int) for one in (source, target))
    path = warped(_levels(source, source_at), _levels(target, target_at))
    source_rows, target_rows = source_at[path[:, 0]], target_at[path[:, 1]]
    once = np.unique(target_rows, return_index=True)[1]
    unit_map = fit_pairs(problem, source_rows[once], target_rows[once], "synchronous")
    return problem.network.evaluate(unit_map.apply(case.test.windows))


def _levels(recording: OutputRecording, at: Array) -> Array:
    """Output between its rest and its peak, whichever way it moves."""
    low, high = np.quantile(recording.output, (0.02, 0.99))
    return np.asarray((recording.output[recording.window_rows[at]] - low) / (high - low))


def warped(first: Array, second: Array) -> Array:
    """Return the (k, 2) path of dynamic time warping (Sakoe and Chiba 1978) between two series."""
    total = np.full((len(first) + 1, len(second) + 1), np.inf)
    total[0, 0] = 0.0
    for i, distances in enumerate(np.abs(first[:, None] - second[None])):
        for j, distance in enumerate(distances):
            total[i + 1, j + 1] = distance + min(total[i, j], total[i, j + 1], total[i + 1, j])
    i, j = len(first), len(second)
    path = []
    while i and j:
        path.append((i - 1, j - 1))
        i, j = min(((i - 1, j - 1), (i - 1, j), (i, j - 1)), key=lambda at: total[at])
    return np.array(path[::-1])


def drawn_network(case: Case, networks: Networks) -> FitProblem:
    """Return the problem behind an f that has seen drawn gains and levels of its source."""
    rng, one = np.random.default_rng(0), case.source
    output, rest = one.unlabelled.output, float(np.quantile(one.unlabelled.output, 0.02))
    span, gains = float(np.ptp(output)), np.exp(rng.normal(0.0, GAIN_SPREAD, COPIES))
    levels = rng.normal(0.0, LEVEL_SPREAD * span, COPIES)
    copies = np.concatenate(
        [output, *(rest + gain * (output - rest) + level for gain, level in zip(gains, levels, strict=True))]
    )
    once_s = one.unlabelled.t_s
    t_s = np.concatenate([once_s + k * (np.ptp(once_s) + 1.0) for k in range(COPIES + 1)])
    many = replace(one.unlabelled, t_s=t_s, output=copies, stage_mm=None)
    network = networks.network_of(LabelledRecording(many, np.tile(one.reference, COPIES + 1), one.reference_unit))
    return FitProblem(case.source, network, case.unit)


def drawn_f(case: Case, problem: FitProblem, networks: Networks) -> Array:
    return drawn_network(case, networks).network.evaluate(case.test.windows)


def drawn_f_and_map(case: Case, problem: FitProblem, networks: Networks) -> Array:
    network_drawn = drawn_network(case, networks)
    return network_drawn.network.evaluate(choose_map(network_drawn).unit_map.apply(case.test.windows))


TRIALS: dict[str, TrialMethod] = {
    "families weighted by forecast": weighted_families,
    "unbalanced transport": unbalanced,
    "partial transport": partial,
    "aligned in time": aligned_in_time,
    "f with drawn gains, no map": drawn_f,
    "f with drawn gains, default": drawn_f_and_map,
}


def ratios(case: Case, networks: Networks, names: Sequence[str]) -> dict[str, float]:
    """After / own of what was tried on one unit."""
    problem = FitProblem(case.source, networks.network_of(case.source), case.unit)
    estimates = {name: METHODS[name](problem, case.test) for name in REFERENCE_METHODS}
    estimates |= {name: TRIALS[name](case, problem, networks) for name in names}
    own_rmse = rmse(networks.network_of(case.use).evaluate(case.test.windows), case.test.window_reference)
    return {name: rmse(values, case.test.window_reference) / own_rmse for name, values in estimates.items()}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("sets", nargs="*", default=list(SETS), choices=SETS)
    parser.add_argument("--methods", nargs="+", default=list(TRIALS), choices=TRIALS, metavar="NAME", help="these only")
    parser.add_argument("--every", type=int, default=8, metavar="N", help="every Nth taxel as a unit")
    parser.add_argument("--cache", type=Path, help="keep trained networks here")
    options = parser.parse_args()
    networks = Networks(options.cache)
    print("after / own, median (95 %):\n")
    of_set: dict[str, list[dict[str, float]]] = {}
    for name in options.sets:
        for case in SETS[name](options.every):
            # Both ways and both days apart: what helps one of them may harm the other.
            of_set.setdefault(case.line.split(",")[0], []).append(ratios(case, networks, options.methods))
    print_table(
        ("method", *(f"{name}, {len(trial_ratios)} units" for name, trial_ratios in of_set.items())),
        (
            (
                name,
                *(
                    "{:.2f} ({:.2f})".format(*summary(unit[name] for unit in trial_ratios))
                    for trial_ratios in of_set.values()
                ),
            )
            for name in (*REFERENCE_METHODS, *options.methods)
        ),
    )


if __name__ == "__main__":
    main()
