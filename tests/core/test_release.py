"""Bounds over units, acceptance sampling and release: against closed forms, other implementations and drawn lots."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy.stats import binom, norm

from softcal.core.errors import InputError
from softcal.core.quality.acceptance import (
    audits_by_count,
    criterion_rows,
    failing_share,
    min_risk,
    min_units,
    pooled_scale,
    share_beyond,
    tolerance_factor,
)
from softcal.core.quality.interval_inflation import AuditedSamples, IntervalInflation, fit_interval_inflation
from softcal.core.quality.lot_release import release_lot
from softcal.core.quality.qualification import PastAudit, qualify, small_lot
from softcal.core.quality.release import AuditedUnit, audited_ratios, min_passing, release
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import Limit

LIMIT = Limit("N", 1.0)
METHOD = Method()
RULES = METHOD.release
NOW = datetime(2026, 5, 1, tzinfo=UTC)


def upper_bound(scores, risk):
    """Return the conformal bound: the score of one more unit exceeds it with this probability at most."""
    rank = int(np.ceil((1 - risk) * (len(scores) + 1) - 1e-9))
    return np.inf if rank > len(scores) else np.sort(scores)[rank - 1]


def test_too_few_units_bound_nothing():
    assert share_beyond(8, 0.1, 0.9) == 1.0 > share_beyond(9, 0.1, 0.9)
    assert min_units(0.1) == 9 and min_units(0.05) == 19 and min_risk(9) == pytest.approx(0.1)


@pytest.mark.parametrize(("count", "risk"), [(10, 0.1), (22, 0.05), (40, 0.1)])
def test_the_share_beyond_the_bound_is_kept_with_the_stated_confidence(count, risk):
    rng = np.random.default_rng(0)
    share = share_beyond(count, risk, 0.9)
    true_shares = [1 - norm.cdf(upper_bound(rng.normal(size=count), risk)) for _ in range(4000)]
    assert np.mean(np.array(true_shares) <= share) == pytest.approx(0.9, abs=0.02)


def test_more_audits_never_promise_less():
    shares = [share_beyond(count, 1 / (count + 1), 0.9) for count in range(2, 60)]
    assert np.all(np.diff(shares) < 0)
    factors = [tolerance_factor(count, count - 1, 0.1, 0.9) for count in range(2, 60)]
    assert np.all(np.diff(factors) < 0)


def test_every_unit_weighs_the_same_in_the_pooled_scale():
    few, many = np.array([1.0, 2.0]), np.linspace(0, 0.5, 100_000)
    assert pooled_scale([few, many], 0.7) == 1.0
    assert pooled_scale([few, many], 0.8) == 2.0


def test_hierarchical_scale_covers_one_more_unit_whatever_the_spread_between_units():
    rng, covered, pooled = np.random.default_rng(4), [], []
    for _ in range(600):
        sizes = np.exp(rng.normal(0, 1.5, 16))
        groups = [np.abs(size * rng.normal(size=60)) for size in sizes]
        covered.append(np.mean(groups[-1] <= pooled_scale(groups[:-1], 0.9, has_new_unit=True)))
        pooled.append(np.mean(groups[-1] <= pooled_scale(groups[:-1], 0.9)))
    assert np.mean(covered) >= 0.9 - 5 * np.std(covered) / np.sqrt(600)
    assert np.mean(pooled) < np.mean(covered)


def test_hierarchical_scale_of_too_few_units_is_infinite():
    assert pooled_scale([np.ones(5)] * 8, 0.9, has_new_unit=True) == np.inf
    assert pooled_scale([np.ones(5)] * 9, 0.9, has_new_unit=True) == 1.0
    with pytest.raises(InputError):
        pooled_scale([], 0.9)


def test_counting_needs_the_classical_numbers_of_audits():
    assert audits_by_count(0.1, 0.9) == 22
    assert audits_by_count(0.05, 0.95) == 59
    assert audits_by_count(0.1, 0.9, failed=1) == 38
    assert binom.cdf(1, 38, 0.1) <= 0.1 < binom.cdf(1, 37, 0.1)


def test_a_process_of_which_all_failed_is_known_to_fail():
    assert failing_share(3, 3, 0.9) == 1.0


def test_the_tolerance_factor_is_that_of_the_standards_tables():
    # ISO 16269-6, one-sided, unknown SD, p = 0.90, confidence 0.90; n = 5, 10, 20 (also Odeh and Owen 1980, table 1).
    for count, factor in ((5, 2.742), (10, 2.066), (20, 1.765)):
        assert tolerance_factor(count, count - 1, 0.1, 0.9) == pytest.approx(factor, abs=2e-3)


def _lot(rng, count, centre, spread, forecast_spread=0.3):
    forecast = 0.3 * np.exp(forecast_spread * rng.normal(size=count))
    return forecast, forecast * np.exp(centre + spread * rng.normal(size=count))


@pytest.mark.parametrize("centre", [0.4, 0.8, 1.1, 1.5])
@pytest.mark.parametrize("depends", [False, True])
def test_few_lots_release_more_bad_units_than_promised(centre, depends):
    """Confidence 0.9: of lots at any centre, at most one in ten releases a larger share of bad units than promised."""
    rng, broken, bad, released = np.random.default_rng(int(10 * centre)), 0, 0, 0
    for _ in range(200):
        forecast, truth = _lot(rng, 210, centre, 0.35)
        if depends:  # a forecast that says nothing: the smallest ones are the most optimistic
            truth = 0.3 * np.exp(centre + 0.35 * rng.normal(size=210))
        audits = [AuditedUnit(f"A{k}", forecast[k], truth[k]) for k in range(10)]
        rest = {f"U{k}": float(forecast[k]) for k in range(10, 210)}
        decision = release(rest, audits, LIMIT, RULES)
        beyond = sum(truth[int(serial[1:])] > 1.0 for serial in decision.released)
        bad, released = bad + beyond, released + len(decision.released)
        broken += beyond > 0.1 * len(decision.released)
    assert broken <= 0.1 * 200 + 5 * np.sqrt(0.09 * 200)
    assert bad <= 0.1 * max(released, 1)


def test_a_good_lot_is_released():
    rng, shares = np.random.default_rng(1), []
    for _ in range(200):
        forecast, truth = _lot(rng, 40, 0.0, 0.2, 0.2)
        audits = [AuditedUnit(f"A{k}", forecast[k], truth[k]) for k in range(10)]
        decision = release({f"U{k}": float(forecast[k]) for k in range(10, 40)}, audits, LIMIT, RULES)
        shares.append(len(decision.released) / 30)
    assert np.mean(shares) >= 0.85


def test_release_of_few_of_many_takes_more_than_release_of_all():
    audits = [
        AuditedUnit(f"A{k}", 0.3, 0.3 * np.exp(0.2 * v)) for k, v in enumerate(norm.ppf(np.linspace(0.05, 0.95, 10)))
    ]
    alone = release({"U": 0.5}, audits, LIMIT, RULES)
    among = release({"U": 0.5, "V": 0.4, "W": 5.0}, audits, LIMIT, RULES)
    assert alone.released == ("U",) and among.released == ("V", "U") and among.factor > alone.factor
    assert among.risk_any_form > alone.risk_any_form


def test_the_few_best_of_a_poor_lot_are_not_released():
    audits = [AuditedUnit(f"A{k}", 0.3, 0.3) for k in range(10)]
    assert release({"U": 0.01, "V": 5.0, "W": 5.0}, audits, LIMIT, RULES).released == ()


def test_no_audit_releases_nothing():
    assert release({"U": 0.01}, [], LIMIT, RULES).released == ()
    assert release({"U": 0.01}, [AuditedUnit("A", 0.1, 0.1)], LIMIT, RULES).released == ()


def test_a_unit_audited_twice_is_refused():
    with pytest.raises(InputError, match="A1"):
        audited_ratios([AuditedUnit("A1", 0.1, 0.1), AuditedUnit("A1", 0.1, 0.2)], RULES)
    with pytest.raises(InputError):
        AuditedUnit("A1", 0.1, float("nan"))


def test_lots_that_differ_bound_a_new_lot_wider_than_their_units_do():
    rng = np.random.default_rng(3)
    shifts = (-0.6, 0.0, 0.6, 0.1)
    lots = [
        [AuditedUnit(f"A{k}", 1.0, float(np.exp(s + 0.1 * rng.normal())), f"lot {j}") for k in range(8)]
        for j, s in enumerate(shifts)
    ]
    together = audited_ratios([unit for lot in lots for unit in lot], RULES)
    assert together.spread > 3 * audited_ratios(lots[0], RULES).spread
    assert together.degrees < 5
    assert audited_ratios(lots[0] + lots[1], RULES).bound(RULES) == np.inf


def test_audits_of_earlier_lots_keep_the_promise_for_a_new_lot():
    rng, beyond, trials = np.random.default_rng(8), 0, 600
    for _ in range(trials):
        units = [
            AuditedUnit(f"{j}-{k}", 1.0, float(np.exp(c + 0.2 * rng.normal())), f"{j}")
            for j, c in enumerate(0.3 * rng.normal(size=5))
            for k in range(6)
        ]
        share = 1 - norm.cdf(np.log(audited_ratios(units, RULES).bound(RULES)) / np.hypot(0.3, 0.2))
        beyond += share > 0.1
    assert beyond / trials <= 0.1 + 5 * np.sqrt(0.09 / trials)


def _past(lots=4, each=5, days=10, model="EG", method=METHOD.id, failed=False):
    return [
        PastAudit(
            AuditedUnit(f"P{k}", 0.1, 0.1 + 0.001 * k, f"lot {j}"), model, method, NOW - timedelta(days=days), failed
        )
        for j in range(lots)
        for k in range(each)
    ]


def _here(count):
    return [AuditedUnit(f"A{k}", 0.1, 0.1) for k in range(count)]


def test_enough_audits_of_the_lot_qualify_it():
    assert qualify(_here(9), [], NOW, "", METHOD).source == "this lot"
    qualification = qualify(_here(6), [], NOW, "EG", METHOD)
    assert not qualification.is_given and qualification.required == qualification.reason.values["missing"] == 3


def test_audits_of_earlier_lots_qualify_the_same_product_and_method():
    qualification = qualify([], _past(), NOW, "EG", METHOD)
    assert qualification.source == "earlier lots" and len(qualification.audits) == 20


@pytest.mark.parametrize(
    ("past", "model", "method", "code"),
    [
        (_past(), "other", METHOD, "other_method"),
        (_past(), "EG", replace(METHOD, range_margin=0.07), "other_method"),
        (_past(), "", METHOD, "no_model"),
        (_past(days=400), "EG", METHOD, "old_audits"),
        (_past(lots=2, each=9), "EG", METHOD, "few_lots"),
        (_past() + _past(lots=1, each=1, days=5, failed=True), "EG", METHOD, "withdrawn"),
    ],
)
def test_what_does_not_count_is_named(past, model, method, code):
    qualification = qualify(_here(2), past, NOW, model, method)
    why = qualification.reason.values["why"]
    assert (
        not qualification.is_given
        and why.code == f"part.{code}"
        and qualification.reason.values["missing"] == qualification.required == 7
    )
    assert why.values.get("days", 365) == 365


def test_a_failed_golden_unit_withdraws_what_was_audited_before_it():
    assert not qualify([], _past(days=10), NOW, "EG", METHOD, golden_failed_at=NOW - timedelta(days=3)).is_given
    assert qualify([], _past(days=2), NOW, "EG", METHOD, golden_failed_at=NOW - timedelta(days=3)).is_given


def test_audits_made_after_a_failure_qualify_again():
    past = _past(days=30, failed=True) + _past(days=5)
    assert qualify([], past, NOW, "EG", METHOD).is_given


def _audited(residual, half=1.0):
    return AuditedSamples(np.abs(residual), np.full(len(residual), half))


def test_the_interval_serves_one_more_unit_however_differently_units_were_pressed():
    rng, served, pooled_served, trials = np.random.default_rng(5), 0, 0, 200
    for _ in range(trials):
        # Each unit misreads its loads by another share; residuals grow with the load.
        loads = (0.3 * rng.normal() * rng.random(200) + 0.02 * rng.normal(size=200) for _ in range(11))
        units = [_audited(residual, half=0.02) for residual in loads]
        inflation = fit_interval_inflation(units[:-1], 0.9, RULES)
        served += np.mean(units[-1].ratio(inflation) <= 1) >= 0.8
        pooled = pooled_scale([unit.ratio(IntervalInflation()) for unit in units[:-1]], 0.9)
        pooled_served += np.mean(units[-1].ratio(IntervalInflation()) <= pooled) >= 0.8
    # Nine units in ten, less three standard deviations for the count of trials.
    assert served / trials >= 0.9 - 3 * np.sqrt(0.09 / trials)
    assert pooled_served < served


def test_the_interval_inflation_follows_its_closed_form():
    half = np.array([3.0, 4.0])
    assert np.allclose(IntervalInflation(1.0, 4.0)(half), [5.0, np.hypot(4, 4)])
    assert np.array_equal(IntervalInflation()(half), half)


def test_units_that_are_alike_get_the_factor_of_their_median_and_nothing_beside_it():
    rng = np.random.default_rng(6)
    units = [_audited(0.5 * rng.normal(size=4000), half=1.645) for _ in range(10)]
    inflation = fit_interval_inflation(units, 0.9, RULES)
    # 0.5 x 1.645 is the true 90 % half-width.
    assert inflation.scale == pytest.approx(0.5, rel=0.05) and inflation.added < 0.2
    covered = [np.mean(unit.ratio(inflation) <= 1) for unit in units]
    assert 0.87 < np.median(covered) < 0.94


def test_an_interval_that_is_too_narrow_gets_an_error_beside_it():
    units = [_audited(np.random.default_rng(k).normal(size=500), half=0.1) for k in range(10)]
    inflation = fit_interval_inflation(units, 0.9, RULES)
    assert inflation.scale == 1.0 and inflation.added == pytest.approx(1.645, rel=0.15)


def test_one_audited_unit_widens_and_none_is_refused():
    assert fit_interval_inflation([_audited(np.full(50, 2.0))], 0.9, RULES).added == pytest.approx(
        np.sqrt(3.0), rel=0.01
    )
    with pytest.raises(InputError):
        fit_interval_inflation([], 0.9, RULES)


def test_the_few_good_units_of_a_poor_lot_are_not_released():
    audits = [AuditedUnit(f"A{k}", 0.3, 0.3 * (1 + 0.01 * k)) for k in range(10)]
    forecasts = {"U1": 0.3, "U2": 0.31}
    assert release(forecasts, audits, LIMIT, RULES).released == ("U1", "U2")
    # 10 audits held and 2 would pass: half of 24 units, but not of 26.
    assert release(forecasts, audits, LIMIT, RULES, min_count=min_passing(24, 10, RULES)).released == ("U1", "U2")
    assert release(forecasts, audits, LIMIT, RULES, min_count=min_passing(26, 10, RULES)).released == ()


@pytest.mark.parametrize(("units", "audited", "remaining"), [(1, 0, 1), (9, 2, 7), (5, 5, 0)])
def test_a_lot_with_no_unit_left_after_the_audits_is_advised_to_measure_all_of_it(units, audited, remaining):
    qualification = qualify(_here(audited), [], NOW, "EG", METHOD, units=units)
    assert not qualification.is_given and qualification.required == remaining
    assert qualification.reason.code == "part.unqualified_small"
    assert qualification.reason.values["small"].values == {"units": units, "wanted": 9, "least": 3}


def test_a_lot_with_a_unit_to_spare_is_advised_how_many_to_audit():
    assert qualify(_here(1), [], NOW, "EG", METHOD, units=10).reason.values["missing"] == 8


def test_a_small_lot_is_shown_no_promise_it_cannot_have():
    assert small_lot(9, RULES) is not None and small_lot(10, RULES) is None
    assert [row[0] for row in criterion_rows(RULES, 10)] == ["3 audits", "5 audits", "9 audits"]
    assert len(criterion_rows(RULES)) > len(criterion_rows(RULES, 10))


def test_a_lot_whose_every_unit_was_measured_has_nothing_left_to_promise():
    audits = [AuditedUnit("A", 0.1, 0.2), AuditedUnit("B", 0.1, 2.0)]
    decided = release_lot({}, qualify(audits, [], NOW, "EG", METHOD, units=2), LIMIT, RULES)
    values = decided.statement.values["seen"].values
    assert decided.statement.code == "release.none_left"
    assert (values["audits"].values, values["beyond"], values["limit"], values["unit"]) == ({"audits": 2}, 1, 1.0, "N")


def test_a_forecast_is_multiplied_by_what_audits_measured_of_theirs_and_by_nothing_without_them():
    audits = [AuditedUnit(f"A{k}", 0.2, 0.3) for k in range(12)]
    forecasts = {"light": 0.3, "heavy": 0.75}
    decided = release_lot(forecasts, qualify(audits, [], NOW, "EG", METHOD, units=14), LIMIT, RULES)
    assert decided.forecast_scale == pytest.approx(1.5)
    releases = {serial: decided.sample_release(serial, 1) for serial in forecasts}
    assert [releases[serial].assess(rmse, LIMIT).verdict for serial, rmse in forecasts.items()] == [
        "pass",
        "fail",
    ]
    blind = release_lot(forecasts, qualify([], [], NOW, "EG", METHOD, units=14), LIMIT, RULES)
    assert blind.forecast_scale == 1.0
    assert all(blind.sample_release(serial, 1) is None for serial in forecasts)


def _sample(sittings: dict[str, int], spread: float, seed: int = 0) -> list[AuditedUnit]:
    """Audited units by sitting: units of one differ little, sittings by their common error."""
    rng, audits = np.random.default_rng(seed), []
    for sitting, count in sittings.items():
        common = np.exp(spread * rng.normal())
        for _ in range(count):
            ratio = common * np.exp(0.05 * rng.normal())
            audits.append(AuditedUnit(f"A{len(audits)}", 0.2, 0.2 * ratio, "lot", sitting))
    return audits


def _decided(audits: list[AuditedUnit], sittings: dict[str, str]):
    qualified = qualify(audits, [], NOW, "", METHOD)
    forecasts = dict.fromkeys(sittings, 0.2)
    return release_lot(forecasts, qualified, LIMIT, RULES, sittings=sittings)


def test_audits_of_one_sitting_speak_for_its_units_alone():
    here, there = {f"U{k}": "one" for k in range(8)}, {"V1": "other", "V2": ""}
    decided = _decided(_sample({"one": 10}, 0.5), here | there)
    assert set(decided.released) == set(here) and decided.sampled.sitting == "one"
    assert "audits: 10, units of other sittings: 2" in str(decided.statement)
    # A unit of another sitting has no word from them, and a unit that is to come belongs to none yet.
    assert decided.sample_release("V1", 1) is None and decided.next_unit(1).sitting == "one"


def test_sittings_are_counted_where_they_are_what_varies():
    sittings = {f"U{k}": "third" for k in range(8)}
    few = _decided(_sample({"one": 6, "two": 6}, 0.1), sittings)
    assert not few.released and "sittings: 2, needed: 3" in str(few.statement)
    many = _decided(_sample({f"s{k}": 3 for k in range(8)}, 0.1), sittings)
    assert set(many.released) == set(sittings) and many.decision.ratios.lots == 8


def test_the_promise_holds_for_a_sitting_that_nobody_audited():
    # 24 audited units of six sittings; counted as units alone they would promise what sittings do not keep.
    beyond, bounds = [], 0
    for seed in range(200):
        audits = _sample({f"s{k}": 4 for k in range(6)}, 0.4, seed)
        decided = _decided(audits, {f"U{k}": "new" for k in range(8)})
        bounds += bool(decided.released)
        true = 0.2 * np.exp(0.4 * np.random.default_rng(1000 + seed).normal())
        beyond.append(bool(decided.released) and true > LIMIT.maximum_rmse)
    assert bounds > 20 and np.mean(beyond) <= 0.1


def test_units_that_share_their_error_with_none_are_released_as_before():
    audits, sittings = _sample({"": 12}, 0.0), {f"U{k}": "" for k in range(8)}
    decided = _decided(audits, sittings)
    assert decided.sampled.reason is None and decided.decision == release(
        dict.fromkeys(sittings, 0.2), qualify(audits, [], NOW, "", METHOD).audits, LIMIT, RULES
    )


def test_a_promise_on_some_units_counts_those_that_may_not_be_released():
    rng = np.random.default_rng(3)
    audits = [AuditedUnit(f"A{k}", 0.1, 0.1 * np.exp(0.1 * rng.normal())) for k in range(12)]
    forecasts = {f"U{k}": 0.1 for k in range(8)}
    some, all_of_them = ("U1", "U2", "U3", "U5"), release(forecasts, audits, LIMIT, RULES)
    result = release(forecasts, audits, LIMIT, RULES, candidates=some)
    assert result.released == some and len(all_of_them.released) == 8
    # Half of the units share the risk of all: the bound is that of half the risk.
    assert result.factor == audited_ratios(audits, RULES).bound(RULES, RULES.risk / 2) > all_of_them.factor
    assert release(forecasts, audits, LIMIT, RULES, candidates=some[:3]).released == (), "less than half of the lot"
