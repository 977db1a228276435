"""Gauge study, control chart, capability and yields against published worked examples and closed forms."""

import numpy as np
import pytest
from scipy import stats

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason
from softcal.core.quality.control_chart import RULES, capability, control_chart
from softcal.core.quality.gauge_study import study_by_anova, study_by_ranges
from softcal.core.quality.yields import Share, UnitRun, yields

# AIAG, Measurement Systems Analysis, 4th edition, chapter III section B: 3 appraisers, 3 trials, 10 parts.
AIAG = """
0.29 -0.56 1.34 0.47 -0.80 0.02 0.59 -0.31 2.26 -1.36
0.41 -0.68 1.17 0.50 -0.92 -0.11 0.75 -0.20 1.99 -1.25
0.64 -0.58 1.27 0.64 -0.84 -0.21 0.66 -0.17 2.01 -1.31
0.08 -0.47 1.19 0.01 -0.56 -0.20 0.47 -0.63 1.80 -1.68
0.25 -1.22 0.94 1.03 -1.20 0.22 0.55 0.08 2.12 -1.62
0.07 -0.68 1.34 0.20 -1.28 0.06 0.83 -0.34 2.19 -1.50
0.04 -1.38 0.88 0.14 -1.46 -0.29 0.02 -0.46 1.77 -1.49
-0.11 -1.13 1.09 0.20 -1.07 -0.67 0.01 -0.56 1.45 -1.77
-0.15 -0.96 0.67 0.11 -1.45 -0.49 0.21 -0.49 1.87 -2.16
"""
MEASURED = np.array(AIAG.split(), dtype=float).reshape(3, 3, 10).transpose(2, 0, 1)


def test_average_and_range_study_matches_the_published_one():
    study = study_by_ranges(MEASURED)
    components = (study.repeatability, study.reproducibility, study.grr, study.parts, study.total)
    # The book goes on from a mean range rounded to 0.3417.
    assert components == pytest.approx((0.20188, 0.22963, 0.30575, 1.10456, 1.14610), abs=5e-5)
    assert study.grr_percent == pytest.approx(26.68, abs=0.01)
    assert (study.categories, study.word) == (5, "conditional")


def test_anova_study_matches_the_published_one():
    study = study_by_anova(MEASURED)
    components = (study.repeatability, study.reproducibility, study.interaction, study.grr, study.parts)
    assert components == pytest.approx((0.199933, 0.226838, 0.0, 0.302373, 1.042327), abs=2e-6)
    assert study.grr_percent == pytest.approx(27.9, abs=0.05)
    assert study.interaction_p == pytest.approx(stats.f.sf(0.434, 18, 60), abs=2e-4)


def test_a_study_recovers_the_variances_it_was_made_from(rng):
    parts, stations, trials = 200, 40, 4
    measured = rng.normal(0, 2.0, (parts, 1, 1)) + rng.normal(0, 0.5, (1, stations, 1))
    measured = measured + rng.normal(0, 0.3, (parts, stations, 1)) + rng.normal(0, 0.2, (parts, stations, trials))
    study = study_by_anova(measured)
    components = (study.parts, study.reproducibility, study.interaction, study.repeatability)
    assert components == pytest.approx((2.0, 0.5, 0.3, 0.2), rel=0.25)


@pytest.mark.parametrize(
    ("study", "measured"),
    [
        (study_by_anova, np.zeros((3, 2, 2))),
        (study_by_anova, np.random.default_rng(0).normal(size=(1, 2, 2))),
        (study_by_anova, np.full((3, 2, 2), np.nan)),
        # Beyond the published tables.
        (study_by_ranges, np.random.default_rng(0).normal(size=(11, 2, 2))),
    ],
)
def test_a_study_that_says_nothing_is_refused(study, measured):
    with pytest.raises(InputError):
        study(measured)


