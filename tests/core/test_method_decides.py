"""Each number of a release changes what is decided on drawn audits, not only the identity of the method."""

from collections.abc import Iterator
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from softcal.core.quality.acceptance import criterion_rows
from softcal.core.quality.audit_check import find_suspect_audits
from softcal.core.quality.interval_inflation import AuditedSamples, fit_interval_inflation
from softcal.core.quality.lot_release import release_lot
from softcal.core.quality.qualification import PastAudit, qualify
from softcal.core.quality.release import AuditedUnit, min_passing, release
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.line_spread import estimate_gains
from softcal.core.unit.lot_correction import AuditedLine, LotCorrection
from softcal.core.unit.method import Method, ReleaseConfig
from softcal.core.unit.output_level import LoadLine
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit
from tests.unit_states import audit_result

LIMIT = Limit("N", 1.0)
NOW = datetime(2026, 5, 1, tzinfo=UTC)


def audited(count, spread, lot="here"):
    errors = np.exp(spread * np.random.default_rng(count).normal(size=count))
    return [AuditedUnit(f"{lot} {k}", 0.3, 0.3 * float(error)) for k, error in enumerate(errors)]


def released(method):
    """What is released of good, of scattered and of poor lots, on few and on many audits."""
    rest = {f"U{k}": 0.1 + 0.02 * k for k in range(40)}
    for count in range(2, 15):
        for spread in (0.03, 0.25):
            config = method.release
            yield release(rest, audited(count, spread), LIMIT, config)
    yield [release({"U": 0.1} | dict.fromkeys(map(str, range(n)), 9.0), audited(9, 0.1), LIMIT, config) for n in (1, 2)]
    yield min_passing(24, 10, method.release)


def qualified(method):
    """Which past audits qualify lots, by their age and by the number of lots they are of."""
    for days in (100, 300, 400, 700):
        for lots in range(1, 7):
            past = [
                PastAudit(replace(unit, lot_id=f"lot {lot}"), "EG", method.id, NOW - timedelta(days=days))
                for lot in range(lots)
                for unit in audited(10, 0.1)
            ]
            qualification = qualify([], past, NOW, "EG", method)
            yield qualification.source, qualification.reason.to_json()
    yield [qualify(audited(count, 0.1), [], NOW, "EG", method, units=30).required for count in range(10)]


def criterion_of(method):
    """What a paper says of a lot: risk, confidence and what a poor lot falls short of."""
    qualification = qualify(audited(20, 0.1), [], NOW, "EG", method)
    for forecasts in ({"U": 0.2}, {"U": 0.2, "V": 9.0, "W": 9.0}):
        yield release_lot(forecasts, qualification, LIMIT, method.release).statement.to_json()
    yield criterion_rows(method.release)


def widened(method):
    for units in (5, 30, 60):
        rng = np.random.default_rng(units)
        audits = [AuditedSamples(np.abs(rng.normal(size=60)) * (0.5 + rng.random()), np.ones(60)) for _ in range(units)]
        yield vars(fit_interval_inflation(audits, 0.9, method.release))


def suspected(method):
    """Which audits are set aside: a far gain, a far rest, or two exchanged units, beside alike or unlike ones."""
    for others in range(1, 9):
        for scatter in (0.0, 0.03):
            alike = {f"U{k}": audit_result(f"U{k}", 1.0, k, k + scatter * (-1) ** k) for k in range(others)}
            for gain in (1.6, 2.5, 4.0, 5.0):
                yield find_suspect_audits({**alike, "far": audit_result("far", gain)}, method)
            for moved in (0.02, 0.08, 0.11, 0.15, 0.25, 0.35, 0.5):
                yield find_suspect_audits({**alike, "far": audit_result("far", 1.0, 50.0, 50.0 + moved)}, method)
            for apart in (0.008, 0.015, 0.03, 0.06, 0.1, 0.2, 0.4):
                pair = {
                    "A": audit_result("A", 1.0, 60.0, 60.0 + apart),
                    "B": audit_result("B", 1.0, 60.0 + apart, 60.0),
                }
                yield find_suspect_audits({**alike, **pair}, method)
    yield [estimate_gains([1.0, 1.1] * count, method.release.min_others) is None for count in range(1, 5)]


def decided(method):
    cases = (released, qualified, criterion_of, widened, suspected)
    return [[str(one) for one in case(method)] for case in cases]


def changed(value):
    """A number halved, doubled and half as large again; of a share its distance from 1 as well."""
    kind = type(value)
    changes = {kind(value * factor) for factor in (0.5, 1.5, 2.0)}
    return sorted((one for one in changes | ({(1 + value) / 2} if 0 < value < 1 else set()) if one != value), key=float)


def changes(name) -> Iterator[Method]:
    method = Method()
    for value in changed(getattr(method.release, name)):
        is_share = name in ("risk", "confidence", "min_coverage")
        if not is_share or 0 < value < 1:
            yield replace(method, release=replace(method.release, **{name: value}))


@pytest.fixture(scope="module")
def usual():
    return decided(Method())


NUMBERS = [one.name for one in fields(ReleaseConfig) if one.name != "min_correction_audits"]


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_of_a_release_changes_what_is_decided_with_the_identity(name, usual):
    others = list(changes(name))
    assert others and all(one.id != Method().id for one in others)
    assert any(decided(one) != usual for one in others)


def test_a_gain_is_out_of_line_by_the_method_that_is_hashed(usual):
    method = Method()
    for stretch in (1.5, 4.5):
        other = replace(method, findings=replace(method.findings, stretch=stretch))
        assert other.id != method.id and decided(other) != usual


def test_fifty_audits_and_a_risk_of_a_thousandth_release_nothing_on_ten_audits():
    method = replace(Method(), release=ReleaseConfig(min_audits=50, risk=0.001))
    rest, audits = {"U": 0.1}, audited(10, 0.1)
    assert release(rest, audits, LIMIT, Method().release).released == ("U",)
    assert release(rest, audits, LIMIT, method.release).released == ()
    assert qualify(audits, [], NOW, "EG", method).required == 989


def test_a_correction_takes_the_number_of_audits_of_the_units_own_method(source_model, press):
    state = calibrate(UnitProblem(source_model, press(7, 1.2, 0.03, 80.0, "A1").unlabelled))
    lines = {f"U{k}": AuditedLine(LoadLine(1.1 + 0.001 * k, 0.05)) for k in range(4)}
    method = state.fit.method
    for min_audits, is_corrected in ((4, True), (5, False)):
        other = replace(method, release=replace(method.release, min_correction_audits=min_audits))
        state_by_other_method = replace(state, fit=replace(state.fit, method=other))
        correction = LotCorrection(1, lines).apply(state_by_other_method, source_model.source).correction
        assert (correction is not None) == is_corrected and other.id != method.id
