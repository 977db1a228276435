"""The decision rule: ILAC-G8 guard bands, findings that outrank them, and what may never pass."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from softcal.core.errors import InputError
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import VERDICTS, Finding, Limit, decide, decide_audited, default_limit, four_word, refuse

LIMIT = Limit("N", 0.30)


@pytest.mark.parametrize(
    ("rmse", "guard", "word"),
    [(0.20, 0.09, "pass"), (0.25, 0.09, "conditional pass"), (0.35, 0.09, "conditional fail"), (0.45, 0.09, "fail")],
)
def test_four_words_stand_on_either_side_of_the_guard_bands(rmse, guard, word):
    assert four_word(ErrorForecast(rmse, rmse - guard, rmse + guard), LIMIT) == word


def test_at_the_edge_of_the_guard_band_a_false_accept_is_rarer_than_one_in_forty():
    uncertainty = 0.05
    accepted = LIMIT.maximum_rmse - 2 * uncertainty
    assert four_word(ErrorForecast(accepted, accepted - 0.1, accepted + 0.1), LIMIT) == "pass"
    assert norm.sf(LIMIT.maximum_rmse, accepted, uncertainty) < 0.025


@given(rmse=st.floats(0.01, 1), guard=st.floats(1.01, 3), word=st.sampled_from(VERDICTS))
def test_a_finding_never_improves_a_verdict(rmse, guard, word):
    forecast = ErrorForecast(rmse, rmse / guard, rmse * guard)
    alone, found = decide(forecast, LIMIT), decide(forecast, LIMIT, (Finding("x", "something", word),))
    assert VERDICTS.index(found.word) >= max(VERDICTS.index(alone.word), VERDICTS.index(word))
    assert found.reasons[0] == "something"


def test_both_conditional_words_become_the_contracts_one():
    for rmse in (0.28, 0.32):
        verdict = decide(ErrorForecast(rmse, rmse - 0.1, rmse + 0.1), LIMIT)
        assert verdict.word == "conditional" and verdict.four_word.startswith("conditional ")


def test_the_reason_states_error_limit_and_where_the_limit_comes_from():
    verdict = decide(ErrorForecast(0.2, 0.15, 0.25), default_limit("N", 0.15))
    assert "0.2 N" in verdict.reasons[-1] and "no limit was stated" in verdict.reasons[-1]


def test_a_refused_unit_has_no_word_of_the_decision_rule():
    assert refuse(Finding("dead", "dead channel", "retest")).four_word == ""


@pytest.mark.parametrize("maximum", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_must_be_a_positive_number(maximum):
    with pytest.raises(InputError, match="maximum_rmse"):
        Limit("N", maximum)


def test_an_audit_that_shows_harm_fails_the_unit_even_within_the_limit():
    verdict = decide_audited(before=0.10, after=0.12, windows=2000, limit=LIMIT)
    assert verdict.word == "fail" and "worse than doing nothing" in verdict.reasons[0]


def test_a_measured_error_well_within_the_limit_passes():
    assert decide_audited(before=0.6, after=0.1, windows=2000, limit=LIMIT).word == "pass"


def test_a_short_audit_near_the_limit_is_conditional():
    assert decide_audited(before=0.6, after=0.27, windows=300, limit=LIMIT).word == "conditional"
