"""Beside gap.py: units of a lot together, calibration on a rig, drawn simulators, and the withheld check.

python benchmarks/gap_rigs.py lot --line tenth --seeds 7100 7101 7102 --units 4
python benchmarks/gap_rigs.py lot --line usual --seeds 7200 7201 --units 3 --calibration
python benchmarks/gap_rigs.py transfer --cases 6 --units 3 --seed 4000
python benchmarks/gap_rigs.py plants               10 plants that chose nothing; --first 6000: others
python benchmarks/gap_rigs.py measured             measured systems beside plain least squares, on runs held out
python benchmarks/gap_rigs.py presence             drawn mechanisms with a rest: are probabilities what they say?
python benchmarks/gap_rigs.py withheld             the effect at work taken out of the catalogue: is another one named?
python benchmarks/gap_rigs.py blind                a fresh seed of 128 bits, printed; --seed 7: the same rigs again
"""

import argparse
import json
import secrets
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from common.command import Commands, ResultCache
from common.drawn_mechanisms import LAWS, draw_mechanism
from common.gap_cases import as_case
from common.least_squares import best_sets, error_of
from common.lot_draw import draw_lot
from common.measured_rigs import MeasuredRig, data_folder, measured_rigs
from common.tables import print_table

from softcal.app.cli.main import main as softcal
from softcal.app.gap.challenge import open_challenge
from softcal.core.challenge.answers import CaseScore, read_answer
from softcal.core.challenge.case_generator import SEED_BITS, draw_case
from softcal.core.challenge.cases import LotRun, SealedCase, press_lot
from softcal.core.challenge.score import (
    MIN_SHARES,
    ScoreSheet,
    calibration_error,
    log_score,
    score_reports,
    shortfalls,
)
from softcal.core.errors import InputError
from softcal.core.gap.diagnosis import Diagnosis
from softcal.core.gap.fault_location import explained_twin
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.gap.twin import TwinModel, diagnose
from softcal.core.lot_diagnosis import LotDiagnosis, diagnose_lot
from softcal.core.metrics import wilson
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.transfer import CalibrationWorth, LotUnit, PressedLot, Transfer, calibration_worth
from softcal.core.transfer import transfer as transferred
from softcal.core.twin.catalogue import EFFECTS

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests import drawn_plants  # noqa: E402

Row = tuple[object, ...]

# Units of a lot.

OUTCOME_NAMES = ("right", "ambiguous", "unknown", "not seen", "wrong")


def lot(options: argparse.Namespace) -> None:
    """Units of a lot diagnosed together beside each alone, and what the shared cause is worth to a calibration.

    Every lot: one hidden cause for all its units, a size, a noise and recordings of its own for each. `right`: the
    hidden causes and no other, without doubt. `ambiguous`: they are among the sets held open.
    """
    alone, together, worths = Counter[str](), Counter[str](), list[tuple[str, CalibrationWorth]]()

    def rows() -> Iterator[Row]:
        for seed in options.seeds:
            units = draw_lot(seed, options.line, options.units)
            hidden = {cause.effect for cause in units[0].causes}
            lot_diagnosis = diagnose_lot({sealed.name: as_case(sealed, sealed.plans) for sealed in units})
            ones = [member.diagnosis for member in lot_diagnosis.members]
            outcomes = [
                outcome_of(d.verdict, d.best.hypothesis.ids, [r.hypothesis.ids for r in d.competing_hypotheses], hidden)
                for d in ones
            ]
            whole = outcome_of(lot_diagnosis.verdict, lot_diagnosis.causes, lot_diagnosis.competing_hypotheses, hidden)
            alone.update(outcomes)
            together[whole] += 1
            hypotheses_text, outliers_text = (
                " / ".join(" + ".join(r) for r in lot_diagnosis.competing_hypotheses),
                ", ".join(lot_diagnosis.outliers),
            )
            yield seed, " + ".join(sorted(hidden)), ", ".join(outcomes), whole, hypotheses_text, outliers_text
            if options.calibration:
                worths.extend((" + ".join(sorted(hidden)), worth) for worth in worth_of(lot_diagnosis, units))

    print_table("seed | hidden | each unit alone | the lot | named | outliers", rows())
    counts = (("units alone", alone), ("lots", together))
    print_table(("", *OUTCOME_NAMES), ((name, *(counter[word] for word in OUTCOME_NAMES)) for name, counter in counts))
    if worths:
        print_worths(worths)


