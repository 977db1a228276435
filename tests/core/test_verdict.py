"""The decision rule: ILAC-G8 guard bands, findings that outrank them, and what may never pass."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from softcal.core.errors import InputError
from softcal.core.messages.reason import plain
from softcal.core.unit.measured_error import MeasuredError, Scores
from softcal.core.unit.method import DecisionConfig
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import (
    VERDICTS,
    Assessment,
    Decision,
    Finding,
    Limit,
    Release,
    Verdict,
    compare_with_audit,
    compare_with_limit,
    default_limit,
    statement,
    worst_of,
)

LIMIT = Limit("N", 0.30)


@pytest.mark.parametrize(
    ("rmse", "guard", "word"),
    [(0.20, 0.09, "pass"), (0.25, 0.09, "conditional pass"), (0.35, 0.09, "conditional fail"), (0.45, 0.09, "fail")],
)
def test_four_words_stand_on_either_side_of_the_guard_bands(rmse, guard, word):
    assert statement(ErrorForecast(rmse, rmse - guard, rmse + guard), LIMIT) == word


def test_at_the_edge_of_the_guard_band_a_false_accept_is_rarer_than_one_in_forty():
    uncertainty = 0.05
    accepted = LIMIT.maximum_rmse - 2 * uncertainty
    assert statement(ErrorForecast(accepted, accepted - 0.1, accepted + 0.1), LIMIT) == "pass"
    assert norm.sf(LIMIT.maximum_rmse, accepted, uncertainty) < 0.025


@given(rmse=st.floats(0.01, 1), guard=st.floats(1.01, 3), word=st.sampled_from(VERDICTS))
def test_a_finding_never_improves_a_verdict(rmse, guard, word):
    forecast = ErrorForecast(rmse, rmse / guard, rmse * guard)
    alone, with_finding = (
        compare_with_limit(forecast, LIMIT),
        compare_with_limit(forecast, LIMIT, (Finding(plain("something"), word),)),
    )
    assert with_finding.verdict is worst_of([alone.verdict, word])
    assert plain("something") in with_finding.reasons and len(with_finding.reasons) == 2


@pytest.mark.parametrize(("rmse", "word"), [(0.28, Verdict.CONDITIONAL), (0.32, Verdict.FAIL)])
def test_an_error_near_the_limit_is_conditional_within_it_and_fails_beyond_it(rmse, word):
    assert compare_with_limit(ErrorForecast(rmse, rmse - 0.1, rmse + 0.1), LIMIT).verdict is word


def test_the_reason_states_error_limit_and_where_the_limit_comes_from():
    verdict = compare_with_limit(ErrorForecast(0.5, 0.46, 0.54), default_limit("N", 0.15, 3.0, DecisionConfig()))
    assert "0.500 N" in str(verdict.reasons[0])
    assert verdict.reasons[0].values["origin"].code == "part.automatic"


@given(rmse=st.floats(0.001, 0.44), guard=st.floats(0, 0.3), word=st.sampled_from(VERDICTS))
def test_nothing_passes_by_a_limit_that_nobody_stated(rmse, guard, word):
    error, derived = ErrorForecast(rmse, rmse - guard, rmse + guard), default_limit("N", 0.15, 3.0, DecisionConfig())
    for source in ("predicted", "measured"):
        assessment = compare_with_limit(error, derived, (Finding(plain("something"), word),), source)
        assert assessment.verdict is worst_of([Verdict.CONDITIONAL, word])
        (reason,) = [why for why in assessment.reasons if why.code == "no_limit"]
        assert reason.values["share"] == pytest.approx(rmse / 3.0) and reason.values["rmse"] == rmse


def test_a_retest_states_no_conformity():
    assert Verdict.RETEST.conformity == "" and Verdict.FAIL.conformity == "fail"


@given(predicted=st.sampled_from(VERDICTS), measured=st.sampled_from(VERDICTS))
def test_what_is_measured_outranks_what_is_predicted_and_both_are_reported(predicted, measured):
    decision = Decision(Assessment(predicted, (plain("forecast"),)), Assessment(measured, (plain("audit"),)))
    assert decision.verdict is measured and decision.reasons[0] == plain("audit")
    assert len(decision.reasons) == (1 if predicted is measured else 2)


def test_files_are_released_by_the_verdict_alone():
    released = {release: [v for v in VERDICTS if release.releases(v)] for release in Release}
    assert released == {
        Release.PASS: [Verdict.PASS],
        Release.CONDITIONAL: [Verdict.PASS, Verdict.CONDITIONAL],
    }


@pytest.mark.parametrize("maximum", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_must_be_a_positive_number(maximum):
    with pytest.raises(InputError, match="maximum_rmse"):
        Limit("N", maximum)


def test_an_audit_that_shows_harm_fails_the_unit_even_within_the_limit():
    verdict = compare_with_audit(Scores(MeasuredError(0.10, 2000), MeasuredError(0.12, 2000)), LIMIT)
    assert verdict.verdict is Verdict.FAIL and verdict.reasons[0].code == "harmful"


@pytest.mark.parametrize(("after", "rows", "word"), [(0.1, 2000, Verdict.PASS), (0.27, 300, Verdict.CONDITIONAL)])
def test_a_measured_error_passes_well_within_the_limit_alone(after, rows, word):
    assert compare_with_audit(Scores(MeasuredError(0.6, rows), MeasuredError(after, rows)), LIMIT).verdict is word
