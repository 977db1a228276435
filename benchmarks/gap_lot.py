"""Units of a lot diagnosed together beside each alone, and what the shared cause is worth to a calibration.

    python benchmarks/gap_lot.py --line tenth --seeds 7100 7101 7102 --units 4
    python benchmarks/gap_lot.py --line usual --seeds 7200 7201 --units 3 --calibration

Every lot: one hidden cause for all its units, a size, a noise and recordings of its own for each. Prints Markdown, row
by row. `right`: the hidden causes and no other, without doubt. `ambiguous`: they are among the sets held open.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from common.lot_draw import draw_lot
from gap import as_case

from softcal.core.challenge.cases import SealedCase
from softcal.core.gap.shared_cause import LotDiagnosis, diagnose_lot
from softcal.core.gap.worth import CalibrationWorth, calibration_worth

WORDS = ("right", "ambiguous", "unknown", "not seen", "wrong")


def judged(verdict: str, best: Sequence[str], rivals: Sequence[Sequence[str]], hidden: set[str]) -> str:
    """Return how an answer stands to the hidden causes."""
    if verdict in ("unknown", "data"):
        return "unknown"
    if len(rivals) > 1 and any(set(ids) == hidden for ids in rivals):
        return "ambiguous"
    if set(best) == hidden and len(rivals) <= 1:
        return "right"
    return "wrong" if best else "not seen"


def worth_of(found: LotDiagnosis, lot: Sequence[SealedCase]) -> list[CalibrationWorth]:
    """Return what the shared causes are worth to each unit that follows them."""
    out = []
    for sealed, member in zip(lot, found.members, strict=True):
        if found.verdict in ("explained", "ambiguous") and member.follows and member.fit is not None:
            audit = as_case(sealed, [sealed.kept_back])
            out.append(calibration_worth(sealed.name, member.diagnosis.case, audit, member.fit))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--line", default="tenth")
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--units", type=int, default=4)
    parser.add_argument("--calibration", action="store_true", help="also train f on twins and on the rig")
    options = parser.parse_args()
    alone, together = dict.fromkeys(WORDS, 0), dict.fromkeys(WORDS, 0)
    worths: list[tuple[str, CalibrationWorth]] = []
    print("| seed | hidden | each unit alone | the lot | named | outliers |\n|---|---|---|---|---|---|")
    for seed in options.seeds:
        lot = draw_lot(seed, options.line, options.units)
        hidden = {cause.effect for cause in lot[0].causes}
        found = diagnose_lot({sealed.name: as_case(sealed, sealed.plans) for sealed in lot})
        words = []
        for one in (m.diagnosis for m in found.members):
            words.append(judged(one.verdict, one.best.hypothesis.ids, [r.hypothesis.ids for r in one.rivals], hidden))
            alone[words[-1]] += 1
        whole = judged(found.verdict, found.causes, found.rivals, hidden)
        together[whole] += 1
        named, odd = " / ".join(" + ".join(r) for r in found.rivals), ", ".join(found.outliers)
        row = (str(seed), " + ".join(sorted(hidden)), ", ".join(words), whole, named, odd)
        print(f"| {' | '.join(row)} |", flush=True)
        if options.calibration:
            worths += [(" + ".join(sorted(hidden)), w) for w in worth_of(found, lot)]
    print(f"\n| | {' | '.join(WORDS)} |\n|---|{'---|' * len(WORDS)}")
    for name, counts in (("units alone", alone), ("lots", together)):
        print(f"| {name} | {' | '.join(str(counts[w]) for w in WORDS)} |")
    if worths:
        print("\nErrors of f on the audit, RMS in N\n")
        print("| hidden | unit | nominal twin | explained twin | 1, 2, … rig recordings | worth | saves |")
        print("|---|---|---|---|---|---|---|")
        for name, w in worths:
            rig = " / ".join(f"{error:.3f}" for error in w.rig)
            worth = str(w.worth) if w.worth else f"more than {len(w.rig)}"
            print(f"| {name} | {w.unit} | {w.nominal:.3f} | {w.explained:.3f} | {rig} | {worth} | {w.saves} |")
        every = [w for _, w in worths]
        errors = [float(np.median([getattr(w, which) for w in every])) for which in ("nominal", "explained")]
        rig = " / ".join(f"{error:.3f}" for error in np.median([w.rig for w in every], axis=0))
        print(f"\nMedians: nominal twin {errors[0]:.3f}, explained twin {errors[1]:.3f}, rig {rig}.")
        saved, plain = sum(w.saves for w in every), sum(w.nominal_saves for w in every)
        print(f"Recordings saved over {len(every)} units: explained twin {saved}, nominal twin {plain}.")


if __name__ == "__main__":
    main()
