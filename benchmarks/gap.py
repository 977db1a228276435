"""The diagnosis of the sim-to-real gap on withheld cases, drawn by a generator that shares no code with it.

    python benchmarks/gap.py --quick                      a few cases of every line
    python benchmarks/gap.py --cases 200                  the full tables
    python benchmarks/gap.py --cases 50 --lines usual form --seed 9000
    python benchmarks/gap.py --tables experiments speed   proposed experiments; seconds per case
    python benchmarks/gap.py --tables residual forms      twins with empirical terms, and with other forms, on a run
                                                          kept back

`--keep DIR --seed S` goes on where it was cut off. `--log FILE` appends one line per case that is not right.
"""

import secrets
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common.command import ResultCache, parser_of
from common.gap_cases import as_case, print_twins
from common.tables import print_table

from softcal.core.challenge.answers import CaseScore, read_answer
from softcal.core.challenge.case_generator import LINES, draw_case
from softcal.core.challenge.cases import EXPERIMENTS, RunPlan, SealedCase, distance_sigma
from softcal.core.challenge.explained_fraction import explained_fraction
from softcal.core.challenge.score import POOR, ScoreSheet, score_reports
from softcal.core.challenge.seal import Label
from softcal.core.gap.twin import diagnose
from softcal.core.metrics import finite_or_none, wilson

TABLES = ("lines", "detection", "sureness", "experiments", "speed", "residual", "forms")
USUAL_TABLES = TABLES[:5]
CATALOGUE_LINES = ("usual", "third", "tenth", "pair", "triple")
TARGETS = {
    ("usual", "cause first"): 99,
    ("usual", "stage"): 99,
    ("third", "cause first"): 97,
    ("tenth", "right or honest set or below noise"): 90,
    ("form", "cause first"): 95,
    ("pair", "right or honest set or below noise"): 95,
    ("triple", "right or honest set or below noise"): 85,
    ("none", "right"): 99,
    ("outside", "right or honest set or below noise"): 95,
    ("outside", "stage"): 90,
    **{(line, "right or abstaining"): 95 for line in POOR},
}


@dataclass(frozen=True)
class Diagnosed:
    """One case of the benchmark with its report, None where the diagnosis broke down, and what it took.

    Args:
        seconds: of processor time.
        realised: shrink on the run kept back, None where there is none to tell.
    """

    label: Label
    report: Mapping[str, Any] | None
    seconds: float
    realised: float | None = None


def diagnosed(sealed: SealedCase, plans: Sequence[RunPlan] | None = None) -> Diagnosed:
    """Diagnose a sealed case, with other runs than its own where given."""
    case = as_case(sealed, plans or sealed.plans)
    # Processor time: what a quiet machine would take at most, whoever else is at work on this one.
    start = time.process_time()
    report: Mapping[str, Any] | None = None
    try:
        report = diagnose(case).report()
    except Exception:
        traceback.print_exc()
    return Diagnosed(Label(sealed, "", distance_sigma(sealed)), report, time.process_time() - start)


def realised(sealed: SealedCase, report: Mapping[str, Any] | None) -> float | None:
    """Shrink on the run kept back, where a twin is named and the causes follow the equations of the catalogue."""
    if report is None or sealed.line not in CATALOGUE_LINES or report["verdict"] not in ("explained", "ambiguous"):
        return None
    return finite_or_none(explained_fraction(sealed, report))


def load_or_diagnose(sealed: SealedCase, cache: ResultCache, experiment: RunPlan | None = None) -> Diagnosed:
    """Diagnose a case, with one more run where given, or take it from the cases done by this revision."""

    def made() -> dict[str, Any]:
        diagnosed_case = diagnosed(sealed, None if experiment is None else (*sealed.plans, experiment))
        shrink = None if experiment else realised(sealed, diagnosed_case.report)
        content = {"report": diagnosed_case.report, "seconds": diagnosed_case.seconds, "realised": shrink}
        return content | {"distance_sigma": diagnosed_case.label.distance_sigma}

    content = cache.get(sealed.name if experiment is None else f"{sealed.name}+{experiment.protocol}", made)
    label = Label(sealed, "", content["distance_sigma"])
    return Diagnosed(label, content["report"], content["seconds"], content["realised"])


def run_lines(lines: Sequence[str], count: int, seed: int, log: Path | None, cache: ResultCache) -> list[Diagnosed]:
    """Diagnose `count` fresh cases of every line; a line's rows are printed when it is through."""
    cases: list[Diagnosed] = []
    for line in lines:
        for number in range(count):
            cases.append(load_or_diagnose(draw_case(seed + number, f"{line}-{seed + number}", line), cache))
            print(f"\r{line} {number + 1}/{count} ", end="", file=sys.stderr, flush=True)
            _log(cases[-1], log)
        here, seconds = cases[-count:], [d.seconds for d in cases[-count:]]
        print_lines(scored(here))
        middle, p90_s = np.median(seconds), np.quantile(seconds, 0.9)
        print(f"{line}: seconds of processor time per case {middle:.1f} (median), {p90_s:.1f} (90 %)\n", flush=True)
    return cases


