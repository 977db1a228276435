"""What follows from the slots of a unit's state: acts commute, and no statement outlives what it rests on."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.interface import map_sha256
from softcal.core.messages.reason import Reason, plain, reason
from softcal.core.unit.adjustments import Correction, SampleRelease, Trim
from softcal.core.unit.measured_error import MeasuredError, Scores
from softcal.core.unit.method import DecisionConfig
from softcal.core.unit.output_level import LoadLine
from softcal.core.unit.state import UnitState
from softcal.core.unit.state_json import adjustments_to_json, fit_from_json, fit_to_json, state_from_json
from softcal.core.unit.uncertainty import IntervalInflation
from softcal.core.unit.verdict import Finding, Limit, Verdict, default_limit, worst_of
from softcal.core.windows import resting
from tests.unit_states import audit_of, fit_of

LIMIT = Limit("N", 0.4)
HERE = reason("part.here", audits=10)


def trim_of(gain: float = 1.1, offset: float = 0.02, **others: object) -> Trim:
    values: dict[str, object] = {
        "output": (0.5, 0.9),
        "reference": (0.0, 2.5),
        "recording_sha256": "c" * 64,
        "gain": gain,
        "offset": offset,
        "covariance": ((0.0004, 0.0), (0.0, 0.0001)),
        "before_rmse": 0.3,
        "after_rmse": 0.05,
    }
    return Trim(**{**values, **others})  # type: ignore[arg-type]


def correction_of(number: int = 1, gain: float = 0.95) -> Correction:
    line = LoadLine(1 / gain, 0.01)
    return Correction(number=number, line=line, gain_error=0.02, zero_error=0.01, audits=9, gain=gain, offset=-0.01)


def release_of(
    is_released: bool = True, scale: float = 1.2, factor: float | None = 2.0, **others: object
) -> SampleRelease:
    values: dict[str, object] = {
        "number": 1,
        "limit_rmse": LIMIT.maximum_rmse,
        "is_released": is_released,
        "scale": 1.2,
        "factor": 2.0,
        "interval_inflation": IntervalInflation(0.9, 0.05),
        "day_rmse": 0.0,
        "audits": HERE,
        "risk": 0.1,
        "confidence": 0.9,
    }
    return SampleRelease(**{**values, **others})  # type: ignore[arg-type]


def fitted(number: int = 1, **others: object) -> UnitState:
    return UnitState(fit=fit_of("U1", "n" * 64, "c" * 64, number, **others), limit=LIMIT)


ACTS = {
    "trim": lambda state: replace(state, trim=trim_of()),
    "correction": lambda state: replace(state, correction=correction_of()),
    "release": lambda state: replace(state, release=release_of()),
    "limit": lambda state: replace(state, limit=Limit("N", 0.35)),
    "suspect": lambda state: replace(state, suspect_audit=reason("doubt.one_recording", other="U2")),
    "unreadable": lambda state: replace(state, unreadable_audit=reason("audit.unreadable", error="no column")),
}


@pytest.mark.parametrize("names", [("trim", "correction", "release"), ("limit", "suspect", "trim", "unreadable")])
def test_acts_on_different_slots_end_the_same_in_any_order(names):
    ends = []
    for order in permutations(names):
        state = fitted()
        for name in order:
            state = ACTS[name](state)
        ends.append((adjustments_to_json(state), state.decision, state.map_sha256, state.forecast))
    assert all(end == ends[0] for end in ends)


def test_a_state_is_read_back_with_every_slot_filled():
    state = fitted()
    for act in ACTS.values():
        state = act(state)
    state = replace(state, audit=audit_of(state, 0.9, 0.2))
    stored = fit_to_json(state.fit)
    again = state_from_json(fit_from_json(stored.content, state.fit.method, stored.arrays), adjustments_to_json(state))
    assert adjustments_to_json(again) == adjustments_to_json(state)
    assert (again.decision, again.map_sha256, again.forecast) == (state.decision, state.map_sha256, state.forecast)
    assert np.array_equal(again.interval.half_width, state.interval.half_width)


def test_the_map_in_force_is_the_fitted_one_with_one_line_behind_it():
    plain_map, corrected = fitted(), replace(fitted(), correction=correction_of())
    both = replace(corrected, trim=trim_of())
    windows = resting(np.array([0.5, 0.8]))
    mapped = plain_map.unit_map.apply(windows)
    assert np.allclose(corrected.unit_map.apply(windows), 0.95 * mapped - 0.01)
    # Known loads of the unit outrank what the lot's audits say.
    assert np.allclose(both.unit_map.apply(windows), 1.1 * mapped + 0.02)
    assert both.map_id == replace(plain_map, trim=trim_of()).map_id != corrected.map_id != plain_map.map_id


def test_a_trim_of_a_map_with_known_loads_leaves_one_gain_and_offset():
    unit_map = AnchoredMap(AffineMap(2.0, 0.0), 1.5, 0.1)
    fit = fit_of("U1", "n" * 64, "c" * 64)
    fit = replace(fit, map_sha256=map_sha256(unit_map), fitted=replace(fit.fitted, unit_map=unit_map))
    trimmed = replace(fitted(), fit=fit, trim=trim_of()).unit_map
    assert isinstance(trimmed, AnchoredMap) and not isinstance(trimmed.inner, AnchoredMap)
    assert (trimmed.gain, trimmed.offset) == pytest.approx((1.1 * 1.5, 0.02 + 1.1 * 0.1))


@pytest.mark.parametrize("line", [trim_of(), correction_of()], ids=["trim", "correction"])
def test_what_a_line_leaves_open_widens_the_interval_in_quadrature(line):
    name = "trim" if isinstance(line, Trim) else "correction"
    state, wider = fitted(), replace(fitted(), **{name: line})
    level = state.interval.levels
    zero, gain = (0.02, 0.01) if name == "trim" else (0.01, 0.02)
    variance = zero**2 + (gain * level) ** 2
    expected = np.sqrt(state.interval.half_width**2 + 1.645**2 * variance)
    assert np.allclose(wider.interval.half_width, expected)


def test_a_sample_release_scales_forecast_and_interval_and_makes_a_conditional_unit_pass():
    state = fitted()
    released = replace(state, release=release_of())
    assert (state.verdict, released.verdict) == (Verdict.CONDITIONAL, Verdict.PASS)
    assert released.forecast.rmse == pytest.approx(1.2 * state.forecast.rmse)
    assert released.forecast.upper == pytest.approx(2.0 * state.forecast.rmse)
    assert np.allclose(released.interval.half_width, np.hypot(0.9 * state.interval.half_width, 0.05))
    assert np.array_equal(released.measured_interval.half_width, state.interval.half_width)
    assert released.map_id == state.map_id


BLOCKING_CHANGES = {
    "a finding": lambda state: replace(state, fit=replace(state.fit, findings=(Finding(plain("dead"), Verdict.FAIL),))),
    "a rule": lambda state: replace(
        state, fit=replace(state.fit, rule_findings=(Finding(plain("no label"), Verdict.RETEST),))
    ),
    "a reference without a certificate": lambda state: replace(
        state, fit=replace(state.fit, blocking_reasons=(reason("reference_missing", cell="LC-1"),))
    ),
    "a trim": lambda state: replace(state, trim=trim_of()),
    "a trim that is older": lambda state: replace(
        state, trim=trim_of(left_out=reason("trim.older", loads=2), is_blocking=True)
    ),
    "an unreadable audit": ACTS["unreadable"],
    "a suspect audit": ACTS["suspect"],
    "another limit": lambda state: replace(state, limit=Limit("N", 0.39)),
    "no stated limit": lambda state: replace(state, limit=default_limit("N", 0.15, 3.0, DecisionConfig())),
    "a withdrawn statement": lambda state: replace(
        state, release=release_of(is_released=False, withdrawn=reason("part.withdrawn"))
    ),
    "a fit of a worse map": lambda state: replace(state, release=release_of(is_released=False)),
}


@pytest.mark.parametrize("against", BLOCKING_CHANGES)
def test_nothing_is_released_by_sample_that_something_stands_against(against):
    state = BLOCKING_CHANGES[against](replace(fitted(), release=release_of()))
    assert state.verdict is not Verdict.PASS and not state.is_released


def measured(after: float, **others: object) -> UnitState:
    state = fitted(**others)
    return replace(state, audit=audit_of(state, 1.0, after))


def test_what_was_measured_outranks_what_is_reported_of_the_lot():
    good, bad = measured(0.1), measured(0.9)
    assert (good.verdict, bad.verdict) == (Verdict.PASS, Verdict.FAIL)
    assert replace(bad, release=release_of()).verdict is Verdict.FAIL
    assert replace(good, release=release_of()).forecast == good.forecast
    assert good.errors["after_rmse"] == 0.1 and fitted().errors["after_rmse"] is None


def test_an_audit_speaks_of_the_map_that_it_measured_alone_but_a_fail_stays():
    for change in ({"trim": trim_of()}, {"correction": correction_of()}):
        good, bad = (replace(measured(after), **change) for after in (0.1, 0.9))
        assert good.verdict is Verdict.CONDITIONAL and good.scores is None
        assert "audited_before_trim" in {why.code for why in good.decision.reasons}
        assert bad.verdict is Verdict.FAIL and bad.scores is None
        again = replace(good, audit=audit_of(good, 1.0, 0.1))
        assert again.verdict is Verdict.PASS and not again.blocking_reasons


def test_an_audit_that_may_be_of_another_unit_states_no_error():
    for after in (0.1, 0.9):
        suspect = ACTS["suspect"](measured(after))
        assert suspect.verdict is Verdict.RETEST and suspect.scores is None
        assert {name: value for name, value in suspect.errors.items() if value is not None} == {
            "predicted_rmse": suspect.predicted_rmse
        }
        confirmed = replace(suspect, suspect_audit=None)
        assert confirmed.errors["after_rmse"] == after


def test_loads_that_were_left_out_block_until_a_newer_audit_and_what_the_map_reads_blocks_nothing():
    left_out = trim_of(left_out=reason("trim.older", loads=2), is_blocking=True, audit_sha256="")
    before = replace(fitted(), trim=left_out)
    assert before.blocking_reasons and before.trim_in_force is None and before.map_id == fitted().map_id
    after = replace(before, audit=audit_of(before, 1.0, 0.1))
    assert after.verdict is Verdict.PASS and not after.blocking_reasons
    older = replace(after, trim=replace(left_out, audit_sha256=after.audit.recording_sha256))
    assert older.blocking_reasons and older.verdict is Verdict.CONDITIONAL
    read = replace(fitted(), trim=trim_of(left_out=reason("trim.read", loads=2)))
    assert not read.blocking_reasons and "trim.read" in {why.code for why in read.decision.reasons}


FINDINGS = st.lists(st.sampled_from(list(Verdict)), max_size=2)


@settings(max_examples=2000, deadline=None)
@given(
    number=st.integers(1, 6),
    verdicts_of_findings=FINDINGS,
    limit=st.sampled_from([LIMIT, Limit("N", 0.2), default_limit("N", 0.15, 3.0, DecisionConfig())]),
    acts=st.lists(st.sampled_from(["trim", "correction", "release", "suspect", "unreadable"]), max_size=6),
    after=st.none() | st.floats(0.01, 1.0),
    rows=st.integers(30, 20_000),
)
def test_after_any_history_a_pass_rests_on_an_audit_of_this_map_or_on_a_statement_for_this_limit(
    number, verdicts_of_findings, limit, acts, after, rows
):
    state = replace(
        fitted(number, findings=tuple(Finding(plain("seen"), word) for word in verdicts_of_findings)), limit=limit
    )
    if after is not None:
        audit = replace(
            audit_of(state, 1.0, after), scores=Scores(MeasuredError(1.0, rows), MeasuredError(after, rows))
        )
        state = replace(state, audit=audit)
    for name in acts:
        state = ACTS[name](state)
    decision = state.decision
    assert state.is_released == (decision.verdict is Verdict.PASS) and decision.reasons
    assert all(isinstance(why, Reason) for why in decision.reasons)
    if not state.is_released:
        return
    assert limit.is_stated and state.suspect_audit is None and not state.blocking_reasons
    if state.scores is not None:
        assert state.audit.map_id == state.map_id
        assert state.scores.after.interval.upper <= limit.acceptance_rmse
    else:
        release = state.release_in_force
        assert release.is_released and release.limit_rmse == limit.maximum_rmse
        assert worst_of(verdicts_of_findings).is_open
