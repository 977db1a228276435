"""How long must a unit be pressed? Error of its map against seconds and compressions, and what a line makes per hour.

python benchmarks/station_seconds.py [--quick]

One simulated lot is pressed over its serial lines; each unit's recording is cut to its first seconds.
"""

import argparse

import numpy as np

from softcal.app.line.demo import PressTimes, RecordedLot, press_simulated_lot
from softcal.core.errors import UnitRefused
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import OutputRecording
from softcal.core.simulated_lot import draw_twins
from softcal.core.unit.calibrate import UnitProblem, calibrate
from softcal.core.unit.scoring import score_map
from softcal.core.unit.source_model import SourceModel, make_source_model

SECONDS = (10.0, 15.0, 25.0, 40.0, 60.0, 90.0, 150.0)
BESIDE_S = 11.0
"""Homing once, approach, zero, contact, settling and zero return; `station_soak.py` measures it."""


def main() -> None:
    """Press one lot and print the curve."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two units, a small network")
    parser.add_argument("--seed", type=int, default=7, help="of the lot (default 7; the demo's is another)")
    options = parser.parse_args()
    units, config = (2, NetworkConfig(hidden=(32, 16))) if options.quick else (6, NetworkConfig())
    serials = [f"U{k}" for k in range(units + 1)]
    twins = draw_twins(np.random.default_rng(options.seed), units + 1)
    lot = press_simulated_lot(twins, serials, options.seed, PressTimes(300.0, max(SECONDS), 90.0))
    network = fit_network(lot.source, config).network
    model = make_source_model(lot.source, network)
    own = {serial: _own_error(lot, network, model, serial, config) for serial in lot.units}
    print("| pressed, s | compressions | after/own of each unit | median | worst | passed | s per unit | units per h |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for seconds in SECONDS:
        ratios, passed = [], 0
        for serial, unit in lot.units.items():
            cut = unit.part(0, int(seconds * unit.sample_rate_Hz))
            try:
                calibration = calibrate(UnitProblem(model, cut))
            except UnitRefused:
                ratios.append(float("nan"))
                continue
            after = score_map(network, calibration.unit_map, lot.audits[serial], None).after
            ratios.append(after / own[serial])
            passed += calibration.decision.verdict == "pass"
        presses = np.median([_compressions(u.part(0, int(seconds * u.sample_rate_Hz))) for u in lot.units.values()])
        each = " ".join(f"{ratio:.2f}" for ratio in ratios)
        all_s = seconds + BESIDE_S
        print(
            f"| {seconds:g} | {presses:.0f} | {each} | {np.nanmedian(ratios):.2f} | {np.nanmax(ratios):.2f} | "
            f"{passed} of {units} | {all_s:.0f} | {3600 / all_s:.0f} |",
            flush=True,
        )


def _own_error(lot: RecordedLot, network: Network, model: SourceModel, serial: str, config: NetworkConfig) -> float:
    """Error of a calibration of the unit's own, on the rows that score its maps."""
    calibration = calibrate(UnitProblem(model, lot.units[serial]))
    return float(score_map(network, calibration.unit_map, lot.audits[serial], config).own or np.nan)


def _compressions(unit: OutputRecording) -> int:
    """Presses that begin within the recording, counted where the stage crosses a third of the depth downward."""
    stage_mm = unit.stage_mm
    level_mm = stage_mm.max() / 3
    return int(np.count_nonzero((stage_mm[:-1] < level_mm) & (stage_mm[1:] >= level_mm)))


if __name__ == "__main__":
    main()
