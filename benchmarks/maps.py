"""Maps of units that give few samples, and of simulated lots that were pressed otherwise than their source.

python benchmarks/maps.py samples [--quick]
python benchmarks/maps.py shift [--quick] [--units N]
"""

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from common.command import Commands
from common.map_methods import METHODS, NETWORK, egain, insole, own_error, split, summary, taxel, verdict_word
from common.tables import print_table

from softcal.core.errors import SoftcalError
from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import SHIFTS, LotDesign, simulate_lot
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.windows import TAPS

SHARES = (1.0, 0.75, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01)


def samples(options: argparse.Namespace) -> None:
    """The paper's Table 2: error against the share of the unit's samples that the map may see.

    Read twice: the *first* part of the unit's recording, as a line that stops early would record it; and *scattered*
    windows, 15 samples each, drawn over the whole recording. Own calibration has all samples.
    """
    seeds = range(1 if options.quick else 5)
    rows = []
    for name, cases in (
        ("eGaIn S1 to S2", egain_cases),
        ("eGaIn S2 to S1", back_cases),
        ("simulated lot, stage known", stage_cases),
        ("insole, same programme", insole_cases),
    ):
        for part in (first, scattered):
            curves = np.array([curve(part, *case) for seed in seeds for case in cases(seed)])
            refused = np.isnan(curves).all(axis=0)
            medians = np.where(refused, np.nan, np.nanmedian(np.where(refused, 0.0, curves), axis=0))
            rows.append((name, part.__name__, *("refused" if np.isnan(x) else float(x) for x in medians)))
    print("after / own against the share of the unit's samples, medians:\n")
    print_table(("unit", "samples", *(f"{share:.0%}" for share in SHARES)), rows)


Part = Callable[[OutputRecording, float, int], OutputRecording]


def first(recording: OutputRecording, share: float, seed: int) -> OutputRecording:
    """The first samples of a recording."""
    return recording.part(0, max(TAPS, round(share * len(recording))))


def scattered(recording: OutputRecording, share: float, seed: int) -> OutputRecording:
    """Windows drawn over the whole recording, in time order."""
    blocks = len(recording) // TAPS
    blocks_drawn = np.random.default_rng(seed).choice(blocks, max(1, round(share * blocks)), replace=False)
    rows = (TAPS * np.sort(blocks_drawn)[:, None] + np.arange(TAPS)).ravel()
    stage_mm = None if recording.stage_mm is None else recording.stage_mm[rows]
    return replace(recording, t_s=recording.t_s[rows], output=recording.output[rows], stage_mm=stage_mm)


def curve(
    part: Part, source: LabelledRecording, unit: LabelledRecording, test: LabelledRecording, seed: int
) -> list[float]:
    """After / own per share; NaN where the recording is refused."""
    config = NetworkConfig(seed=seed)
    network, own_rmse = fit_network(source, config).network, own_error(unit, test, config)
    ratios = []
    for share in SHARES:
        try:
            partial = part(unit.unlabelled, share, seed)
            unit_map = choose_map(FitProblem(source, network, partial, seed=seed)).unit_map
        except SoftcalError:
            ratios.append(float("nan"))
            continue
        ratios.append(rmse(network.evaluate(unit_map.apply(test.windows)), test.window_reference) / own_rmse)
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


METHODS_SHOWN = ("before (no map)", "softcal default", "monotone", "ot.da.EMDTransport", "ot.da.LinearTransport")
UNITS_PER_LOT = 5


def shift(options: argparse.Namespace) -> None:
    """Simulated lots, units pressed otherwise than their source: lighter, harder, half the range, other dwell."""
    lots = 1 if options.quick else max(1, options.units // UNITS_PER_LOT)
    for has_stage in (True, False):
        rows = [(name, *line(name, has_stage, lots)) for name in SHIFTS]
        print(f"Stage position {'known' if has_stage else 'unknown'}, after / own, median (95 %):\n")
        print_table(("load of the units", *METHODS_SHOWN, "families taken", "verdicts"), rows)


def line(shift: str, has_stage: bool, lots: int) -> list[str]:
    """One kind of shift: median and 95th percentile per method, what the default chose and what it says of it."""
    ratios: dict[str, list[float]] = {}
    families, verdicts = Counter[str](), Counter[str]()
    for seed in range(lots):
        lot = simulate_lot(seed, LotDesign(good=UNITS_PER_LOT, shift=shift, has_stage=has_stage))
        trained = fit_network(lot.source, NETWORK)
        network, model = (
            trained.network,
            make_source_model(lot.source, trained.network, trained.validation_rows, method=Method()),
        )
        for unit in lot.units:
            cut = 3 * len(unit.audit) // 4
            train, test = unit.audit.part(0, cut), unit.audit.part(cut, len(unit.audit))
            problem, own_rmse = FitProblem(lot.source, network, unit.recording), own_error(train, test, NETWORK)
            for name in METHODS_SHOWN:
                ratios.setdefault(name, []).append(rmse(METHODS[name](problem, test), test.window_reference) / own_rmse)
            families[choose_map(problem).family] += 1
            verdicts[verdict_word(problem, model)] += 1
    cells = [summary(ratios[name]) for name in METHODS_SHOWN]
    counts = [
        ", ".join(f"{name} {count}" for name, count in sorted(counter.items())) for counter in (families, verdicts)
    ]
    return [f"{m:.2f} ({p:.2f})" for m, p, _ in cells] + counts


def main() -> None:
    every = Commands(__doc__)
    every.add(samples, "one seed instead of five")
    every.add(shift, "one lot of five units per line").add_argument("--units", type=int, default=100)
    every.run()


if __name__ == "__main__":
    main()