def outcome_of(verdict: str, best: Sequence[str], competitors: Sequence[Sequence[str]], hidden: set[str]) -> str:
    """Return how an answer stands to the hidden causes."""
    if verdict in ("unknown", "data"):
        return "unknown"
    if len(competitors) > 1 and any(set(ids) == hidden for ids in competitors):
        return "ambiguous"
    if set(best) == hidden and len(competitors) <= 1:
        return "right"
    return "wrong" if best else "not seen"


def worth_of(lot_diagnosis: LotDiagnosis, lot: Sequence[SealedCase]) -> list[CalibrationWorth]:
    """Return what the shared causes are worth to each unit that follows them."""
    out = []
    for sealed, member in zip(lot, lot_diagnosis.members, strict=True):
        if lot_diagnosis.verdict in ("explained", "ambiguous") and member.follows and member.fit is not None:
            audit = as_case(sealed, [sealed.kept_back])
            out.append(calibration_worth(sealed.name, member.diagnosis.case, audit, member.fit))
    return out


def print_worths(worths: Sequence[tuple[str, CalibrationWorth]]) -> None:
    print("Errors of f on the audit, RMS in N\n")
    head = "hidden | unit | nominal twin | explained twin | 1, 2, … rig recordings | worth | saves"
    print_table(head, (_worth_row(hidden, worth) for hidden, worth in worths))
    every = [worth for _, worth in worths]
    nominal, explained = (np.median([getattr(w, which) for w in every]) for which in ("nominal", "explained"))
    rig = _listed(np.median([w.rig for w in every], axis=0))
    print(f"Medians: nominal twin {nominal:.3f}, explained twin {explained:.3f}, rig {rig}.")
    saved, plain = sum(w.saves for w in every), sum(w.nominal_saves for w in every)
    print(f"Recordings saved over {len(every)} units: explained twin {saved}, nominal twin {plain}.")


def _worth_row(hidden: str, w: CalibrationWorth) -> Row:
    worth = str(w.worth) if w.worth else f"more than {len(w.rig)}"
    return hidden, w.unit, f"{w.nominal:.3f}", f"{w.explained:.3f}", _listed(w.rig), worth, w.saves


def _listed(errors: Iterable[float]) -> str:
    return " / ".join(f"{error:.3f}" for error in errors)


# Calibration on a rig whose cause is withheld.

EPISODIC = ("dropped_samples", "intermittent_contact")
MEASURES = {"before": "without a map", "after": "with the map", "own": "own calibration"}


def transfer(options: argparse.Namespace) -> None:
    """How far calibration errors in simulation predict those on a rig, before and after its diagnosis.

    Every case: a sealed rig with one effect of the usual size, diagnosed from its four runs; then a lot of units
    pressed on the same rig, and lots simulated with the refitted base and with the explained twin.
    """
    seed = secrets.randbits(24) if options.seed is None else options.seed
    last = seed + options.cases - 1
    print(f"Seeds {seed} to {last}, {options.units} units each; errors in N: rig / base / explained\n")
    off: dict[str, list[tuple[float, float]]] = {name: [] for name in MEASURES}

    def rows() -> Iterator[Row]:
        for effect, verdict, transfer_result in transfers(range(seed, last + 1), options.units):
            errors = {}
            for name, *three, of_base, of_twin in transfer_result.rows():
                off[name].append((of_base, of_twin))
                errors[name] = _listed(three)
            yield effect, verdict, *(errors[name] for name in MEASURES)

    print_table(("hidden effect", "verdict", *MEASURES.values()), rows())
    for name, word in MEASURES.items():
        if off[name]:
            base, twin = np.median(np.array(off[name]), axis=0)
            print(f"{word}: foretold to {base:.0%} by the refitted base, {twin:.0%} by the explained twin (medians)\n")


