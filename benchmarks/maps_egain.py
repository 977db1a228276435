"""The paper's two eGaIn sensors, both directions: f and map from rows 0-799, tested on rows 800-1199.

python benchmarks/maps_egain.py [--quick]
python benchmarks/maps_egain.py --motion    two known loads of the unit, read while it moves: 100 drawn pairs of rows
"""

from dataclasses import replace

import numpy as np
from common.command import parser_of
from common.map_methods import METHODS, egain, own_error
from common.tables import print_table
from scipy.optimize import minimize

from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording

FIT, TEST = (0, 800), (800, 1200)
MIN_DISTANCE = 0.2
"""Share of the range by which two known loads differ."""


def main() -> None:
    parser = parser_of(__doc__, "one seed instead of five")
    parser.add_argument("--motion", action="store_true", help="with two known loads read in motion")
    options = parser.parse_args()
    if options.motion:
        read = [(f"{a} to {b}", *in_motion(a, b)) for a, b in (("S1", "S2"), ("S2", "S1"))]
        print_table(("known loads in motion", "none, N", "two, median, N", "two, 90 %, N"), read)
        return
    seeds = range(1 if options.quick else 5)
    columns = {direction: run(*direction, seeds) for direction in (("S1", "S2"), ("S2", "S1"))}
    first, second = columns.values()
    rows = [(name, *first[name], *second[name]) for name in first]
    print_table(("method", "S1 to S2, N", "after / own", "S2 to S1, N", "after / own"), rows)


def run(source: str, target: str, seeds: range) -> dict[str, tuple[float, float]]:
    """Median error over seeds and its ratio to own calibration, per method."""
    train, unit, test = egain(source).part(*FIT), egain(target).part(*FIT), egain(target).part(*TEST)
    errors: dict[str, list[float]] = {}
    for seed in seeds:
        network = fit_network(train, NetworkConfig(seed=seed)).network
        problem = FitProblem(train, network, unit.unlabelled, seed=seed)
        errors.setdefault("own calibration", []).append(own_error(unit, test, NetworkConfig(seed=seed)))
        errors.setdefault("affine, with the unit's labels", []).append(labelled_affine(network, unit, test))
        for name, method in METHODS.items():
            errors.setdefault(name, []).append(rmse(method(problem, test), test.window_reference))
    own_rmse = float(np.median(errors["own calibration"]))
    return {name: (float(np.median(values)), float(np.median(values)) / own_rmse) for name, values in errors.items()}


def in_motion(source: str, target: str, draws: int = 100) -> tuple[float, float, float]:
    """Error without known loads, and median and 90 % with two that were read anywhere in the unit's recording."""
    train, unit, test = egain(source).part(*FIT), egain(target).part(*FIT), egain(target).part(*TEST)
    network = fit_network(train, NetworkConfig(seed=0)).network
    problem = FitProblem(train, network, unit.unlabelled)
    rng = np.random.default_rng(99)
    pairs: list[Anchors | None] = []
    while len(pairs) < draws:
        rows = rng.integers(0, len(unit.reference), 2)
        if abs(np.subtract(*unit.reference[rows])) > MIN_DISTANCE * np.ptp(unit.reference):
            pairs.append(Anchors(unit.unlabelled.output[rows], unit.reference[rows]))
    errors = []
    for pair in [None, *pairs]:
        mapped = choose_map(replace(problem, anchors=pair)).unit_map.apply(test.windows)
        errors.append(rmse(network.evaluate(mapped), test.window_reference))
    return errors[0], float(np.median(errors[1:])), float(np.quantile(errors[1:], 0.9))


def labelled_affine(network: Network, unit: LabelledRecording, test: LabelledRecording) -> float:
    """Error of the affine map that is best on the fit rows when their labels are looked at: a floor, not a method."""
    rest = float(np.quantile(unit.unlabelled.output, 0.02))

    def mapped(theta: np.ndarray, recording: LabelledRecording) -> np.ndarray:
        return AffineMap(theta[0], network.output_mean + theta[1] - theta[0] * rest).apply(recording.windows)

    def error(theta: np.ndarray) -> float:
        return rmse(network.evaluate(mapped(theta, unit)), unit.window_reference)

    starts = [(g, -network.output_scale) for g in (0.6, 1.0, 1.7)]
    best = min((minimize(error, start, method="Nelder-Mead") for start in starts), key=lambda found: found.fun)
    return rmse(network.evaluate(mapped(best.x, test)), test.window_reference)


if __name__ == "__main__":
    main()
