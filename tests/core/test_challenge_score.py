"""Scoring of reports against opened labels."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from softcal.core.challenge.answers import CaseScore, read_answer
from softcal.core.challenge.case_generator import draw_case
from softcal.core.challenge.cases import SealedCase, distance_sigma
from softcal.core.challenge.explained_fraction import BASE, PER_RUN, explained_fraction
from softcal.core.challenge.recording_mistakes import Mistake
from softcal.core.challenge.rig import Cause
from softcal.core.challenge.score import calibration_error, log_score, score_reports
from softcal.core.challenge.seal import Label
from softcal.core.errors import InputError
from softcal.core.metrics import wilson


def report(
    verdict: str, causes: dict[str, float], groups: tuple[tuple[str, ...], ...] = (), **extra: Any
) -> dict[str, Any]:
    return {
        "verdict": verdict,
        "causes": [{"effect": effect, "probability": p} for effect, p in causes.items()],
        "ambiguous_with": [list(group) for group in groups],
        "where": [{"stage": "transduction", "share": 0.7}, {"stage": "load_cell", "share": 0.1}],
        "shrink": {"predicted": 0.97, "low": 0.9, "high": 1.0},
        **extra,
    }


def label(*effects: str, line: str = "usual", sigma: float = 100.0, name: str = "case-1") -> Label:
    sealed_case = draw_case(1, name, "none")
    causes = tuple(Cause(effect, "outside" if effect == "slip" else "catalogue", {}) for effect in effects)
    case = SealedCase(
        name,
        line,
        sealed_case.rig,
        sealed_case.peak_N,
        sealed_case.depth_mm,
        causes,
        sealed_case.plans,
        sealed_case.kept_back,
    )
    return Label(case, "00", sigma)


def outcome(truth: Label, answer: dict[str, Any]) -> str:
    return CaseScore(truth, read_answer("case-1", answer)).outcome


@pytest.mark.parametrize(
    ("truth", "answer", "expected"),
    [
        (label("channel_creep"), report("explained", {"channel_creep": 0.98}), "right"),
        (label("channel_creep"), report("explained", {"readout_lag": 0.98}), "wrong"),
        (label("channel_creep"), report("explained", {"channel_creep": 0.9, "backlash": 0.8}), "wrong"),
        (
            label("channel_creep"),
            report("ambiguous", {"readout_lag": 0.5, "channel_creep": 0.4}, (("channel_creep", "readout_lag"),)),
            "set",
        ),
        (label("channel_creep"), report("no_gap", {"channel_creep": 0.1}), "missed"),
        (label("channel_creep", sigma=2.0), report("no_gap", {}), "below noise"),
        (label("channel_creep"), report("unknown", {"channel_creep": 0.3}), "abstained"),
        (label("channel_creep", "backlash"), report("explained", {"channel_creep": 0.9, "backlash": 0.9}), "right"),
        (label("channel_creep", "backlash"), report("explained", {"channel_creep": 0.9}), "wrong"),
        (
            label("channel_creep", "backlash"),
            report("ambiguous", {"readout_lag": 0.6, "backlash": 0.9}, (("channel_creep", "readout_lag"),)),
            "set",
        ),
        (label(), report("no_gap", {}), "right"),
        (label(), report("explained", {"backlash": 0.9}), "alarm"),
        (label(), report("unknown", {"backlash": 0.2}), "abstained"),
        (label(), report("unknown", {"backlash": 0.9}), "alarm"),
        (label("slip"), report("unknown", {"backlash": 0.4}), "right"),
        (label("slip"), report("unknown", {"backlash": 0.9}), "wrong"),
        (label("slip"), report("explained", {"backlash": 0.9}), "wrong"),
    ],
)
def test_an_answer_gets_one_word(truth: Label, answer: dict[str, Any], expected: str) -> None:
    assert outcome(truth, answer) == expected


def test_a_case_without_a_report_counts_as_wrong() -> None:
    sheet = score_reports([label("channel_creep")], {})
    assert sheet.rows[0].hits == 0 and sheet.rows[0].count == 1
    assert sheet.case_scores[0].outcome == "no report"


STRANGE: dict[str, dict[str, Any]] = {
    "nothing": {},
    "another verdict": report("perhaps", {"channel_creep": 0.9}),
    "no number": report("explained", {"channel_creep": float("nan")}),
    "more than sure": report("explained", {"channel_creep": 3.0}),
    "causes of text": {**report("explained", {}), "causes": ["channel_creep"]},
    "places of text": {**report("explained", {"channel_creep": 0.9}), "where": "everywhere"},
    "data of text": {**report("data", {}), "data": "all wrong"},
}


@pytest.mark.parametrize("strange", STRANGE)
def test_a_strange_report_counts_as_wrong_and_stops_nothing(strange: str) -> None:
    labels = [label("channel_creep", name="case-1"), label("channel_creep", name="case-2"), label(name="case-3")]
    sound = report("explained", {"channel_creep": 0.9})
    sheet = score_reports(labels, {"case-1": STRANGE[strange], "case-2": sound, "case-3": STRANGE[strange]})
    assert [case_score.outcome for case_score in sheet.case_scores] == ["wrong", "right", "wrong"]
    assert "case-1" in sheet.case_scores[0].unread
    json.dumps(sheet.to_record(), allow_nan=False)


@pytest.mark.parametrize(
    ("effect", "parameters", "base"),
    [
        ("channel_creep", {}, {}),
        ("channel_creep", {"c": {"value": None}, "tau": {"value": 5.0}}, {}),
        ("channel_creep", {"c": {"value": 0.1}, "tau": {"value": float("nan")}}, {}),
        ("channel_creep", {"c": {"value": 0.1}, "tau": {"value": 5.0}}, {"k1_N_mm": "stiff"}),
        ("a ghost", {"size": {"value": 1.0}}, {}),
    ],
)
def test_numbers_that_make_no_twin_shrink_nothing(
    effect: str, parameters: dict[str, Any], base: dict[str, Any]
) -> None:
    case = next(c for k in range(20) if len((c := draw_case(k, "case-1", "usual")).causes) and _leaves_a_gap(c))
    rig = {name: getattr(case.rig, name) for name in BASE}
    causes = [{"effect": effect, "probability": 1.0, "parameters": parameters}]
    answer = {**report("explained", {}), "causes": causes, "base": {**rig, **base}}
    sheet = score_reports(
        [Label(case, "00", 100.0)], {"case-1": answer}, lambda la, said: explained_fraction(la.case, said)
    )
    assert sheet.case_scores[0].explained_fraction == 0.0


def _leaves_a_gap(case: SealedCase) -> bool:
    return not {cause.effect for cause in case.causes} & set(PER_RUN) and distance_sigma(case) > 50.0


def test_shrink_is_scored_on_the_run_kept_back() -> None:
    labels = [label("channel_creep", name=f"case-{k}") for k in range(4)]
    reports = {entry.case.name: report("explained", {"channel_creep": 0.9}) for entry in labels}
    realised = iter((0.98, 0.93, 0.80, float("nan")))
    sheet = score_reports(labels, reports, lambda label, report: next(realised))
    assert sheet.fractions.count == 3
    assert [row.hits for row in sheet.fractions.rows] == [1, 2, 2]
    assert sheet.fractions.median_realised == pytest.approx(0.93)


def test_the_record_of_a_score_is_plain_json() -> None:
    sheet = score_reports([label("channel_creep")], {"case-1": report("explained", {"channel_creep": 0.9})})
    record = json.loads(json.dumps(sheet.to_record(), allow_nan=False))
    assert record["cases"][0]["outcome"] == "right"
    assert record["shrink"]["median_realised"] is None


def test_wilson_agrees_with_scipy() -> None:
    for hits, count in ((0, 30), (29, 30), (140, 200)):
        theirs = binomtest(hits, count).proportion_ci(method="wilson")
        assert wilson(hits, count) == pytest.approx((theirs.low, theirs.high), abs=1e-6)


def test_honest_probabilities_have_no_calibration_error(rng: np.random.Generator) -> None:
    probabilities = rng.random(200_000)
    assert calibration_error(probabilities, (rng.random(200_000) < probabilities).astype(float)) < 0.01
    assert calibration_error(np.full(100, 0.95), np.zeros(100)) == pytest.approx(0.95)


def test_a_report_of_another_shape_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="case-1.*softcal.gap/1"):
        read_answer("case-1", {"verdict": "explained"})


@pytest.mark.parametrize(
    ("verdict", "mistakes", "expected"),
    [
        ("data", [("unit_factor", "output", [2])], "right"),
        ("data", [("unit_factor", "output", "all")], "abstained"),
        ("data", [("unit_factor", "force", [2])], "abstained"),
        ("data", [("gain", "output", [2])], "abstained"),
        ("data", [], "abstained"),
        ("explained", [("unit_factor", "output", [2])], "wrong"),
        ("no_gap", [("unit_factor", "force", "all")], "wrong"),
        ("no_gap", [], "wrong"),
    ],
)
def test_a_mistake_in_the_recordings_asks_for_its_kind_channel_and_run(
    verdict: str, mistakes: list[tuple[str, str, object]], expected: str
) -> None:
    mistake = Mistake("unit_factor", "output", (2,), 1e-3).to_text()
    mistaken = replace(label("channel_creep"), case=replace(label("channel_creep").case, mistake=mistake))
    data = [{"what": what, "channel": channel, "runs": runs} for what, channel, runs in mistakes]
    assert outcome(mistaken, {**report(verdict, {"channel_creep": 0.98}), "data": data}) == expected


def test_a_unit_of_the_whole_case_may_be_asked_about_beside_any_verdict() -> None:
    case = replace(label().case, mistake=Mistake("unit_factor", "force", (), 9.80665).to_text())
    answer = {**report("no_gap", {}), "data": [{"what": "unit_factor", "channel": "force", "runs": "all"}]}
    assert outcome(replace(label(), case=case), answer) == "right"
    assert outcome(replace(label(), case=case), report("no_gap", {})) == "wrong"


def test_a_forecast_of_a_wrong_cause_is_scored_too() -> None:
    labels = [label("channel_creep"), label("channel_creep", name="case-2")]
    reports = {"case-1": report("explained", {"channel_creep": 0.9}), "case-2": report("explained", {"backlash": 0.9})}
    realised = iter((0.98, -0.5))
    sheet = score_reports(labels, reports, lambda label, report: next(realised))
    assert [j.outcome for j in sheet.case_scores] == ["right", "wrong"] and sheet.fractions.count == 2
    assert [row.hits for row in sheet.fractions.rows] == [1, 1, 1]


def test_the_log_score_is_that_of_what_is_stated_or_at_work() -> None:
    probabilities, present = np.array([0.9, 0.0, 0.3, 0.0, 0.02]), np.array([1.0, 0.0, 0.0, 1.0, 0.0])
    expected = -np.mean(np.log([0.9, 0.7, 1e-3]))
    assert log_score(probabilities, present) == pytest.approx(expected)
    assert np.isnan(log_score(np.zeros(25), np.zeros(25)))


@pytest.mark.parametrize("verdict", ["unknown", "explained_in_part"])
def test_a_false_name_beside_a_rest_is_wrong(verdict: str) -> None:
    labels = [label("slip"), label("slip", name="case-2"), label("channel_creep", name="case-3")]
    answers = [
        report(verdict, {"backlash": 0.6}),
        report(verdict, {"backlash": 0.4}),
        report(verdict, {"backlash": 0.6}),
    ]
    sheet = score_reports(labels, {f"case-{k}": one for k, one in enumerate(answers, start=1)})
    assert [j.outcome for j in sheet.case_scores] == ["wrong", "right", "wrong"]