def rig_lot(sealed: SealedCase, units: int) -> PressedLot:
    """Return a lot pressed on a sealed rig as the calibration takes it."""
    runs: dict[tuple[str, str], LotRun] = {(r.folder, r.serial): r for r in press_lot(sealed, units)}
    serials = [serial for folder, serial in runs if folder == "units"]
    pressed_lot = tuple(
        LotUnit(labelled(runs["units", s], sealed).unlabelled, labelled(runs["audit", s], sealed)) for s in serials
    )
    return PressedLot(labelled(runs["source", "R00"], sealed), pressed_lot)


def labelled(run: LotRun, sealed: SealedCase) -> LabelledRecording:
    columns, rate_Hz = run.measured.columns, sealed.rig.sample_rate_Hz
    raw = OutputRecording(run.serial, columns["t_s"], columns["output_V"], rate_Hz, stage_mm=columns["stage_mm"])
    return LabelledRecording(raw, columns["force_N"])


def transfers(seeds: Iterable[int], units: int) -> Iterable[tuple[str, str, Transfer]]:
    """Yield truth, verdict and transfer of every case whose cause a new recording would show again."""
    for seed in seeds:
        sealed = draw_case(seed, f"rig-{seed}", "usual")
        if sealed.causes[0].effect in EPISODIC:
            continue
        diagnosis = diagnose(as_case(sealed, sealed.plans))
        try:
            pressed_lot = rig_lot(sealed, units)
            yield (
                sealed.causes[0].effect,
                diagnosis.verdict,
                transferred(pressed_lot, explained_twin(diagnosis.base), explained_twin(diagnosis.best)),
            )
        except (InputError, ValueError) as error:
            print(f"seed {seed}, {sealed.causes[0].effect}: no lot: {error}")


# Drawn simulators with a badly kept rig.

PLANT_LINES = {"a curve, noise 0.4 %": (0.004, False), "straight lines, noise 0.05 %": (0.0005, True)}
"""How a late clock shifts a channel between its samples, and how much noise there is."""

PLANTED = ("none", "cubic", "slow_part", "late")


OUTCOMES = ("right", "set", "honest", "missed", "wrong")


def plants(options: argparse.Namespace) -> None:
    """Drawn simulators with a badly kept rig: is a cause named that each run may have of its own, and is it true?

    Each plant is a lag, with or without a ringing part, an own zero and a bent sensor. Every run is late by up to 0.1 s
    and has a zero, a gain and a drift of its own; all four are stated as allowed. On the last line the true cause, a
    cubic drive, has no candidate, and a dead band resembles it: right is `unknown`. Plants 0 to 13, 200 to 209 and 900
    to 904 chose constants or are used by tests. Plants from 5000 on chose nothing.
    """
    counts: dict[tuple[str, str], Counter[str]] = {}
    wrong = []
    for line, hidden, seed, diagnosis in score_plants(range(options.first, options.first + options.count)):
        counts.setdefault((line, hidden), Counter())[diagnosis] += 1
        wrong += [f"plant {seed}, {line}, {hidden}"] if diagnosis == "wrong" else []
    rows = ((*of, *(counter[word] for word in OUTCOMES)) for of, counter in counts.items())
    print_table(("delay between samples", "hidden", *OUTCOMES), rows)
    print("wrong: " + ("; ".join(wrong) or "none"))


def score_plants(seeds: range) -> Iterator[tuple[str, str, int, str]]:
    """Yield line, hidden cause, plant and outcome."""
    for seed in seeds:
        for line, (noise, is_linear) in PLANT_LINES.items():
            for hidden in PLANTED:
                diagnosis = drawn_plants.diagnosed(seed, noise, is_linear, hidden)
                true = {hidden} - {"none", *drawn_plants.ALIASES}
                yield line, hidden, seed, outcome(diagnosis, drawn_plants.likely_causes(diagnosis), true)
        diagnosis = drawn_plants.blind(seed)
        # Right for a cause without a candidate is that nothing explains it.
        word = (
            "wrong"
            if drawn_plants.likely_causes(diagnosis)
            else "right"
            if diagnosis.verdict == "unknown"
            else "missed"
        )
        yield "no candidate for it", "cubic", seed, word


def outcome(diagnosis: Diagnosis, named_causes: set[str], true: set[str]) -> str:
    """Return how an answer stands to the hidden causes."""
    if diagnosis.verdict == "ambiguous" and true and true <= named_causes:
        return "set"
    if named_causes == true and diagnosis.verdict == ("explained" if true else "no_gap"):
        return "right"
    if named_causes - true:
        return "wrong"
    return "honest" if diagnosis.verdict == "unknown" else "missed"