def test_control_limits_match_the_published_ones():
    # NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2: flow rates of ten batches.
    chart = control_chart(np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]))
    assert 1.128 * chart.sigma == pytest.approx(1.8778, abs=5e-5)
    assert (chart.centre, chart.upper, chart.lower) == pytest.approx((50.81, 55.8041, 45.8159), abs=1e-3)
    assert chart.is_stable


PATTERNS = {
    1: [0, 0, 3.5],
    2: [0.5] * 9,
    3: [-0.9, -0.5, -0.1, 0.3, 0.6, 0.9],
    4: [0.4, -0.4] * 7,
    5: [2.5, 0.0, 2.5],
    6: [1.5, 1.5, 0.2, 1.5, 1.5],
    7: [0.5, -0.5, 0.1] * 5,
    8: [1.5, -1.5, 1.6, 1.4, -1.3, 1.5, -1.6, -1.5],
}


@pytest.mark.parametrize("rule", PATTERNS)
def test_each_pattern_is_found_by_its_rule_at_its_last_point(rule):
    text, length, find = RULES[rule - 1]
    z = np.array(PATTERNS[rule], dtype=float)
    is_found = find(np.lib.stride_tricks.sliding_window_view(z, length))
    assert is_found[-1], text
    assert not find(np.lib.stride_tricks.sliding_window_view(np.zeros(length) + 0.01, length)).any() or rule in (2, 7)


def test_chance_alone_breaks_rule_one_as_often_as_the_normal_tail_says(rng):
    chart = control_chart(rng.normal(size=200_000))
    share = sum(signal.rule == 1 for signal in chart.signals) / 200_000
    assert share == pytest.approx(2 * stats.norm.sf(3), rel=0.15)


def test_limits_from_a_baseline_show_a_later_shift(rng):
    values = np.concatenate([rng.normal(size=30), rng.normal(4.0, 1.0, size=5)])
    chart = control_chart(values, baseline=30)
    assert any(signal.index >= 30 for signal in chart.signals) and not chart.is_stable


@pytest.mark.parametrize("at", [0, 12, 24])
def test_one_value_far_out_is_the_only_signal_and_moves_no_limit(rng, at):
    stable = stable_chart(rng)
    chart = control_chart(np.insert(stable.values, at, stable.centre + 40 * stable.sigma))
    assert (chart.centre, chart.sigma) == (pytest.approx(stable.centre), pytest.approx(stable.sigma))
    assert {signal.index for signal in chart.instabilities} == {at}


def test_a_process_that_has_moved_keeps_limits_of_all_its_values(rng):
    values = np.concatenate([rng.normal(size=20), rng.normal(30.0, 1.0, size=20)])
    chart = control_chart(values)
    assert chart.centre == pytest.approx(values.mean()) and not chart.is_stable


def stable_chart(rng):
    return next(c for c in (control_chart(rng.normal(size=30)) for _ in range(50)) if c.is_stable)


def test_capability_matches_its_closed_form(rng):
    # NIST/SEMATECH e-Handbook 6.1.6: limits 8 and 20, mean 16, sigma 2 give Cp 1.0 and Cpk 0.6667.
    chart = stable_chart(rng)
    values = 16 + 2 * (chart.values - chart.centre) / chart.sigma
    indices = capability(control_chart(values), 8.0, 20.0)
    assert (indices.cp, indices.cpk) == pytest.approx((1.0, 0.6667), abs=1e-4)
    assert (indices.pp, indices.ppk) == pytest.approx((2 / values.std(ddof=1), 4 / (3 * values.std(ddof=1))))


def test_the_interval_of_cpk_is_the_one_of_bissell(rng):
    chart = stable_chart(rng)
    maximum = float(chart.values.mean()) + 3 * 1.33 * chart.sigma
    indices = capability(chart, None, maximum)
    half = 1.959964 * np.sqrt(1 / (9 * 30) + 1.33**2 / (2 * 29))
    assert (indices.cp, indices.cpk) == (None, pytest.approx(1.33))
    assert (indices.cpk_lower, indices.cpk_upper) == pytest.approx((1.33 - half, 1.33 + half))


