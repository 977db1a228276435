"""`softcal gap challenge`, `ask` and `score`: the withheld check of the diagnosis."""

import argparse
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.cli.options import COUNT, DIR, FILE, Action
from softcal.app.output import ProgressLine, echo, print_table, write_json
from softcal.core.errors import InputError

if TYPE_CHECKING:
    from softcal.core.challenge.score import ScoreSheet

_CHALLENGE_EXAMPLES = """examples:
  softcal gap challenge --cases 40 --out sealed            # secret seed; labels encrypted, sealed.seal.key opens them
  for c in sealed/case-*; do softcal gap diagnose $c --json reports/$(basename $c).json; done
  softcal gap score sealed --reports reports --seal sealed.seal.json --commitment HEX
"""
_EXAMINER_EXAMPLES = """examples:
  softcal gap examiner sealed --seal sealed.seal.json      # prints HOST:PORT:WORD for `gap ask --examiner`
"""
_ASK_EXAMPLES = """examples:
  softcal gap ask sealed case-007 --experiment rate_sweep --examiner 127.0.0.1:40123:WORD
  softcal gap ask sealed case-007 --experiment dead_weights --seal sealed.seal.json      by who has the key
  softcal gap ask sealed case-007 --lot lot-7 --seal sealed.seal.json       units made with the sealed one
"""
_SCORE_EXAMPLES = """examples:
  softcal gap score sealed --reports reports --seal sealed.seal.json --commitment HEX
  softcal gap score sealed --reports reports --seal sealed.seal.json --commitment HEX --json score.json
  softcal gap score sealed --reports reports --seal sealed.seal.json --check        exit code 1 below the floors
"""


def add_challenge_actions(action: Action) -> None:
    """Add the three commands of a challenge to those of `softcal gap`."""
    challenge = action("challenge", "make sealed cases whose cause is withheld", _challenge, epilog=_CHALLENGE_EXAMPLES)
    add = challenge.add_argument
    add("--cases", required=True, **COUNT, help="how many cases")
    add("--seed", type=int, help="seed of the draw (default: a secret one, kept in the seal)")
    add("--out", required=True, **DIR, help="new folder for the cases")
    add("--seal", **FILE, help="file for the encrypted labels (default: DIR.seal.json)")
    add("--key", **FILE, help="file for their key (default: beside the seal); keep it from whoever diagnoses")
    add("--line", metavar="NAME", help="draw one line of the benchmark instead of the mix")
    examiner = action(
        "examiner", "answer for sealed rigs with the key, until it is stopped", _examiner, epilog=_EXAMINER_EXAMPLES
    )
    examiner.add_argument("folder", **DIR, help="folder of the challenge")
    _add_seal(examiner)
    examiner.add_argument("--port", type=int, default=0, help="port on this computer (default: any free one)")
    ask = action("ask", "run one more experiment on a sealed rig", _ask, epilog=_ASK_EXAMPLES)
    ask.add_argument("folder", **DIR, help="folder of the challenge")
    ask.add_argument("case", metavar="CASE", help="name of the case")
    target = ask.add_mutually_exclusive_group(required=True)
    target.add_argument("--experiment", metavar="NAME", help="name of the experiment")
    target.add_argument("--lot", **DIR, help="press a lot of units on the rig into this new folder")
    ask.add_argument("--units", default=6, **COUNT, help="target units of the lot (default 6)")
    ask.add_argument("--examiner", metavar="HOST:PORT:WORD", help="process of the examiner, instead of seal and key")
    _add_seal(ask, required=False)
    score = action("score", "open the seal of a challenge and score the reports", _score, epilog=_SCORE_EXAMPLES)
    add = score.add_argument
    add("folder", **DIR, help="folder of the challenge")
    add("--reports", required=True, **DIR, help="folder with CASE.json per case")
    _add_seal(score)
    add("--commitment", metavar="HEX", help="as it was published (default: the one in the folder)")
    add("--json", metavar="FILE", help="write the scores as JSON ('-' for standard output)")
    add("--check", action="store_true", help="exit with 1 where a line that was drawn falls below its floor")


def _add_seal(parser: argparse.ArgumentParser, required: bool = True) -> None:
    parser.add_argument("--seal", required=required, **FILE, help="file with the encrypted labels")
    parser.add_argument("--key", **FILE, help="file with their key (default: beside the seal)")


def _challenge(options: argparse.Namespace) -> None:
    """Make sealed cases: recordings of simulated rigs with hidden effects.

    Their generator shares no code with the twin. The labels are in a separate file; its SHA-256 is printed and
    published with the cases before any diagnosis.
    """
    from softcal.app.gap.challenge import make_challenge
    from softcal.app.gap.sealed_file import default_key_path

    folder: Path = options.out
    seal_file = options.seal or folder.parent / f"{folder.name}.seal.json"
    progress = ProgressLine("cases", max(1, options.cases))
    challenge = make_challenge(folder, seal_file, options.cases, options.seed, options.line, progress.step, options.key)
    print(f"commitment  {challenge.commitment}")
    key = options.key or default_key_path(seal_file)
    echo(
        f"{len(challenge.cases)} cases in {folder}; labels encrypted in {seal_file}; keep {key} from whoever diagnoses"
    )
    if options.seed is not None:
        echo(f"seed {options.seed} was stated: whoever knows it can make these labels again")


