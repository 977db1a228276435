"""The paper's Table 2: error against the share of the unit's samples that the map may see.

Contiguous stretches from the start of the unit's recording, as a line that stops early would record.

python benchmarks/maps_samples.py [--quick]
"""

import argparse

import numpy as np
from map_methods import egain, insole, own_error, print_table, taxel
from maps_insole import split

from softcal.core.errors import SoftcalError
from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.recording import LabelledRecording
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.core.training import NetworkConfig, fit_network

SHARES = (1.0, 0.75, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one seed instead of five")
    seeds = range(1 if parser.parse_args().quick else 5)
    rows = []
    for name, cases in (
        ("eGaIn S1 to S2", egain_cases),
        ("eGaIn S2 to S1", back_cases),
        ("simulated lot, stage known", stage_cases),
        ("insole, same programme", insole_cases),
    ):
        curves = np.array([curve(*case) for seed in seeds for case in cases(seed)])
        rows.append((name, *(float(x) for x in np.nanmedian(curves, axis=0))))
    print("after / own against the share of the unit's samples, medians:\n")
    print_table(("unit", *(f"{share:.0%}" for share in SHARES)), rows)


def curve(source: LabelledRecording, unit: LabelledRecording, test: LabelledRecording, seed: int) -> list[float]:
    """After / own per share; NaN where the recording is refused."""
    config = NetworkConfig(seed=seed)
    network, own = fit_network(source, config).network, own_error(unit, test, config)
    ratios = []
    for share in SHARES:
        try:
            part = unit.part(0, max(15, round(share * len(unit)))).unlabelled
            unit_map = choose_map(FitProblem(source, network, part, seed=seed)).unit_map
        except SoftcalError:
            ratios.append(float("nan"))
            continue
        ratios.append(rmse(network.evaluate(unit_map.apply(test.windows)), test.window_reference) / own)
    return ratios


Case = tuple[LabelledRecording, LabelledRecording, LabelledRecording, int]


def egain_cases(seed: int, source: str = "S1", target: str = "S2") -> list[Case]:
    return [(egain(source).part(0, 800), egain(target).part(0, 800), egain(target).part(800, 1200), seed)]


def back_cases(seed: int) -> list[Case]:
    return egain_cases(seed, "S2", "S1")


def stage_cases(seed: int) -> list[Case]:
    lot = simulate_lot(seed, LotDesign(good=1, has_stage=True))
    audit = lot.units[0].audit
    cut = 3 * len(audit) // 4
    return [(lot.source, audit.part(0, cut), audit.part(cut, len(audit)), seed)]


def insole_cases(seed: int) -> list[Case]:
    day = insole("calibration")
    train, test = split(len(day))
    return [(taxel(day, "taxel_060", train), taxel(day, "taxel_030", train), taxel(day, "taxel_030", test), seed)]


if __name__ == "__main__":
    main()