# Measured systems, and mechanisms with a rest that has no name.


def measured(options: argparse.Namespace) -> None:
    """Measured systems beside plain least squares over every set of up to three causes, on runs no fit has seen.

    Root mean square of the channel on the runs held out. The least squares choose their set by that error, which no
    diagnosis may see: they are a bound, not a rival.
    """
    rigs = measured_rigs()

    def rows() -> Iterator[Row]:
        for name in options.rigs or rigs:
            rig, folder = rigs[name], data_folder() / "rigs" / name
            fitted, held_out = rig.runs(folder, rig.fitted), rig.runs(folder, rig.held_out)
            report: Any = diagnose_simulator(rig.simulator, fitted).report()
            base, explained_error = (
                error_of(rig.simulator, held_out, numbers_of(rig, report[k])) for k in ("base", "parameters")
            )
            ids, _, min_error = best_sets(rig.simulator, fitted, held_out, options.starts)[0]
            sure = [f"{c['effect']} {c['probability']:.2f}" for c in report["causes"] if c["probability"] >= 0.5]
            in_set = " + ".join(c["effect"] for c in report["causes"] if c["shrink"] is not None)
            reported = (report["verdict"], f"{report['list_complete']:.2f}", ", ".join(sure), in_set)
            yield (
                name,
                *reported,
                base,
                explained_error,
                min_error,
                " + ".join(ids),
                f"{100 * (explained_error / min_error - 1):+.1f} %",
            )

    head = "system | verdict | list complete | named at 0.5 | set | base | set, held out | best least squares | its set"
    print_table(f"{head} | set against it", rows())


def numbers_of(rig: MeasuredRig, parameters: Mapping[str, float | None]) -> dict[str, float]:
    """Return the parameters of a report as the simulator takes them."""
    off = rig.simulator.neutral_values
    return {name: off[name] if value is None else value for name, value in parameters.items()}


NAMED_EDGES = (0.05, 0.2, 0.5, 0.9, 1.0)


def presence(options: argparse.Namespace) -> None:
    """Drawn mechanisms: are stated probabilities what they say where a rest is left that has no name?

    A rest of 5 to 40 % of the gap's energy: a law that is not in the list, the law of a cause that changes with the
    place, or a wander. `--withheld`: the only law at work is left out of the list, each in turn, so that every name is
    wrong. Mechanisms 20200 to 20300 and, withheld, 21000 to 21083 chose the constants, by linear least squares over all
    sets in place of a search; those of 7000 to 7039 and 7200 to 7299 were looked at for what counts. Others from 7300
    on, and from 8200 on, chose nothing.
    """
    probabilities, present, inside, false_names, verdicts = [], [], [], 0, Counter[str]()
    cache = ResultCache(options.kept)
    for k, seed in enumerate(range(options.first, options.first + options.count)):
        law = list(LAWS)[k % len(LAWS)] if options.withheld else None
        outcome_read = cache.get(f"{seed} {law}", lambda: score_mechanism(seed, law))  # noqa: B023
        verdicts[f"{outcome_read['rest']}: {outcome_read['verdict']}"] += 1
        probabilities += outcome_read["chances"].values()
        present += [effect in outcome_read["present"] for effect in outcome_read["chances"]]
        false_names += any(p >= 0.5 for i, p in outcome_read["chances"].items() if i not in outcome_read["present"])
        inside += [] if outcome_read["is_inside"] is None else [outcome_read["is_inside"]]
    p, at_work = np.array(probabilities), np.array(present, dtype=np.float64)
    rows = []
    for low, high in pairwise(NAMED_EDGES):
        here = (p >= low) & ((p < high) | (high == 1.0))
        if here.any():
            rows.append(
                (f"{low:g} to {high:g}", int(here.sum()), f"{p[here].mean():.2f}", f"{at_work[here].mean():.2f}")
            )
    print(f"Mechanisms {options.first} to {options.first + options.count - 1}\n")
    print_table("stated probability | causes | mean stated | at work", rows)
    low, high = wilson(false_names, options.count)
    false_text = f"{false_names} of {options.count} ({100 * low:.0f} to {100 * high:.0f} %)"
    print(f"A cause that is not there is named at 0.5 or more in {false_text} mechanisms.\n")
    print(f"Calibration error {calibration_error(p, at_work):.3f}; log score {log_score(p, at_work):.2f} nats.\n")
    print(f"Held-out shrink within the forecast's interval: {sum(inside)} of {len(inside)}.\n")
    print_table("rest and verdict | mechanisms", sorted(verdicts.items()))


