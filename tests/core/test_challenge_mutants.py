"""The check can fail: answers that never look at a recording fall below its floors, and a right one does not."""

from collections.abc import Callable
from typing import Any

import pytest

from softcal.core.challenge.case_generator import draw_case, draw_challenge
from softcal.core.challenge.equations import CATALOGUE
from softcal.core.challenge.recording_mistakes import Mistake
from softcal.core.challenge.score import MIN_SHARES, score_reports, shortfalls
from softcal.core.challenge.seal import Label

PER_LINE = 4
Mutant = Callable[[Label], dict[str, Any]]


def labels(seed: int) -> list[Label]:
    cases = [draw_case(seed + k, f"{line}-{k}", line) for line in MIN_SHARES for k in range(PER_LINE)]
    return [Label(case, "00", 100.0) for case in cases]


def make_answer(
    verdict: str, probabilities: dict[str, float], groups: tuple[tuple[str, ...], ...] = ()
) -> dict[str, Any]:
    return {
        "verdict": verdict,
        "causes": [{"effect": effect, "probability": probabilities.get(effect, 0.0)} for effect in CATALOGUE],
        "ambiguous_with": [list(group) for group in groups],
        "where": [{"stage": "transduction", "share": 1.0}],
        "shrink": {"predicted": 0.97, "low": 0.9, "high": 1.0},
    }


def true_answer(label: Label) -> dict[str, Any]:
    if label.case.mistake:
        mistake = Mistake.from_text(label.case.mistake)
        mistake_json = {"what": mistake.what, "channel": mistake.channel, "runs": list(mistake.runs) or "all"}
        return {**make_answer("data", {}), "data": [mistake_json]}
    causes = {cause.effect for cause in label.case.causes}
    if not causes:
        return make_answer("no_gap", {})
    return (
        make_answer("explained", dict.fromkeys(causes, 1.0)) if causes <= set(CATALOGUE) else make_answer("unknown", {})
    )


def peeks_at_the_stage(label: Label) -> dict[str, Any]:
    """Knows the stage of the first cause, and names the first effect of it."""
    first = next((e for e, q in CATALOGUE.items() if q.stage in label.case.stages), "backlash")
    return make_answer("explained", {first: 1.0})


MUTANTS: dict[str, Mutant] = {
    "always no gap": lambda label: make_answer("no_gap", {}),
    "always unknown": lambda label: make_answer("unknown", {}),
    "always a data mistake": lambda label: make_answer("data", {}),
    "first of the catalogue": lambda label: make_answer("explained", {next(iter(CATALOGUE)): 1.0}),
    "last of the catalogue": lambda label: make_answer("explained", {list(CATALOGUE)[-1]: 1.0}),
    "everything at once": lambda label: make_answer("explained", dict.fromkeys(CATALOGUE, 1.0)),
    "everything ambiguous": lambda label: make_answer("ambiguous", dict.fromkeys(CATALOGUE, 0.4), (tuple(CATALOGUE),)),
    "never a name": lambda label: make_answer("no_gap" if label.case.name.endswith(("0", "2")) else "unknown", {}),
    "the first effect of the stage": peeks_at_the_stage,
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_an_answer_that_does_not_look_falls_below_the_floors(mutant: str) -> None:
    for seed in (1, 1000, 2000):
        every = labels(seed)
        sheet = score_reports(every, {label.case.name: MUTANTS[mutant](label) for label in every})
        assert len(shortfalls(sheet)) > len(MIN_SHARES) / 2, shortfalls(sheet)


def test_the_truth_stands_above_them() -> None:
    every = labels(1)
    assert shortfalls(score_reports(every, {label.case.name: true_answer(label) for label in every})) == []


def test_a_diagnosis_that_fails_on_one_line_alone_is_seen() -> None:
    every = labels(1)
    for line in MIN_SHARES:
        reports = {
            label.case.name: make_answer("explained", {"dropped_samples": 1.0})
            if label.case.line == line
            else true_answer(label)
            for label in every
        }
        found_shortfalls = shortfalls(score_reports(every, reports))
        assert [sentence.split(":")[0] for sentence in found_shortfalls] == [line]


def test_reports_of_a_line_that_are_left_out_are_a_shortfall() -> None:
    every = labels(1)
    found_shortfalls = shortfalls(
        score_reports(every, {la.case.name: true_answer(la) for la in every if la.case.line != "outside"})
    )
    assert [sentence.split(":")[0] for sentence in found_shortfalls] == ["outside"]


def test_forty_cases_of_the_mix_pass_with_the_truth_and_fall_without_looking() -> None:
    every = [Label(case, "00", 100.0) for case in draw_challenge(seed=5, count=40)]
    lines = [label.case.line for label in every]
    assert min(lines.count(line) for line in MIN_SHARES) >= PER_LINE
    assert shortfalls(score_reports(every, {label.case.name: true_answer(label) for label in every})) == []
    for mutant in MUTANTS.values():
        assert shortfalls(score_reports(every, {label.case.name: mutant(label) for label in every})) != []


def test_a_line_that_nobody_drew_is_no_shortfall() -> None:
    usual = [label for label in labels(1) if label.case.line == "usual"]
    assert shortfalls(score_reports(usual, {label.case.name: true_answer(label) for label in usual})) == []
