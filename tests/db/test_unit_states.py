"""What was done to units stands in typed columns: every state comes back as it was, and each part is stored once."""

from dataclasses import replace
from itertools import count

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import func, select

from softcal.core.messages.reason import plain, reason
from softcal.core.unit.adjustments import Correction, SampleRelease, Trim
from softcal.core.unit.measured_error import AuditResult, MeasuredError, OwnCalibrationScores, Scores
from softcal.core.unit.output_level import LoadLine
from softcal.core.unit.state import UnitState
from softcal.core.unit.state_json import adjustments_to_json
from softcal.core.unit.uncertainty import IntervalInflation
from softcal.core.unit.verdict import Limit
from softcal.db.maintenance.checks import faults
from softcal.db.schema.tables import STATE_PARTS
from tests.unit_states import sample_release

# Whole numbers, zeros with a sign and the smallest numbers are what databases change first.
number = st.floats(-1e9, 1e9) | st.sampled_from([0.0, -0.0, 1.0, 5e-324, 0.1]) | st.integers(-3, 3)
positive = st.floats(1e-3, 1e3) | st.integers(1, 5)
counted = st.integers(1, 2**31 - 1)
sha256 = st.sampled_from(["a" * 64, "b" * 64])
why = st.none() | st.sampled_from([plain("라벨이 없음"), reason("trimmed", loads=2, before=0.1, after=0.05)])
numbers = st.lists(number, max_size=3).map(tuple)
pair = st.tuples(number, number)
line, error = st.builds(LoadLine, number, number), st.builds(MeasuredError, positive, counted)
own_scores = st.none() | st.builds(OwnCalibrationScores, error, error, error)
scores = st.builds(Scores, error, error, own_scores, st.dictionaries(st.sampled_from(["gap", "stuck"]), counted))
limits = st.builds(
    Limit, st.just("N"), positive, reference_expanded=st.none() | positive, full_range=st.none() | positive
)
trims = st.builds(
    Trim,
    output=numbers,
    reference=numbers,
    recording_sha256=sha256,
    audit_sha256=st.just("") | sha256,
    gain=positive,
    offset=number,
    covariance=st.tuples(pair, pair),
    left_out=why,
    is_blocking=st.booleans(),
)
corrections = st.builds(
    Correction, number=counted, line=line, gain_error=number, zero_error=number, audits=counted, gain=positive
)
releases = st.builds(
    SampleRelease,
    number=counted,
    limit_rmse=positive,
    is_released=st.booleans(),
    scale=positive,
    factor=st.none() | positive,
    interval_inflation=st.builds(IntervalInflation, positive, positive),
    day_rmse=number,
    audits=st.just(plain("ten audits")),
    risk=positive,
    confidence=positive,
    sitting=st.sampled_from(["", "a" * 64]),
    withdrawn=why,
)
audits = st.builds(
    AuditResult,
    map_id=sha256,
    recording_sha256=sha256,
    output_sha256=sha256,
    scores=scores,
    line=line,
    fitted_line=line,
    unit_rest=number,
    audit_rest=number,
    span=number,
    residual=numbers,
    half=numbers,
)
adjustments = st.fixed_dictionaries(
    {
        "limit": limits,
        "trim": st.none() | trims,
        "correction": st.none() | corrections,
        "release": st.none() | releases,
        "audit": st.none() | audits,
        "unreadable_audit": why,
        "suspect_audit": why,
    }
)


def test_every_state_comes_back_as_it_was(factory):
    serials = count()

    @settings(max_examples=25, suppress_health_check=list(HealthCheck), deadline=None, database=None)
    @given(adjustments)
    def comes_back(drawn):
        registry, serial = factory.registry, f"U{next(serials)}"
        state = replace(factory.state(serial, 1), **drawn)
        registry.calibrations.add("L1", state)
        stored = registry.calibrations.get(serial, lot_id="L1").state
        # Another limit is in force than most of these were decided on by.
        listed = registry.pages.unit_statuses("L1", [serial], has_stale=True)[serial].state
        for one in (stored, listed):
            assert {name: getattr(one, name) for name in drawn} == drawn
            assert one.verdict == state.verdict
        assert not registry.calibrations.put_state("L1", stored, "release", actor=None, reason="the same state")

    comes_back()
    assert list(faults(factory.registry.database)) == []


def test_a_part_that_states_share_is_stored_once(factory):
    state = factory.state("A1", 1)
    for serial in ("A1", "A2", "A3"):
        for limit_rmse in (1.0, 2.0):
            one = replace(
                factory.state(serial, 1), release=sample_release(), audit=state.audit, limit=Limit("N", limit_rmse)
            )
            factory.registry.calibrations.add("L1", one)
    tables = [STATE_PARTS[name] for name in ("release", "audit", "trim")]
    assert [factory.registry.database.value(select(func.count()).select_from(table)) for table in tables] == [1, 1, 0]


def test_a_press_keeps_its_forecast_when_a_statement_scales_that_of_the_unit(factory):
    state = replace(factory.state("A1", 1), limit=Limit("N", 2.0), audit=None)
    scaled = replace(state, release=sample_release(scale=0.5))
    for one in (state, scaled):
        factory.registry.calibrations.add("L1", one)
    assert scaled.predicted_rmse == state.predicted_rmse / 2
    (run,) = factory.registry.lots.runs("L1", "A1")
    assert (run.predicted_rmse, run.verdict) == (state.predicted_rmse, scaled.verdict)


def test_equal_states_have_equal_json_whatever_kind_of_number_they_were_given():
    def state(zero: float, whole: float) -> UnitState:
        line = LoadLine(whole, zero)
        correction = Correction(number=1, line=line, gain_error=zero, zero_error=whole, audits=3)
        return UnitState(fit=None, limit=Limit("N", whole), correction=correction)  # type: ignore[arg-type]

    assert repr(adjustments_to_json(state(-0.0, 1))) == repr(adjustments_to_json(state(0.0, 1.0)))
