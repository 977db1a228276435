"""41 taxels under one air pressure: source from one taxel, maps for the other 40, tested on a held-out quarter by time.

The held-out quarter is eight stretches spread over the slow rise and fall, so that source, map and own calibration
all see every pressure. `other` fits the maps on another day's programme and tests them back on the first day; there
`own, other day` is a network trained on the unit's own labels of that other day.

python benchmarks/maps_insole.py [same|other] [--quick] [--every N] [--sources NAME ...] [--methods NAME ...]
    [--seeds N]
"""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from common.command import parser_of
from common.map_methods import METHODS, SOURCES, insole, own_error, split, summary, taxel, taxels, verdict_word
from common.tables import print_table

from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.verdict import VERDICTS

BEFORE, DEFAULT = "before (no map)", "softcal default"
FAST = (BEFORE, DEFAULT, "two_point", "monotone", "ot.da.EMDTransport", "ot.da.LinearTransport")
FLAGGED = 1.15
"""Units beyond this ratio are to be flagged: not passed."""


def main() -> None:
    parser = parser_of(__doc__, "one source and every fifth unit")
    parser.add_argument("programme", nargs="?", choices=("same", "other"), default="same")
    parser.add_argument("--sources", nargs="+", default=SOURCES)
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every Nth unit only")
    parser.add_argument("--methods", nargs="+", default=FAST, choices=FAST, help="these only")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="trainings of f and of the own calibrations")
    options = parser.parse_args()
    sources, step, seeds = options.sources, options.every, options.seeds
    if options.quick:
        sources, step, seeds = sources[:1], 5, 1
    for source in sources:
        run(source, options.programme, step, options.methods, seeds)


def run(source: str, programme: str, step: int, methods: Sequence[str], seeds: int) -> None:
    """Print one source's table: per unit the medians over the seeds, then what they are over the units."""
    day = insole("calibration")
    train, test_rows = split(len(day))
    unit_day = day if programme == "same" else insole("validation_1")
    unit_rows = train if programme == "same" else None
    recording = taxel(day, source, train)
    units = [n for n in taxels(day) if n != source][::step]
    errors: dict[str, dict[str, list[float]]] = {name: {} for name in units}
    predictions: dict[str, list[tuple[float, float]]] = {}
    for seed in range(seeds):
        trained = fit_network(recording, NetworkConfig(seed=seed))
        network, model = (
            trained.network,
            make_source_model(recording, trained.network, trained.validation_rows, method=Method()),
        )
        for name in units:
            test = taxel(day, name, test_rows)
            problem = FitProblem(recording, network, taxel(unit_day, name, unit_rows).unlabelled, seed=seed)
            errors_of_unit = {"own": own_error_of(name, programme, seed)}
            errors_of_unit[BEFORE] = rmse(network.evaluate(test.windows), test.window_reference)
            fitted = [method for method in methods if method != BEFORE]
            errors_of_unit |= {method: rmse(METHODS[method](problem, test), test.window_reference) for method in fitted}
            for method, error in errors_of_unit.items():
                errors[name].setdefault(method, []).append(error)
            if DEFAULT in errors_of_unit:
                harm, ratio = (
                    errors_of_unit[DEFAULT] / errors_of_unit[BEFORE],
                    errors_of_unit[DEFAULT] / errors_of_unit["own"],
                )
                predictions.setdefault(verdict_word(problem, model), []).append((harm, ratio))
    columns = ("own", BEFORE, *methods)
    medians = {method: np.array([np.median(errors[name][method]) for name in units]) for method in columns}
    print(f"Source {source}, {programme} programme, {len(units)} units, medians of {seeds} seeds, after / own:\n")
    print_table(
        ("method", "median", "95 %", "largest", "worse than before"),
        ((m, *summary(medians[m] / medians["own"]), int((medians[m] > medians[BEFORE]).sum())) for m in methods),
    )
    print_verdicts(predictions)


def print_verdicts(predictions: Mapping[str, Sequence[tuple[float, float]]]) -> None:
    """Print what the verdicts of the default said, from after / before and after / own of every unit and seed."""
    rows = []
    for word in (*VERDICTS, "refused"):
        units = predictions.get(word, [])
        harmed, far = sum(harm > 1 for harm, _ in units), sum(ratio > FLAGGED for _, ratio in units)
        rows.append((word, len(units), harmed, far))
    print_table(("verdict", "verdicts given", "worse than before", f"after > {FLAGGED:g} x own"), rows)


@cache
def own_error_of(name: str, programme: str, seed: int) -> float:
    """Error of the unit's own calibration on the test stretches, trained on the day its map was fitted."""
    day = insole("calibration")
    train, test = split(len(day))
    own_recording = taxel(day, name, train) if programme == "same" else taxel(insole("validation_1"), name)
    return own_error(own_recording, taxel(day, name, test), NetworkConfig(seed=seed))


if __name__ == "__main__":
    main()