def score_mechanism(seed: int, law: str | None) -> dict[str, Any]:
    """Return what a diagnosis says of a drawn mechanism, and what is there."""
    drawn_case = draw_mechanism(seed, law)
    diagnosis = diagnose_simulator(drawn_case.simulator, drawn_case.runs)
    shrink, is_inside = diagnosis.explained_fraction, None
    if shrink.low is not None and shrink.high is not None and diagnosis.best.ids:
        is_inside = shrink.low <= shrink.held_out <= shrink.high
    chances = {c.effect: c.probability for c in diagnosis.causes}
    stored = {"chances": chances, "present": sorted(drawn_case.present), "rest": drawn_case.rest}
    return stored | {"verdict": diagnosis.verdict, "is_inside": is_inside}


# The catalogue without the effect at work.


def withheld(options: argparse.Namespace) -> None:
    """Rigs with one effect of the usual size that is taken out of the catalogue: whatever is named then is wrong.

    Right is `unknown`, or `explained_in_part`, with the stage of the effect first. Rigs from 5000 on chose nothing.
    """
    cache, outcomes = ResultCache(options.kept), list[dict[str, Any]]()

    def rows() -> Iterator[Row]:
        for seed in range(options.first, options.first + options.count):
            read = cache.get(str(seed), lambda: score_withheld(seed))  # noqa: B023
            outcomes.append(read)
            named = ", ".join(f"{i} {p:.2f}" for i, p in read["named"].items())
            yield seed, read["hidden"], read["verdict"], named, read["stage"], "yes" if read["is_located"] else "no"

    print(f"Rigs {options.first} to {options.first + options.count - 1}\n")
    print_table("rig | effect taken out | verdict | named at 0.5 | first stage | its stage", rows())
    for text, hits in (
        ("Another effect is named at 0.5 or more", [bool(one["named"]) for one in outcomes]),
        (
            "Another effect is named at 0.9 or more",
            [max(one["named"].values(), default=0.0) >= 0.9 for one in outcomes],
        ),
        ("The stage of the effect comes first", [one["is_located"] for one in outcomes]),
    ):
        low, high = wilson(sum(hits), len(hits))
        print(f"{text}: {sum(hits)} of {len(hits)} ({100 * low:.0f} to {100 * high:.0f} %).\n")


def score_withheld(seed: int) -> dict[str, Any]:
    """Return what a diagnosis says of a rig whose effect is not in its list."""
    sealed = draw_case(seed, f"rig-{seed}", "usual")
    hidden = sealed.causes[0].effect
    listed = {name: effect for name, effect in EFFECTS.items() if name != hidden}
    diagnosis = diagnose(as_case(sealed, sealed.plans), model=TwinModel(listed))
    named = {c.effect: c.probability for c in diagnosis.causes if c.probability >= 0.5}
    stage = diagnosis.locations[0].stage if diagnosis.locations else ""
    is_located = stage == EFFECTS[hidden].stage
    return {"hidden": hidden, "verdict": diagnosis.verdict, "named": named, "stage": stage, "is_located": is_located}


# The withheld check.

CASES = 4
FORM_CASES = 8
"""One in eight ends as an honest set or lies below the noise: four cases might miss the floor by chance."""

PUBLISHED_CASES = 6
"""The floors of these lines are low: fewer cases might miss them by chance."""

WRONG = ("alarm", "wrong", "no report")
MAX_WRONG = 3
"""Two in a hundred may go astray; four of these would be no accident."""


