"""Numbers on paper: two digits of an uncertainty, as many decimals of its value; no decision reads otherwise."""

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softcal.core.messages.figures import (
    find_decimals,
    format_error,
    format_limit,
    format_uncertainty,
    format_value,
    with_decimals,
)
from softcal.core.messages.reason import Reason, reason


@given(st.floats(1e-6, 1e6))
def test_an_uncertainty_has_two_significant_digits_and_is_not_moved_by_more_than_half_a_step(value: float) -> None:
    rounded = Decimal(format_uncertainty(value))
    digits = "".join(map(str, rounded.normalize().as_tuple().digits))
    assert len(digits) <= 2
    assert float(rounded) == pytest.approx(value, rel=0.0501)


@given(st.floats(-1e4, 1e4), st.floats(1e-4, 1e4))
def test_a_value_has_the_decimals_of_its_uncertainty(value: float, uncertainty: float) -> None:
    text, u = format_value(value, uncertainty), format_uncertainty(uncertainty)
    assert len(text.partition(".")[2]) == len(u.partition(".")[2])
    assert abs(float(text) - value) <= 0.051 * uncertainty * 1.001


@pytest.mark.parametrize(
    ("value", "uncertainty", "text", "u"),
    [
        (0.3290796, 0.052345, "0.329", "0.052"),
        (0.3290796, 0.0996, "0.33", "0.10"),
        (1234.5, 123.0, "1230", "120"),
        (2.0, 0.5, "2.00", "0.50"),
    ],
)
def test_as_the_guide_writes_it(value: float, uncertainty: float, text: str, u: str) -> None:
    assert (format_value(value, uncertainty), format_uncertainty(uncertainty)) == (text, u)


@given(st.floats(0.1, 1), st.floats(-2e-3, 2e-3), st.integers(0, 4))
def test_rounding_never_turns_a_comparison_around(value: float, apart: float, decimals: int) -> None:
    values = {"upper": value, "limit": value + apart}
    decimals_needed = find_decimals(values, decimals, [("upper", "limit")])
    printed = {name: float(with_decimals(one, decimals_needed)) for name, one in values.items()}
    if abs(apart) > 1e-8:
        assert (printed["upper"] <= printed["limit"]) == (values["upper"] <= values["limit"])
    assert decimals_needed >= decimals


STATED = st.builds(lambda digits, power: Decimal(digits).scaleb(power), st.integers(1, 99_999), st.integers(-7, 1))
"""Limits as a person writes them."""


@given(STATED)
def test_a_limit_is_written_in_the_digits_it_was_stated_with(stated: Decimal) -> None:
    shown = format_limit(float(stated))
    assert Decimal(shown) == stated and "e" not in shown.lower()
    assert not ("." in shown and shown.endswith("0"))


@given(st.floats(1e-4, 1e4))
def test_a_limit_that_was_computed_has_three_digits(factor: float) -> None:
    shown = format_limit(factor / 7.0)
    assert float(shown) == pytest.approx(factor / 7.0, rel=0.0051)
    assert len(shown.replace(".", "").strip("0")) <= 10


@given(STATED, st.floats(0.01, 100.0))
def test_errors_beside_a_limit_have_as_many_decimals_as_it_at_least(stated: Decimal, times: float) -> None:
    limit, places = float(stated), {}
    for error in (limit, times * limit, 0.0):
        shown = format_error(error, limit)
        places[len(shown.partition(".")[2])] = error
        assert float(shown) == pytest.approx(error, abs=0.0051 * limit)
    assert len(places) == 1 and min(places) >= len(format_limit(limit).partition(".")[2])


@given(STATED, st.floats(0.1, 10.0))
def test_a_sentence_writes_limit_and_errors_by_the_same_rule(stated: Decimal, times: float) -> None:
    limit = float(stated)
    numbers = {name: times * limit for name in ("rmse", "lower", "upper")}
    phrases = {"source": "part.predicted", "relation": "part.within", "origin": "part.stated"}
    said = reason("statement", limit=limit, unit="N", **numbers, **{k: Reason(v) for k, v in phrases.items()})
    assert f"limit {format_limit(limit)} N" in str(said)
    assert f"RMSE {format_error(times * limit, limit)} N" in str(said)
