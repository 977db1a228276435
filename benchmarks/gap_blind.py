"""The withheld check of the gap diagnosis with rigs that nobody chose: one answer by its exit code.

    python benchmarks/gap_blind.py                 a fresh seed of 128 bits, printed so that the draw can be repeated
    python benchmarks/gap_blind.py --seed 7        the same rigs again

Every line of the check is made, diagnosed and scored by the three commands of `softcal gap`. It fails where a line
falls below its floor, or where four rigs or more get a wrong name. Nothing is drawn a second time.
"""

import argparse
import json
import secrets
import sys
import tempfile
from pathlib import Path

from softcal.app.cli.main import main as softcal
from softcal.app.gap.challenge import open_challenge
from softcal.core.challenge.draw import SEED_BITS
from softcal.core.challenge.judge import Judged, read_answer
from softcal.core.challenge.score import FLOORS, ScoreSheet, score_reports, shortfalls

CASES = 4
FORM_CASES = 8
"""One in eight ends as an honest set or lies below the noise: four cases might miss the floor by chance."""

PUBLISHED_CASES = 6
"""The floors of these lines are low: fewer cases might miss them by chance."""

WRONG = ("alarm", "wrong", "no report")
MOST_WRONG = 3
"""Two in a hundred may go astray; four of these would be no accident."""


def case_count(line: str) -> int:
    """How many rigs are drawn of a line."""
    if line.startswith("published"):
        return PUBLISHED_CASES
    return FORM_CASES if line == "form" else CASES


def diagnosed(line: str, seed: int, place: Path) -> list[Judged]:
    """Make, diagnose and score the rigs of one line, each by its command."""
    sealed, reports, seal = place / "sealed", place / "reports", place / "labels.json"
    reports.mkdir(parents=True)
    count = ("--cases", str(case_count(line)), "--line", line, "--seed", str(seed))
    run("challenge", *count, "--out", str(sealed), "--seal", str(seal))
    for case in sorted(sealed.glob("case-*")):
        run("diagnose", str(case), "--json", str(reports / f"{case.name}.json"))
    run("score", str(sealed), "--reports", str(reports), "--seal", str(seal), "--json", str(place / "score.json"))
    answers = {path.stem: json.loads(path.read_text()) for path in reports.glob("*.json")}
    labels = open_challenge(sealed, seal)
    return [Judged(label, read_answer(label.case.name, answers[label.case.name])) for label in labels]


def run(*words: str) -> None:
    """Run one command of `softcal gap`; end where it fails."""
    if (code := softcal(["gap", *words])) != 0:
        sys.exit(f"softcal gap {' '.join(words)}: exit code {code}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="repeat a draw (default: a fresh seed of 128 bits)")
    options = parser.parse_args()
    seed = secrets.randbits(SEED_BITS) if options.seed is None else options.seed
    judged: list[Judged] = []
    with tempfile.TemporaryDirectory() as folder:
        for line in FLOORS:
            judged += diagnosed(line, seed, Path(folder) / line)
            print(f"{line}: {', '.join(j.outcome for j in judged if j.label.case.line == line)}", flush=True)
    empty = score_reports([], {})
    short = shortfalls(ScoreSheet(tuple(judged), empty.rows, empty.detection, empty.probabilities, empty.shrink))
    usual = [j for j in judged if not j.label.case.line.startswith("published")]
    wrong = [j for j in usual if j.outcome in WRONG]
    if len(wrong) > MOST_WRONG:
        short.append(f"{len(wrong)} of {len(usual)} rigs got a wrong name; {MOST_WRONG} at most were expected")
    for j in wrong:
        print(f"{j.label.case.line} {j.label.case.name}: {j.outcome}, hidden {[c.effect for c in j.label.case.causes]}")
    right = sum(j.outcome == "right" for j in judged)
    print(f"\nseed {seed}: {right} of {len(judged)} right, {len(wrong)} wrong\n" + "\n".join(short))
    sys.exit(1 if short else 0)


if __name__ == "__main__":
    main()
