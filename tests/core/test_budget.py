"""The uncertainty budget against Monte Carlo (GUM Supplement 1) and by hand; what a reference lets a verdict say."""

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import date

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.maps.config import MapConfig
from softcal.core.messages.reason import plain
from softcal.core.recording import LabelledRecording
from softcal.core.unit.budget import (
    SIMULATED,
    Contribution,
    Reference,
    Traceability,
    forecast_budget,
    measured_budget,
)
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.correspondence import Correspondence, CorrespondenceTable
from softcal.core.unit.measured_error import MeasuredError, Scores
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.state_json import fit_from_json, fit_to_json
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Assessment, Decision, Limit, Verdict, compare_with_audit, compare_with_limit

DRAWS = 400_000
CELL = Reference(
    "LC-7",
    "D-K-1",
    "DAkkS",
    date(2026, 1, 1),
    date(2028, 1, 1),
    date(2026, 6, 1),
    uncertainty=0.012,
    capacity=10.0,
    drift=0.010,
    temperature_per_K=0.0005,
    temperature_K=3.0,
    contact=0.006,
    repeatability=0.004,
)
STAGE = Correspondence("stage", CorrespondenceTable().stage)
TERMS = {"model": 0.06, "resolution": 0.02, "stage": 0.1, "slow": 0.02}


def by_monte_carlo(reference: Reference, load: float, rmse: float, rng: np.random.Generator) -> np.ndarray:
    """Errors of estimates at a load: the reading the source was trained on goes through the measurement equation.

    reading = (load + calibration + drift) (1 + coefficient dT) + contact + repeatability; the estimate repeats it with
    an error of its own. Nothing of `budget.py` is used.
    """
    assert reference.uncertainty is not None and reference.temperature_per_K is not None
    drift = reference.uncertainty if reference.drift is None else reference.drift
    calibration = rng.normal(0, reference.uncertainty / reference.coverage_factor, DRAWS)
    errors = load + calibration + rng.uniform(-drift, drift, DRAWS)
    kelvin = rng.uniform(-1, 1, DRAWS) * (reference.temperature_K or 0.0)
    reading = errors * (1 + reference.temperature_per_K * kelvin)
    reading += rng.normal(0, reference.contact or 0.0, DRAWS) + rng.normal(0, reference.repeatability or 0.0, DRAWS)
    return np.asarray(reading + rng.normal(0, rmse, DRAWS) - load)


@pytest.mark.parametrize(
    ("changes", "load", "rmse"),
    [
        ({}, 2.0, 0.09),
        ({}, 7.5, 0.0601),
        ({"drift": None}, 3.0, 0.07),
        ({"drift": 0.08}, 3.0, 0.061),  # one rectangular part dominates
        ({"temperature_per_K": 0.01}, 7.5, 0.07),
        ({"uncertainty": 5.0, "coverage_factor": 2.2}, 7.5, 0.09),
    ],
)
def test_the_budget_is_what_monte_carlo_gives(
    changes: dict[str, float], load: float, rmse: float, rng: np.random.Generator
) -> None:
    reference = replace(CELL, **changes)
    budget = forecast_budget(TERMS, STAGE, rmse, reference, load)
    errors = by_monte_carlo(reference, load, rmse, rng)
    assert budget.standard == pytest.approx(errors.std(), rel=0.05)
    low, high = np.quantile(errors, (0.0228, 0.9772))  # k = 2 of a normal distribution
    is_rectangular = max(budget.contributions, key=lambda each: each.standard).distribution == "rectangular"
    assert budget.expanded == pytest.approx((high - low) / 2, rel=0.12 if is_rectangular else 0.05)


def test_the_example_of_the_documents_is_the_sum_by_hand() -> None:
    """docs/certificates.md: U = 0.012 N (k = 2), drift 10 mN, 0.05 %/K over 3 K at 2 N, contact 6, repeated 4 mN."""
    budget = forecast_budget(TERMS, STAGE, 0.09, CELL, 2.0)
    by_hand_mN = {
        "reference calibration": 12 / 2,
        "reference drift": 10 / 3**0.5,
        "reference temperature": 2000 * 0.0005 * 3 / 3**0.5,
        "contact": 6.0,
        "repeatability": 4.0,
        "shared network f": 60.0,
        "map": (90.0**2 - 60.0**2 - 30.0**2) ** 0.5,
        "quantisation": 1.5 * 20.0,
    }
    assert {each.name: 1000 * each.standard for each in budget.contributions} == pytest.approx(by_hand_mN)
    assert 1000 * budget.standard == pytest.approx(sum(u**2 for u in by_hand_mN.values()) ** 0.5)
    assert budget.expanded == pytest.approx(0.1814, abs=1e-4)


def test_f_map_and_quantisation_share_the_forecast_among_them() -> None:
    for kind in vars(CorrespondenceTable()):
        correspondence = Correspondence(kind, getattr(CorrespondenceTable(), kind))
        for rmse in (0.01, 0.06, 0.061, 0.3):
            budget = forecast_budget(TERMS, correspondence, rmse, None, 1.0)
            assert budget.standard == pytest.approx(rmse)
    assert measured_budget(0.2, CELL, 2.0).standard == pytest.approx(np.hypot(0.2, CELL.expanded(2.0) / 2))
    assert Contribution("x", 3.0, "rectangular", sensitivity=-2.0).standard == pytest.approx(6 / 3**0.5)


