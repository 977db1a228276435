"""41 taxels under one air pressure: source from one taxel, maps for the other 40, tested on a held-out quarter by time.

The held-out quarter is eight stretches spread over the slow rise and fall, so that source, map and own calibration
all see every pressure. `other` fits the maps on another day's programme and tests them back on the first day; there
`own, other day` is a network trained on the unit's own labels of that other day.

python benchmarks/maps_insole.py [same|other] [--quick] [--every N] [--sources NAME ...] [--methods NAME ...]
"""

import argparse
from collections.abc import Sequence
from functools import cache

import numpy as np
from map_methods import METHODS, insole, own_error, print_table, summary, taxel, taxels

from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.training import NetworkConfig, fit_network

SOURCES = ("taxel_001", "taxel_030", "taxel_060", "taxel_061", "taxel_135")
FAST = ("before (no map)", "softcal default", "label_shift", "monotone", "ot.da.EMDTransport", "ot.da.LinearTransport")
STRETCHES = 32


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programme", nargs="?", choices=("same", "other"), default="same")
    parser.add_argument("--quick", action="store_true", help="one source and every fifth unit")
    parser.add_argument("--sources", nargs="+", default=SOURCES)
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every Nth unit only")
    parser.add_argument("--methods", nargs="+", default=FAST, choices=FAST, help="these only")
    options = parser.parse_args()
    sources, step = (options.sources[:1], 5) if options.quick else (options.sources, options.every)
    for source in sources:
        run(source, options.programme, step, options.methods)


def run(source: str, programme: str, step: int, methods: Sequence[str]) -> None:
    """Print one source's table."""
    day = insole("calibration")
    train, test_rows = split(len(day))
    unit_day = day if programme == "same" else insole("validation_1")
    unit_rows = train if programme == "same" else None
    recording = taxel(day, source, train)
    network = fit_network(recording, NetworkConfig()).network
    ratios: dict[str, list[float]] = {}
    worse: dict[str, int] = dict.fromkeys(methods, 0)
    for name in [n for n in taxels(day) if n != source][::step]:
        test = taxel(day, name, test_rows)
        problem = FitProblem(recording, network, taxel(unit_day, name, unit_rows).unlabelled)
        before = rmse(network.evaluate(test.windows), test.window_reference)
        errors = {method: rmse(METHODS[method](problem, test), test.window_reference) for method in methods}
        own = own_of(name, programme)
        for method, error in errors.items():
            ratios.setdefault(method, []).append(error / own)
            worse[method] += error > before
    print(f"Source {source}, {programme} programme, {len(ratios[methods[0]])} units, after / own:\n")
    print_table(
        ("method", "median", "95 %", "largest", "worse than before"),
        ((m, *summary(r), worse[m]) for m, r in ratios.items()),
    )


@cache
def own_of(name: str, programme: str) -> float:
    """Error of the unit's own calibration on the test stretches, trained on the day its map was fitted."""
    day = insole("calibration")
    train, test = split(len(day))
    own = taxel(day, name, train) if programme == "same" else taxel(insole("validation_1"), name)
    return own_error(own, taxel(day, name, test), NetworkConfig())


def split(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the rows to fit and of the held-out quarter."""
    held = np.arange(count) * STRETCHES // count % 4 == 2
    return ~held, held


if __name__ == "__main__":
    main()
