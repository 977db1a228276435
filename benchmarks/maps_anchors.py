"""Error against the number of known loads given with a unit whose presses reach half the source's range.

python benchmarks/maps_anchors.py [--quick]
"""

import argparse

import numpy as np
from map_methods import own_error, print_table

from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording
from softcal.core.simulated_lot import LotDesign, simulate_lot

COUNTS = (0, 1, 2, 3, 5)
NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, batch=128)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one lot instead of five")
    seeds = range(1 if parser.parse_args().quick else 5)
    rows = []
    for shift in ("none", "half range"):
        curves = np.array([curve for seed in seeds for curve in lot_curves(seed, shift)])
        rows.append((shift, *(float(x) for x in np.median(curves, axis=0))))
    print("after / own against the number of anchors (the first is the zero), stage position unknown, medians:\n")
    print_table(("load of the units", *(str(count) for count in COUNTS)), rows)


def lot_curves(seed: int, shift: str) -> list[list[float]]:
    """After / own per number of anchors, for the units of one lot."""
    lot = simulate_lot(seed, LotDesign(good=4, shift=shift))
    network = fit_network(lot.source, NETWORK).network
    curves = []
    for unit in lot.units:
        cut = 3 * len(unit.audit) // 4
        train, test = unit.audit.part(0, cut), unit.audit.part(cut, len(unit.audit))
        own = own_error(train, test, NETWORK)
        errors = []
        for count in COUNTS:
            problem = FitProblem(lot.source, network, unit.recording, known_loads(train, count))
            mapped = choose_map(problem).unit_map.apply(test.windows)
            errors.append(rmse(network.evaluate(mapped), test.window_reference) / own)
        curves.append(errors)
    return curves


def known_loads(audit: LabelledRecording, count: int) -> Anchors | None:
    """Output and load where the unit rested: the slowest samples near evenly spaced loads, the zero first."""
    if not count:
        return None
    loads = np.concatenate([[0.0], np.linspace(0.0, 0.9 * float(np.quantile(audit.reference, 0.98)), count)[1:]])
    speed = np.abs(np.convolve(np.gradient(audit.reference), np.ones(15) / 15, mode="same"))
    picked = []
    for load in loads:
        near = np.argsort(np.abs(audit.reference - load))[:60]
        picked.append(near[np.argsort(speed[near])[:20]])
    return Anchors(
        np.array([audit.unlabelled.output[rows].mean() for rows in picked]),
        np.array([audit.reference[rows].mean() for rows in picked]),
    )


if __name__ == "__main__":
    main()
