"""How far calibration errors in simulation predict those on a rig whose cause is withheld, before and after diagnosis.

    python benchmarks/gap_transfer.py --cases 6 --units 3 --seed 4000

Every case: a sealed rig with one effect of the usual size, diagnosed from its four runs; then a lot of units pressed on
the same rig, and lots simulated with the refitted base and with the explained twin. Prints Markdown, row by row.
"""

import argparse
import secrets
from collections.abc import Iterable

import numpy as np
from gap import as_case

from softcal.core.challenge.cases import LotRun, SealedCase, press_lot
from softcal.core.challenge.draw import draw_case
from softcal.core.errors import InputError
from softcal.core.gap.diagnosis import diagnose
from softcal.core.gap.explained import explained_twin
from softcal.core.gap.transfer import LotUnit, PressedLot, Transfer, transfer
from softcal.core.recording import LabelledRecording, OutputRecording

EPISODIC = ("dropped_samples", "intermittent_contact")
MEASURES = {"before": "without a map", "after": "with the map", "own": "own calibration"}


def rig_lot(sealed: SealedCase, units: int) -> PressedLot:
    """Return a lot pressed on a sealed rig as the calibration takes it."""
    runs: dict[tuple[str, str], LotRun] = {(r.place, r.serial): r for r in press_lot(sealed, units)}
    serials = [serial for place, serial in runs if place == "units"]
    pressed = tuple(
        LotUnit(labelled(runs["units", s], sealed).unlabelled, labelled(runs["audit", s], sealed)) for s in serials
    )
    return PressedLot(labelled(runs["source", "R00"], sealed), pressed)


def labelled(run: LotRun, sealed: SealedCase) -> LabelledRecording:
    columns, rate_Hz = run.measured.columns, sealed.rig.sample_rate_Hz
    raw = OutputRecording(run.serial, columns["t_s"], columns["output_V"], rate_Hz, stage_mm=columns["stage_mm"])
    return LabelledRecording(raw, columns["force_N"])


def rows(seeds: Iterable[int], units: int) -> Iterable[tuple[str, str, Transfer]]:
    """Yield truth, verdict and transfer of every case whose cause a new recording would show again."""
    for seed in seeds:
        sealed = draw_case(seed, f"rig-{seed}", "usual")
        if sealed.causes[0].effect in EPISODIC:
            continue
        found = diagnose(as_case(sealed, sealed.plans))
        try:
            lot = rig_lot(sealed, units)
            yield sealed.causes[0].effect, found.verdict, transfer(lot, explained_twin(found.base), found.explained)
        except (InputError, ValueError) as error:
            print(f"seed {seed}, {sealed.causes[0].effect}: no lot: {error}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=6)
    parser.add_argument("--units", type=int, default=3)
    parser.add_argument("--seed", type=int, default=None, help="first seed (default: chosen now)")
    options = parser.parse_args()
    seed = secrets.randbits(24) if options.seed is None else options.seed
    print(
        f"Seeds {seed} to {seed + options.cases - 1}, {options.units} units each; errors in N: rig / base / explained\n"
    )
    words = " | ".join(MEASURES.values())
    print(f"| hidden effect | verdict | {words} |\n|---|---|{'---|' * len(MEASURES)}")
    off: dict[str, list[tuple[float, float]]] = {name: [] for name in MEASURES}
    for effect, verdict, found in rows(range(seed, seed + options.cases), options.units):
        table = {name: (rig, base, twin, a, b) for name, rig, base, twin, a, b in found.rows()}
        cells = [f"{table[n][0]:.3f} / {table[n][1]:.3f} / {table[n][2]:.3f}" for n in MEASURES]
        print(f"| {effect} | {verdict} | {' | '.join(cells)} |", flush=True)
        for name in MEASURES:
            off[name].append(table[name][3:])
    for name, word in MEASURES.items():
        if off[name]:
            base, twin = np.median(np.array(off[name]), axis=0)
            print(f"\n{word}: foretold to {base:.0%} by the refitted base, {twin:.0%} by the explained twin (medians)")


if __name__ == "__main__":
    main()