def test_a_limit_below_counts_as_one_above_does(rng):
    chart = stable_chart(rng)
    mean = float(chart.values.mean())
    below, above = (capability(chart, *limits) for limits in ((mean - 2.0, None), (None, mean + 2.0)))
    assert (below.cpk, below.ppk) == pytest.approx((above.cpk, above.ppk))
    assert below.cpk == pytest.approx(2.0 / (3 * chart.sigma))


@pytest.mark.parametrize(
    ("values", "limits", "code"),
    [
        (np.r_[np.sin(np.arange(29.0) ** 2), 40.0], (None, 50.0), "chart.unstable"),
        (np.resize([0.0, 1.0, 0.3], 20), (None, 50.0), "chart.capability.few"),
        (np.resize([0.0, 1.0, 0.3], 30), (2.0, 1.0), "chart.limits_crossed"),
        (np.resize([0.0, 1.0, 0.3], 30), (None, None), "chart.no_limit"),
        (np.arange(5.0), (), "chart.few"),
        (np.array([0, 1, 2, np.nan, 4, 5, 6, 7, 8.0]), (), "chart.not_a_number"),
    ],
)
def test_chart_and_capability_are_refused_where_they_would_promise_too_much(values, limits, code):
    with pytest.raises(InputError) as refused:
        capability(control_chart(values), *limits)
    assert refused.value.reason.code == code
    assert refused.value.reason.values.get("least", 25) == 25 and refused.value.reason.values.get("value", 3) == 3


def test_a_unit_that_waits_for_evidence_counts_in_no_yield():
    good, bad, waits = UnitRun("pass"), UnitRun("fail", (Reason("reversed"),)), UnitRun("conditional")
    new = yields({serial: [waits] for serial in "ABC"})
    assert new.first_pass.value is new.last_pass.value is None
    lot_yields = yields({"A": [waits, good], "B": [waits], "C": [good, bad]})
    assert (lot_yields.first_pass, lot_yields.last_pass) == (Share(2, 2), Share(1, 2))
    # Who asks for conditional units too counts them.
    assert yields({"A": [waits], "B": [bad]}, good=("pass", "conditional")).last_pass == Share(1, 2)


def test_yields_count_each_unit_once_and_leave_golden_units_out():
    short = reason("too_little_data", windows=3, presses=1, enough_windows=500, enough_presses=3)
    good, bad, again = UnitRun("pass"), UnitRun("fail", (Reason("reversed"),)), UnitRun("retest", (short,))
    lot_yields = yields({"A": [good], "B": [bad, good], "C": [again, bad], "D": [], "G": [bad]}, golden={"G"})
    assert (lot_yields.first_pass.count, lot_yields.second_pass.count, lot_yields.last_pass.count) == (1, 2, 2)
    assert lot_yields.first_pass.of == 3 and (lot_yields.runs.count, lot_yields.runs.of) == (2, 5)
    assert lot_yields.reasons == ((Reason("reversed"), 1),)


def test_reasons_are_counted_by_their_kind_whatever_their_numbers():
    runs = {f"U{k}": [UnitRun("conditional", (reason("drift", moved=0.1 * k, unit="N"),))] for k in range(3)}
    ((newest, count),) = yields(runs).reasons
    assert (newest.code, count) == ("drift", 3)


def test_the_interval_of_a_share_is_wilson_s():
    # (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n), Wilson 1927
    z, p, n = 1.959964, 0.9, 20
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    expected = [(p + z**2 / (2 * n) + sign * half) / (1 + z**2 / n) for sign in (-1, 1)]
    assert Share(18, 20).interval == pytest.approx(tuple(expected), rel=1e-6)
    assert Share(0, 0).value is None
