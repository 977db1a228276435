"""Simulated lots whose units were pressed otherwise than the source: lighter, harder, half the range, other dwell.

python benchmarks/maps_shift.py [--quick] [--units N]
"""

import argparse
from collections import Counter

from common.map_methods import METHODS, own_error, summary
from common.tables import print_table

from softcal.core.errors import UnitRefused
from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.simulated_lot import SHIFTS, LotDesign, simulate_lot
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.unit_problem import UnitProblem

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, batch=128)
"""Smaller than the paper's for f and own calibrations alike, so that hundreds of units fit in minutes."""

SHOWN = ("before (no map)", "softcal default", "monotone", "ot.da.EMDTransport", "ot.da.LinearTransport")
UNITS_PER_LOT = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one lot of five units per line")
    parser.add_argument("--units", type=int, default=100)
    options = parser.parse_args()
    lots = 1 if options.quick else max(1, options.units // UNITS_PER_LOT)
    for has_stage in (True, False):
        rows = [(shift, *line(shift, has_stage, lots)) for shift in SHIFTS]
        print(f"Stage position {'known' if has_stage else 'unknown'}, after / own, median (95 %):\n")
        print_table(("load of the units", *SHOWN, "families taken", "verdicts"), rows)


def line(shift: str, has_stage: bool, lots: int) -> list[str]:
    """One kind of shift: median and 95th percentile per method, what the default chose and what it says of it."""
    ratios: dict[str, list[float]] = {}
    taken, words = Counter[str](), Counter[str]()
    for seed in range(lots):
        lot = simulate_lot(seed, LotDesign(good=UNITS_PER_LOT, shift=shift, has_stage=has_stage))
        trained = fit_network(lot.source, NETWORK)
        network, model = trained.network, make_source_model(lot.source, trained.network, trained.validation_rows)
        for unit in lot.units:
            cut = 3 * len(unit.audit) // 4
            train, test = unit.audit.part(0, cut), unit.audit.part(cut, len(unit.audit))
            problem, own = FitProblem(lot.source, network, unit.recording), own_error(train, test, NETWORK)
            for name in SHOWN:
                ratios.setdefault(name, []).append(rmse(METHODS[name](problem, test), test.window_reference) / own)
            taken[choose_map(problem).family] += 1
            words[_word(problem, model)] += 1
    cells = [summary(ratios[name]) for name in SHOWN]
    counts = [", ".join(f"{name} {count}" for name, count in sorted(counter.items())) for counter in (taken, words)]
    return [f"{m:.2f} ({p:.2f})" for m, p, _ in cells] + counts


def _word(problem: FitProblem, model: SourceModel) -> str:
    try:
        return calibrate(UnitProblem(model, problem.target, anchors=problem.anchors)).decision.verdict
    except UnitRefused:
        return "refused"


if __name__ == "__main__":
    main()
