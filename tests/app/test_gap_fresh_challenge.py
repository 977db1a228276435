"""The withheld check with seeds that nobody chose: new rigs of every line at every run of the tests.

Floors are on *right* answers, so a diagnosis that abstains or never names anything fails (test_challenge_mutants).
"""

import json
import secrets
from pathlib import Path

import pytest

from softcal.app.cli.main import main
from softcal.app.gap.challenge import open_challenge
from softcal.core.challenge.floors import FLOORS, shortfalls
from softcal.core.challenge.judge import Judged, read_answer
from softcal.core.challenge.score import ScoreSheet, score_reports

pytestmark = pytest.mark.timeout(1800)

CASES = 4
FORM_CASES = 8
"""One in eight ends as an honest set or lies below the noise: four cases might miss the floor by chance."""

PUBLISHED_CASES = 6
"""The floors of these lines are low: fewer cases might miss them by chance."""

WRONG = ("alarm", "wrong", "no report")


def diagnosed_blind(line: str, cases: int, place: Path) -> tuple[Judged, ...]:
    """Make, diagnose and score a challenge of one line, each by its command."""
    sealed, reports, seal = place / "sealed", place / "reports", place / "labels.json"
    reports.mkdir(parents=True)
    make = ["gap", "challenge", "--cases", str(cases), "--line", line, "--out", str(sealed), "--seal", str(seal)]
    assert main(make) == 0
    for case in sorted(sealed.glob("case-*")):
        assert main(["gap", "diagnose", str(case), "--json", str(reports / f"{case.name}.json")]) == 0
    command = ["gap", "score", str(sealed), "--reports", str(reports), "--seal", str(seal)]
    assert main([*command, "--json", str(place / "score.json")]) == 0
    read = {path.stem: json.loads(path.read_text()) for path in reports.glob("*.json")}
    labels = open_challenge(sealed, seal)
    return tuple(Judged(label, read_answer(label.case.name, read[label.case.name])) for label in labels)


@pytest.fixture(scope="module")
def every_line(tmp_path_factory: pytest.TempPathFactory) -> ScoreSheet:
    place = tmp_path_factory.mktemp("fresh")
    judged = [j for line in FLOORS for j in _drawn(line, place / line)]
    return ScoreSheet(tuple(judged), *_without_rows())


def _drawn(line: str, place: Path) -> tuple[Judged, ...]:
    """Draw a line's cases, and as many again where too few are right: both are held to the floor together."""
    judged = diagnosed_blind(line, _count(line), place)
    if sum(j.outcome == "right" for j in judged) < FLOORS[line] * len(judged):
        judged += diagnosed_blind(line, _count(line), place / "more")
    return judged


def _count(line: str) -> int:
    if line.startswith("published"):
        return PUBLISHED_CASES
    return FORM_CASES if line == "form" else CASES


def _without_rows() -> tuple[object, ...]:
    empty = score_reports([], {})
    return empty.rows, empty.detection, empty.probabilities, empty.shrink


@pytest.mark.slow
def test_new_rigs_of_every_line_are_right_above_the_floors(every_line: ScoreSheet) -> None:
    told = [(j.label.case.line, j.outcome, [c.effect for c in j.label.case.causes]) for j in every_line.judged]
    assert shortfalls(every_line) == [], told


def test_hardly_any_new_rig_gets_a_wrong_name(every_line: ScoreSheet) -> None:
    usual = [j for j in every_line.judged if not j.label.case.line.startswith("published")]
    astray = [(j.label.case.name, j.label.case.line, j.outcome) for j in usual if j.outcome in WRONG]
    # Two in a hundred may go astray; one in ten would be no accident.
    assert len(astray) <= 0.1 * len(usual), astray


def test_a_challenge_without_a_seed_takes_one_of_128_bits(tmp_path: Path) -> None:
    seeds = []
    for name in ("one", "two"):
        main(["gap", "challenge", "--cases", "1", "--out", str(tmp_path / name)])
        seeds.append(json.loads((tmp_path / f"{name}.seal.json").read_text())["seed"])
    assert min(seed.bit_length() for seed in seeds) > 96 and seeds[0] != seeds[1]


def test_the_check_of_a_score_fails_on_silence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sealed, reports, seal = tmp_path / "sealed", tmp_path / "reports", tmp_path / "labels.json"
    reports.mkdir()
    seed = str(secrets.randbits(128))
    main(
        [
            "gap",
            "challenge",
            "--cases",
            "3",
            "--line",
            "usual",
            "--out",
            str(sealed),
            "--seal",
            str(seal),
            "--seed",
            seed,
        ]
    )
    silent = {
        "verdict": "unknown",
        "causes": [],
        "ambiguous_with": [],
        "where": [],
        "shrink": dict.fromkeys(("predicted", "low", "high"), 0.0),
    }
    for case in sealed.glob("case-*"):
        (reports / f"{case.name}.json").write_text(json.dumps(silent))
    command = ["gap", "score", str(sealed), "--reports", str(reports), "--seal", str(seal)]
    assert main(command) == 0
    assert main([*command, "--check"]) == 1
    assert "usual: 0 of 3 right" in capsys.readouterr().err
