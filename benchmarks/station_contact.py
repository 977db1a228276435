"""How well the stage finds a unit's surface: the contact of every unit of some lots, against where it truly lies.

python benchmarks/station_contact.py [--quick]
"""

import argparse

import numpy as np

from softcal.core.profiles import ramps
from softcal.core.simulated_lot import draw_twins
from softcal.station.acquisition import record
from softcal.station.bench import open_simulated_bench

UNITS = 12


def main() -> None:
    """Touch every unit and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one lot")
    print("| lot | units | mean, um | one standard deviation, um | largest, um |")
    print("|---|---|---|---|---|")
    for seed in range(1, 2 if parser.parse_args().quick else 4):
        errors_um = _errors_um(seed)
        mean, spread, largest = np.mean(errors_um), np.std(errors_um), np.max(np.abs(errors_um))
        print(f"| {seed} | {UNITS} | {mean:+.1f} | {spread:.1f} | {largest:.1f} |", flush=True)


def _errors_um(seed: int) -> list[float]:
    twins, errors_um = draw_twins(np.random.default_rng(seed), UNITS), []
    with open_simulated_bench(twins[0], seed) as (bench, station):
        for twin in twins:
            station.mount(twin)
            found_mm = record(bench, "A1", ramps([1.0], 4.0, rest_s=0.2), with_reference=True).contact_mm
            errors_um.append(1e3 * (found_mm - station.rig.clearance_mm - twin.parameters.u0_mm))
    return errors_um


if __name__ == "__main__":
    main()