@pytest.mark.parametrize(
    ("changes", "traceability"),
    [
        ({}, Traceability.VALID),
        ({"used_on": date(2028, 1, 1)}, Traceability.EXPIRED),
        ({"used_on": date(2027, 12, 31)}, Traceability.VALID),
        ({"used_on": date(2025, 12, 31)}, Traceability.EXPIRED),
        ({"certificate": ""}, Traceability.MISSING),
        ({"certificate": "", "cell": ""}, Traceability.MISSING),
        ({"uncertainty": None}, Traceability.MISSING),
        ({"due_on": None}, Traceability.MISSING),
        ({"is_simulated": True}, Traceability.SIMULATED),
    ],
)
def test_a_named_cell_without_a_certificate_that_held_bars_and_what_nobody_stated_does_not(
    changes: dict[str, object], traceability: Traceability
) -> None:
    reference = replace(CELL, **changes)  # type: ignore[arg-type]
    assert reference.traceability is traceability
    is_named = bool(reference.cell) and not reference.certificate
    assert bool(reference.blocking_reasons(5.0)) == (traceability is Traceability.EXPIRED or is_named)
    assert [why.code for why in CELL.blocking_reasons(10.1)] == ["reference_range"]


@pytest.mark.parametrize(
    "changes",
    [
        {"uncertainty": -1.0},
        {"uncertainty": 0.0},
        {"drift": float("nan")},
        {"coverage_factor": 0.0},
        {"due_on": date(2025, 1, 1)},
    ],
)
def test_a_reference_that_cannot_be_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(InputError):
        replace(CELL, **changes)  # type: ignore[arg-type]


def test_a_unit_beyond_the_limit_is_let_through_in_fewer_than_one_case_in_twenty(rng: np.random.Generator) -> None:
    """A unit right at the acceptance limit, the reference wrong by a normal amount: how often is the truth beyond?"""
    for expanded in (0.05, 0.2, 0.39):
        limit = Limit("N", 0.4, reference_expanded=expanded)
        guard = 0.02
        measured = limit.acceptance_rmse - guard
        observed = np.maximum(measured + rng.normal(0, guard / 2, DRAWS), 0)
        true = np.hypot(observed, rng.normal(0, expanded / 2, DRAWS))
        assert compare_with_limit(ErrorForecast(measured, 0.0, measured + guard * 0.999), limit).verdict is Verdict.PASS
        assert np.mean(true > limit.maximum_rmse) < 0.05


def test_five_newton_on_a_scale_of_seven_and_a_half_cannot_pass() -> None:
    limit = Limit("N", 0.4, reference_expanded=replace(CELL, uncertainty=5.0).expanded(4.0))
    best = compare_with_audit(Scores(MeasuredError(1.0, 5000), MeasuredError(0.01, 5000)), limit)
    assert best.verdict is Verdict.CONDITIONAL
    assert [why.code for why in best.reasons] == ["reference_uncertain", "statement"]


def test_a_blocking_reason_blocks_a_pass_however_the_unit_was_decided() -> None:
    good, blocking_reasons = Assessment(Verdict.PASS, (plain("good"),)), (plain("expired"),)
    for decision in (
        Decision(good, blocking_reasons=blocking_reasons),
        Decision(good, good, blocking_reasons=blocking_reasons),
        Decision(good, None, good, blocking_reasons),
    ):
        assert decision.verdict is Verdict.CONDITIONAL
        assert decision.reasons[0] == blocking_reasons[0]
    bad = Assessment(Verdict.FAIL, (plain("bad"),))
    assert Decision(good, bad, blocking_reasons=blocking_reasons).verdict is Verdict.FAIL
    assert Decision(good, bad, blocking_reasons=blocking_reasons).reasons[0] == plain("bad")


def test_the_reference_reaches_interval_verdict_and_identity(
    source_model: SourceModel, press: Callable[..., LabelledRecording]
) -> None:
    source_model = replace(source_model, method=Method(map=MapConfig(family="affine")))
    unit, audit = press(2, gain=1.3, offset_V=0.05, seconds=120.0).unlabelled, press(3, gain=1.3, offset_V=0.05)
    plain_problem = UnitProblem(source_model, unit, Limit("N", 2.0), audit=audit)
    calibrations = {
        name: calibrate(replace(plain_problem, reference=reference))
        for name, reference in {
            "nobody": None,
            "simulated": SIMULATED,
            "valid": CELL,
            "poor": replace(CELL, uncertainty=5.0),
            "expired": replace(CELL, used_on=date(2029, 1, 1)),
        }.items()
    }
    verdicts = {name: calibration.decision.verdict for name, calibration in calibrations.items()}
    assert verdicts["nobody"] == verdicts["simulated"] == verdicts["valid"] == Verdict.PASS
    assert verdicts["poor"] == verdicts["expired"] == Verdict.CONDITIONAL
    assert np.array_equal(calibrations["nobody"].interval.half_width, calibrations["simulated"].interval.half_width)
    width, loads = calibrations["nobody"].interval.half_width, np.linspace(0, 1, 64)
    wider = calibrations["valid"].interval.half_width
    low, high = calibrations["valid"].interval.low, calibrations["valid"].interval.high
    levels = low + (loads * 63 + 0.5) / 64 * (high - low)
    added = 1.645 * np.sqrt([CELL.expanded(level) ** 2 / 4 for level in levels])
    assert wider == pytest.approx(np.hypot(width, added), rel=1e-6)
    assert len({replace(plain_problem, reference=r).input_sha256 for r in (None, CELL)}) == 2
    stored = fit_to_json(calibrations["valid"].fit)
    assert fit_from_json(json.loads(json.dumps(stored.content)), calibrations["valid"].fit.method).reference == CELL