def blind(options: argparse.Namespace) -> None:
    """The withheld check of the gap diagnosis with rigs that nobody chose: one answer by its exit code.

    Every line of the check is made, diagnosed and scored by the three commands of `softcal gap`. It fails where a line
    falls below its floor, or where four rigs or more get a wrong name. Nothing is drawn a second time.
    """
    seed = secrets.randbits(SEED_BITS) if options.seed is None else options.seed
    case_scores: list[CaseScore] = []
    with tempfile.TemporaryDirectory() as folder:
        for line in MIN_SHARES:
            case_scores += diagnosed(line, seed, Path(folder) / line)
            print(f"{line}: {', '.join(j.outcome for j in case_scores if j.label.case.line == line)}", flush=True)
    empty = score_reports([], {})
    short = shortfalls(
        ScoreSheet(tuple(case_scores), empty.rows, empty.detection, empty.probabilities, empty.fractions)
    )
    usual = [j for j in case_scores if not j.label.case.line.startswith("published")]
    wrong = [j for j in usual if j.outcome in WRONG]
    if len(wrong) > MAX_WRONG:
        short.append(f"{len(wrong)} of {len(usual)} rigs got a wrong name; {MAX_WRONG} at most were expected")
    for j in wrong:
        print(f"{j.label.case.line} {j.label.case.name}: {j.outcome}, hidden {[c.effect for c in j.label.case.causes]}")
    right = sum(j.outcome == "right" for j in case_scores)
    print(f"\nseed {seed}: {right} of {len(case_scores)} right, {len(wrong)} wrong\n" + "\n".join(short))
    sys.exit(1 if short else 0)


def case_count(line: str) -> int:
    """How many rigs are drawn of a line."""
    if line.startswith("published"):
        return PUBLISHED_CASES
    return FORM_CASES if line == "form" else CASES


def diagnosed(line: str, seed: int, folder: Path) -> list[CaseScore]:
    """Make, diagnose and score the rigs of one line, each by its command."""
    sealed, reports, seal = folder / "sealed", folder / "reports", folder / "labels.json"
    reports.mkdir(parents=True)
    count = ("--cases", str(case_count(line)), "--line", line, "--seed", str(seed))
    run("challenge", *count, "--out", str(sealed), "--seal", str(seal))
    for case in sorted(sealed.glob("case-*")):
        run("diagnose", str(case), "--json", str(reports / f"{case.name}.json"))
    run("score", str(sealed), "--reports", str(reports), "--seal", str(seal), "--json", str(folder / "score.json"))
    answers = {path.stem: json.loads(path.read_text()) for path in reports.glob("*.json")}
    labels = open_challenge(sealed, seal)
    return [CaseScore(label, read_answer(label.case.name, answers[label.case.name])) for label in labels]


def run(*outcomes: str) -> None:
    """Run one command of `softcal gap`; end where it fails."""
    if (code := softcal(["gap", *outcomes])) != 0:
        sys.exit(f"softcal gap {' '.join(outcomes)}: exit code {code}")


def main() -> None:
    every = Commands(__doc__)
    parser = every.add(lot)
    parser.add_argument("--line", default="tenth")
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--units", type=int, default=4)
    parser.add_argument("--calibration", action="store_true", help="also train f on twins and on the rig")
    parser = every.add(transfer)
    parser.add_argument("--cases", type=int, default=6)
    parser.add_argument("--units", type=int, default=3)
    parser.add_argument("--seed", type=int, help="first seed (default: chosen now)")
    parser = every.add(plants)
    parser.add_argument("--first", type=int, default=5000, help="first plant drawn")
    parser.add_argument("--count", type=int, default=10, help="how many plants")
    parser = every.add(measured)
    parser.add_argument("--rigs", nargs="+", metavar="NAME", help="these alone")
    parser.add_argument("--starts", type=int, default=2, help="starts of every least squares")
    parser = every.add(presence)
    parser.add_argument("--first", type=int, default=5000, help="first mechanism drawn")
    parser.add_argument("--count", type=int, default=60, help="how many mechanisms")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="results are kept here; a run cut off goes on")
    parser.add_argument("--withheld", action="store_true", help="leave the only law at work out of the list")
    parser = every.add(withheld)
    parser.add_argument("--first", type=int, default=5000, help="first rig drawn")
    parser.add_argument("--count", type=int, default=25, help="how many rigs")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="results are kept here; a run cut off goes on")
    parser = every.add(blind)
    parser.add_argument("--seed", type=int, help="repeat a draw (default: a fresh seed of 128 bits)")
    every.run()


if __name__ == "__main__":
    main()