def _ask(options: argparse.Namespace) -> None:
    """Run one more experiment on a sealed rig, with the same hidden causes. The recording is added
    to the case as runs/asked-<n>; diagnose the case again to see whether the ambiguity is gone.
    """
    from softcal.app.gap.challenge import ask_rig, press_rig_lot, record_experiment
    from softcal.app.gap.sealed_file import ask_examiner

    if (options.seal is None) == (options.examiner is None):
        raise InputError("give either --examiner HOST:PORT:WORD, or --seal with its key")
    if options.lot is not None:
        if options.seal is None:
            raise InputError("--lot needs --seal with its key; an examiner records single runs")
        rig = options.folder, options.seal, options.case
        print(press_rig_lot(*rig, options.units, options.lot, options.key))
        return
    ask = partial(record_experiment, options.folder, options.seal, key_file=options.key)
    if options.examiner is not None:
        ask = partial(ask_examiner, options.examiner)
    print(ask_rig(options.folder, ask, options.case, options.experiment))


def _examiner(options: argparse.Namespace) -> None:
    """Hold the key of a challenge and record further runs of its rigs for `softcal gap ask --examiner`. Whoever
    diagnoses needs neither seal nor key then. Stop it with Ctrl-C.
    """
    from softcal.app.gap.challenge import open_challenge, record_experiment
    from softcal.app.gap.sealed_file import Examiner

    open_challenge(options.folder, options.seal, options.key)
    answer = partial(record_experiment, options.folder, options.seal, key_file=options.key)
    with Examiner(answer, options.port) as examiner:
        print(f"examiner    {examiner.address}", flush=True)
        with suppress(KeyboardInterrupt):
            examiner.serve_forever()


def _score(options: argparse.Namespace) -> int:
    """Check the seal of a challenge against its published hash and open it. Score one report per
    case: causes, sets, false alarms, abstention, stage, forecast of the shrink, calibration of
    probabilities.
    """
    from softcal.app.gap.challenge import score_challenge
    from softcal.core.challenge.score import shortfalls

    scored = score_challenge(options.folder, options.reports, options.seal, options.key, options.commitment)
    sheet = scored.sheet
    write_json(options.json, scored.to_json())
    if not scored.has_commitment:
        echo(
            "the commitment is the folder's own, which whoever diagnosed held; state the published one by --commitment"
        )
    if scored.seed_origin == "stated":
        echo("the seed of these cases was stated: whoever knew it could make the labels")
    for case_score in (j for j in sheet.case_scores if j.unread):
        echo(f"counted as wrong: {case_score.unread}")
    if options.json != "-":
        _print(sheet)
    failures = shortfalls(sheet) if options.check else ()
    for sentence in failures:
        echo(f"below its floor: {sentence}")
    return 1 if failures else 0


def _print(sheet: "ScoreSheet") -> None:
    header = ("line", "measure", "hits", "of", "share", "95 % interval")
    rows = []
    for row in (each for each in (*sheet.rows, *sheet.fractions.rows) if each.count):
        low, high = (f"{100 * end:.1f}" for end in row.interval)
        rows.append((row.line, row.measure, row.hits, row.count, f"{100 * row.share:.1f} %", f"{low}–{high} %"))
    print_table(header, rows)
    probabilities = sheet.probabilities
    print()
    print_table(
        ("probabilities", "value"),
        [
            ("expected calibration error, all effects", probabilities.ece),
            ("expected calibration error, first cause", probabilities.ece_first),
            ("Brier score", probabilities.brier),
            ("log score of named and of true causes, nats", probabilities.log_score),
            ("mean probability on the true single cause", probabilities.on_truth),
        ],
    )
    print()
    print_table(
        ("stated probability", "effects", "mean stated", "at work", "share"),
        [
            (f"{b.low:g}–{b.high:g}", b.count, f"{b.stated:.2f}", b.right, f"{100 * b.right / b.count:.0f} %")
            for b in probabilities.by_bin
        ],
    )
    misses = [j for j in sheet.case_scores if j.outcome not in ("right", "set", "below noise")]
    print()
    print_table(
        ("case", "line", "outcome", "verdict", "first", "truth", "σ"),
        [
            (
                j.label.case.name,
                j.label.case.line,
                j.outcome,
                j.answer.verdict if j.answer else None,
                j.answer.first if j.answer else None,
                " + ".join(cause.effect for cause in j.label.case.causes) or "none",
                j.label.distance_sigma,
            )
            for j in misses
        ],
    )
