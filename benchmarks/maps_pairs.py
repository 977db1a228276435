"""Choose the numbers of the paired map (`PairConfig`) on stretches that no table of docs/results.md tests.

The insole's calibration file in 32 stretches: those with number % 4 == 2 are the ones that `maps_insole.py` tests and
are not read here. Maps are fitted on % 4 == 1 and 3 and judged on % 4 == 0, behind sources that are none of its five.

python benchmarks/maps_pairs.py [--sources NAME ...] [--every N]
"""

from dataclasses import replace
from itertools import product

import numpy as np
from common.command import parser_of
from common.map_methods import STRETCHES, insole, taxel, taxels
from common.tables import print_table

from softcal.core.maps.config import MapConfig, PairConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.paired import fit_synchronous
from softcal.core.metrics import rmse
from softcal.core.network.training import fit_network

STIFFNESS = (5e-6, 2e-5, 8e-5)
CURVE_STIFFNESS = (1.8e-8, 7e-8, 2.8e-7)
KNOTS = (16, 24, 32)
SHAPES = (((1, 1.0), (5, 0.98), (15, 0.96)), ((1, 1.02), (5, 0.99), (15, 0.97)), ((1, 1.04), (5, 1.0), (15, 0.98)))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--sources", nargs="+", default=("taxel_015", "taxel_092"))
    parser.add_argument("--every", type=int, default=4, metavar="N", help="every Nth unit only")
    options = parser.parse_args()
    day = insole("calibration")
    number = np.arange(len(day)) * STRETCHES // len(day) % 4
    fitted, is_test = (number == 1) | (number == 3), number == 0
    names = taxels(day)
    sources = [name for name in options.sources if name in names] or names[3:5]
    configs = variants()
    errors: dict[str, list[float]] = {label: [] for label, _ in configs}
    for source in sources:
        recording = taxel(day, source, fitted)
        network = fit_network(recording).network
        for name in [n for n in names if n != source][:: options.every]:
            unit, test = taxel(day, name, fitted).unlabelled, taxel(day, name, is_test)
            for label, config in configs:
                problem = FitProblem(recording, network, unit, config=replace(MapConfig(), pairs=config))
                estimate = network.evaluate(fit_synchronous(problem).apply(test.windows))
                errors[label].append(rmse(estimate, test.window_reference))
    base = np.array(errors[configs[0][0]])
    pairs = f"Sources {', '.join(sources)}, {len(base)} pairs of source and unit"
    print(f"{pairs}; error over that of the numbers in force:\n")
    rows = [
        (label, float(np.median(np.array(ratios) / base)), float(np.quantile(np.array(ratios) / base, 0.95)))
        for label, ratios in errors.items()
    ]
    print_table(("numbers", "median", "95 %"), rows)


def variants() -> list[tuple[str, PairConfig]]:
    """Return the configurations to compare, the one in force first."""
    config = PairConfig()
    grid = [("in force", config)]
    for stiffness, curve in product(STIFFNESS, CURVE_STIFFNESS):
        if (stiffness, curve) != (config.stiffness, config.curve_stiffness):
            label = f"stiffness {stiffness:g}, curve {curve:g}"
            grid.append((label, replace(config, stiffness=stiffness, curve_stiffness=curve)))
    grid += [(f"{knots} knots", replace(config, knots=knots)) for knots in KNOTS if knots != config.knots]
    grid += [(f"shapes {shapes}", replace(config, shapes=shapes)) for shapes in SHAPES if shapes != config.shapes]
    return grid


if __name__ == "__main__":
    main()
