"""Audit plans: who is chosen, and the statements against closed forms and SciPy's own intervals."""

import numpy as np
import pytest
from scipy.stats import hypergeom

from softcal.core.errors import InputError
from softcal.core.quality.audit_plan import AuditConfig, evaluate_audit, nonconforming_upper, plan_audit
from softcal.core.unit.verdict import Limit

LIMIT = Limit("N", 0.2)
FORECASTS = {f"U{k:02d}": 0.05 + 0.001 * k for k in range(60)}


def test_the_most_doubtful_units_are_always_checked():
    plan = plan_audit(FORECASTS, AuditConfig(doubtful=2, random=4))
    assert plan.doubtful == ("U59", "U58")
    assert len(set(plan.random)) == 4 and not set(plan.random) & set(plan.doubtful)


def test_the_draw_depends_on_the_seed_alone():
    shuffled = dict(sorted(FORECASTS.items(), reverse=True))
    assert plan_audit(FORECASTS, AuditConfig(seed=3)) == plan_audit(shuffled, AuditConfig(seed=3))
    draws = {plan_audit(FORECASTS, AuditConfig(seed=s)).random for s in range(5)}
    assert len(draws) == 5


def test_every_unit_is_equally_likely_to_be_drawn():
    counts = dict.fromkeys(FORECASTS, 0)
    for seed in range(2000):
        for serial in plan_audit(FORECASTS, AuditConfig(doubtful=0, random=6, seed=seed)).random:
            counts[serial] += 1
    # 2000 draws of 6 in 60: mean 200, standard deviation 13.4; five of them either way.
    assert 130 < min(counts.values()) and max(counts.values()) < 270


def test_a_lot_smaller_than_the_plan_is_checked_whole():
    plan = plan_audit({"A": 0.1, "B": 0.2}, AuditConfig(doubtful=3, random=5))
    assert plan.serials == ("B", "A") and plan.population == 0


def test_the_hypergeometric_bound_is_the_last_number_not_contradicted():
    upper = nonconforming_upper(100, 20, 1)
    assert hypergeom.cdf(1, 100, upper, 20) > 0.05 >= hypergeom.cdf(1, 100, upper + 1, 20)


def test_a_full_check_ends_every_suspicion():
    assert (nonconforming_upper(12, 12, 2), nonconforming_upper(0, 0, 0)) == (2, 0)


def test_one_failed_unit_fails_the_lot_and_is_named():
    plan = plan_audit(FORECASTS, AuditConfig())
    measured = dict.fromkeys(plan.serials, 0.1) | {plan.random[0]: 0.5}
    statement = evaluate_audit(plan, FORECASTS, measured, LIMIT)
    assert statement.word == "fail" and statement.failed == (plan.random[0],)


def test_few_checked_units_make_a_conditional_lot_and_many_a_passed_one():
    for count, word in ((3, "conditional"), (30, "pass")):
        plan = plan_audit(FORECASTS, AuditConfig(random=count))
        assert evaluate_audit(plan, FORECASTS, dict.fromkeys(plan.serials, 0.1), LIMIT).word == word


def test_the_bound_holds_in_nineteen_of_twenty_lots(rng):
    holds = []
    for seed in range(400):
        truth = {serial: 0.5 if rng.random() < 0.1 else 0.1 for serial in FORECASTS}
        plan = plan_audit(FORECASTS, AuditConfig(doubtful=0, random=15, seed=seed))
        statement = evaluate_audit(plan, FORECASTS, truth, LIMIT)
        unchecked = set(FORECASTS) - set(plan.serials)
        holds.append(sum(truth[s] > 0.2 for s in unchecked) <= statement.nonconforming_upper)
    assert np.mean(holds) >= 0.93


def test_forecasts_that_are_too_low_show_in_the_ratio():
    plan = plan_audit(FORECASTS, AuditConfig())
    measured = {serial: 2 * FORECASTS[serial] for serial in plan.serials}
    assert evaluate_audit(plan, FORECASTS, measured, LIMIT).error_ratio == pytest.approx(2.0)


def test_an_incomplete_audit_gives_no_statement():
    plan = plan_audit(FORECASTS, AuditConfig())
    with pytest.raises(InputError, match=plan.serials[1]):
        evaluate_audit(plan, FORECASTS, {plan.serials[0]: 0.1}, LIMIT)


def test_a_measurement_that_is_no_number_counts_as_failed():
    plan = plan_audit(FORECASTS, AuditConfig())
    measured = dict.fromkeys(plan.serials, 0.1) | {plan.random[1]: float("nan")}
    assert evaluate_audit(plan, FORECASTS, measured, LIMIT).failed == (plan.random[1],)