def scored(cases: Sequence[Diagnosed]) -> ScoreSheet:
    reports = {d.label.case.name: d.report for d in cases if d.report is not None}
    realised_fractions = {d.label.case.name: np.nan if d.realised is None else d.realised for d in cases}
    return score_reports([d.label for d in cases], reports, lambda label, _: realised_fractions[label.case.name])


def _log(diagnosed_case: Diagnosed, log: Path | None, what: str = "") -> None:
    if log is None:
        return
    if diagnosed_case.report is None:
        with log.open("a") as file:
            file.write(f"{diagnosed_case.label.case.name}{what}: no report; its traceback is on standard error\n")
        return
    case_score = CaseScore(diagnosed_case.label, read_answer(diagnosed_case.label.case.name, diagnosed_case.report))
    if case_score.outcome in ("right", "below noise") and not what:
        return
    likely = {
        c["effect"]: round(c["probability"], 2) for c in diagnosed_case.report["causes"] if c["probability"] > 0.02
    }
    truth = " + ".join(f"{cause.effect} ({cause.form})" for cause in diagnosed_case.label.case.causes) or "none"
    truth += f", {diagnosed_case.label.case.mistake}" if diagnosed_case.label.case.mistake else ""
    mistakes = [(d["what"], d["channel"], d["runs"], d["factor"]) for d in diagnosed_case.report["data"]]
    with log.open("a") as file:
        file.write(
            f"{diagnosed_case.label.case.name}{what}: {case_score.outcome}; "
            f"truth {truth}, {diagnosed_case.label.distance_sigma:.0f} sigma; "
            f"said {diagnosed_case.report['verdict']} {likely} {diagnosed_case.report['ambiguous_with']} "
            f"{mistakes}; {diagnosed_case.seconds:.1f} s\n"
        )


def print_lines(sheet: ScoreSheet) -> None:
    """Print every measure of every line with its 95 % interval and its target."""
    rows = []
    for row in (row for row in (*sheet.rows, *sheet.fractions.rows) if row.count):
        target = TARGETS.get((row.line, row.measure))
        cells = f"{row.hits}/{row.count}", f"{100 * row.share:.1f} %", interval_text(*row.interval)
        rows.append((row.line, row.measure, *cells, "" if target is None else f"≥ {target} %"))
    print_table("line | measure | hits | share | 95 % interval | target", rows)


def interval_text(low: float, high: float) -> str:
    return f"{100 * low:.0f}–{100 * high:.0f} %"


def print_detection(sheet: ScoreSheet) -> None:
    """Print named / cases by distance from the noise after a base refit, per effect."""
    edges = sorted({(d.from_sigma, d.to_sigma) for d in sheet.detection})
    cells = {(d.effect, d.from_sigma): f"{d.named}/{d.count}" for d in sheet.detection}
    effects = sorted({d.effect for d in sheet.detection})
    header = ("effect", *(f"{low:g}–{high:g} σ" for low, high in edges))
    print_table(header, ((effect, *(cells.get((effect, low), "") for low, _ in edges)) for effect in effects))


def print_sureness(cases: Sequence[Diagnosed], sheet: ScoreSheet) -> None:
    """Print the calibration of the probabilities, the shrink, and the seconds of the runs above."""
    sure, seconds = sheet.probabilities, [d.seconds for d in cases]
    probabilities = [
        (p, e in j.truth) for j in sheet.case_scores if j.answer for e, p in j.answer.probabilities.items()
    ]
    open_ = np.array([pair for pair in probabilities if 0.05 < pair[0] < 0.95]).reshape(-1, 2)
    pair = "{:.2f}, {:.2f}".format(*open_.mean(axis=0)) if len(open_) else "–"
    shrink, often = sheet.fractions, f"{np.median(seconds):.1f}, {np.quantile(seconds, 0.9):.1f}"
    rows = {
        "expected calibration error, all effects of all cases (target ≤ 0.03)": f"{sure.ece:.4f}",
        "expected calibration error, first cause": f"{sure.ece_first:.3f}",
        "Brier score": f"{sure.brier:.4f}",
        f"the {len(open_)} probabilities between 0.05 and 0.95: mean stated, share really there": pair,
        "mean probability on the true single cause": f"{sure.on_truth:.3f}",
        f"median realised shrink on the run kept back, {shrink.count} cases": f"{shrink.median_realised:.3f}",
        "seconds of processor time per case, median and 90th percentile": often,
    }
    print_table("measure | value", rows.items())


def print_experiments(cases: Sequence[Diagnosed], seed: int, cache: ResultCache, log: Path | None) -> None:
    """Ask the sealed rig for what an ambiguous report proposes, diagnose again, and compare with a random choice."""
    rng, lines = np.random.default_rng(seed), dict.fromkeys(d.label.case.line for d in cases)
    tally = {line: np.zeros(4, dtype=int) for line in (*lines, "all")}
    for first in cases:
        if first.report is None or first.report["verdict"] != "ambiguous":
            continue
        sealed, proposal = first.label.case, str(first.report["next_experiment"]["profile"])
        counts = [1, 0, 0, 0]
        if proposal in EXPERIMENTS:
            plans = [RunPlan(str(name), sealed.kept_back.seed) for name in (proposal, rng.choice(EXPERIMENTS))]
            proposed, random = (load_or_diagnose(sealed, cache, plan) for plan in plans)
            counts = [1, 1, int(is_resolved(proposed)), int(is_resolved(random))]
            if not is_resolved(proposed):
                _log(proposed, log, f" after {proposal}")
        for line in (sealed.line, "all"):
            tally[line] += counts
    rows = []
    for line, (ambiguous, experiments, hits, chance) in tally.items():
        share = interval_text(*wilson(hits, experiments)) if experiments else ""
        if ambiguous:
            rows.append((line, ambiguous, experiments, f"{hits}/{experiments}", share, f"{chance}/{experiments}"))
    print_table("line | ambiguous | with a run proposed | resolved by it | 95 % interval | by a random run", rows)


def is_resolved(diagnosed_case: Diagnosed) -> bool:
    """Whether the right causes are named and nothing is ambiguous any more."""
    if diagnosed_case.report is None or diagnosed_case.report["verdict"] not in ("explained", "no_gap"):
        return False
    return (
        CaseScore(diagnosed_case.label, read_answer(diagnosed_case.label.case.name, diagnosed_case.report)).outcome
        == "right"
    )


def print_speed(count: int, seed: int) -> None:
    """Print seconds against samples, for singles and pairs; the same rigs with more runs."""
    rows = [_seconds(line, copies, count, seed) for line in ("usual", "pair") for copies in (1, 2, 4)]
    head = "line | runs | samples, median | processor seconds, median (target ≤ 5 s at 8,000)"
    print_table(head, [(line, runs, f"{n:.0f}", f"{s:.1f}") for line, runs, n, s in rows])
    for line in ("usual", "pair"):
        n, s = zip(*[(row[2], row[3]) for row in rows if row[0] == line], strict=True)
        slope = np.polyfit(np.log(n), np.log(s), 1)[0]
        print(f"{line}: seconds grow as samples to the power {slope:.2f} (1 is linear)\n")


def _seconds(line: str, copies: int, count: int, seed: int) -> tuple[str, int, float, float]:
    times, samples = [], []
    for sealed in (draw_case(seed + k, f"{line}-{k}", line) for k in range(count)):
        plans = [RunPlan(p.protocol, p.seed + c) for c in range(copies) for p in sealed.plans]
        times.append(diagnosed(sealed, plans).seconds)
        samples.append(sum(len(sealed.measure(plan).columns["t_s"]) for plan in plans))
    return line, 4 * copies, float(np.median(samples)), float(np.median(times))


def main() -> None:
    parser = parser_of(__doc__, "four cases per line")
    parser.add_argument("--cases", type=int, default=200, help="cases per line")
    parser.add_argument("--seed", type=int, default=None, help="first seed (default: chosen now)")
    parser.add_argument("--lines", nargs="+", choices=tuple(LINES), default=tuple(LINES))
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=USUAL_TABLES)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep every case here; a run that was cut off goes on")
    parser.add_argument("--log", type=Path, help="append one line per case that is not right")
    options = parser.parse_args()
    count, cache = 4 if options.quick else options.cases, ResultCache(options.keep and options.keep / "cases.jsonl")
    seed = secrets.randbits(24) if options.seed is None else options.seed
    print(f"Seeds {seed} to {seed + count - 1}, {count} cases per line.\n")
    if {"lines", "detection", "sureness", "experiments"} & set(options.tables):
        cases = run_lines(options.lines, count, seed, options.log, cache)
        sheet = scored(cases)
        if "lines" in options.tables:
            print_lines(sheet)
        if "detection" in options.tables:
            print_detection(sheet)
        if "sureness" in options.tables:
            print_sureness(cases, sheet)
        if "experiments" in options.tables:
            print_experiments(cases, seed, cache, options.log)
    if "speed" in options.tables:
        print_speed(max(3, count // 10), seed)
    for line, name in (("outside", "residual"), ("form", "forms")):
        if name in options.tables:
            print_twins([draw_case(seed + k, f"{line}-{seed + k}", line) for k in range(count)])


if __name__ == "__main__":
    main()
