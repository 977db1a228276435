"""Fit, penalty, evidence and probabilities on a linear model, against linear algebra; an oscillator, against SciPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from softcal.core.gap.case import Case
from softcal.core.gap.evidence import competing_hypotheses, confused_pairs, estimates_of, hidden_fraction, probabilities
from softcal.core.gap.fit import Tangent, Yardstick, exact_log_evidence, fit, log_evidences, misfit, penalty
from softcal.core.gap.hypothesis import Hypothesis, Probe
from softcal.core.gap.method import METHOD
from softcal.core.gap.model import Fit, Problem
from softcal.core.gap.search import find_hidden_probes, fit_jointly, screen
from softcal.core.gap.simulator import Simulator, candidate, recorded
from softcal.core.gap.simulator_model import SimulatorModel
from softcal.core.twin.effects import Parameter
from tests.core.linear_mechanism import (
    BEND,
    CAUSES,
    KINK,
    LEVEL,
    LINE,
    RIPPLE,
    SIGMA,
    SLOPE,
    design,
    fits_of,
    fitted,
    left_of,
    measured,
    one_sided,
    problem_of,
    runs_of,
    size,
    solved,
)

RUNS = runs_of({"bend.size": 0.3})
PROBLEM = problem_of(RUNS)
Y = measured(RUNS)
N = len(Y)
EVIDENCE, COMPETING = METHOD.evidence, METHOD.competing


@pytest.mark.parametrize("effects", [(), (BEND,), (RIPPLE, BEND)], ids=["base", "bend", "ripple and bend"])
def test_a_fit_of_a_line_is_linear_least_squares(effects):
    fit = fitted(PROBLEM, *effects)
    columns = design(RUNS, *(e.id for e in effects))
    np.testing.assert_allclose(fit.coordinates, solved(columns, Y), atol=1e-6)
    np.testing.assert_allclose(fit.predicted, columns @ fit.coordinates, atol=1e-9)
    np.testing.assert_allclose(fit.residual, (Y - fit.predicted) / SIGMA, atol=1e-9)
    np.testing.assert_allclose(fit.jacobian, columns.T / SIGMA, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(fit.covariance, SIGMA**2 * np.linalg.inv(columns.T @ columns), rtol=1e-5, atol=1e-12)
    assert fit.chi2 == pytest.approx(np.sum(left_of(columns, Y) ** 2) / SIGMA**2, rel=1e-7)
    assert fit.ids == tuple(sorted(e.id for e in effects))
    base, values = fit.hypothesis.split(fit.coordinates)
    np.testing.assert_allclose([*base, *(v for row in values for v in row)], fit.coordinates)


def test_a_fit_sees_only_the_samples_that_are_open_to_it():
    is_open = np.random.default_rng(5).random(N) < 0.6
    fit = fitted(PROBLEM.seeing(is_open.astype(float)), BEND)
    columns = design(RUNS, "bend")
    np.testing.assert_allclose(fit.coordinates, solved(columns[is_open], Y[is_open]), atol=1e-6)
    assert fit.problem.count == is_open.sum()
    assert fit.chi2 == pytest.approx(np.sum(left_of(columns[is_open], Y[is_open]) ** 2) / SIGMA**2, rel=1e-6)
    assert len(fit.predicted) == N


@pytest.mark.parametrize(("low", "high"), [(-50.0, 1.2), (2.7, 50.0)])
def test_a_fit_within_bounds_is_bounded_least_squares(low, high):
    bounded = replace(LINE, base=(LEVEL, replace(SLOPE, low=low, high=high, usual=0.5 * (low + high))))
    problem = problem_of(RUNS, simulator=bounded)
    fit = fitted(problem, BEND)
    limits = ([-50.0, low, -50.0], [50.0, high, 50.0])
    expected = lsq_linear(design(RUNS, "bend"), Y, limits, tol=1e-12)
    np.testing.assert_allclose(fit.coordinates, expected.x, atol=1e-3)
    assert fit.chi2 == pytest.approx(2.0 * expected.cost / SIGMA**2, abs=0.02)


def test_a_fixed_parameter_stays_where_it_is_and_has_no_uncertainty():
    fixed = replace(LINE, base=(LEVEL, replace(SLOPE, is_fixed=True)))
    fit = fitted(problem_of(RUNS, simulator=fixed), BEND)
    residual = Y + 0.4 * design(RUNS)[:, 1]
    np.testing.assert_allclose(fit.coordinates[[0, 2]], solved(design(RUNS, "bend")[:, [0, 2]], residual), atol=1e-6)
    assert fit.coordinates[1] == -0.4
    assert fit.covariance[1, 1] == 0.0


def test_two_parameters_that_are_one_share_their_sum():
    twice = replace(LINE, run=lambda i, p: LINE.run(i, {**p, "level": p["level"] + p["bend.size"], "bend.size": 0.0}))
    fit = fitted(problem_of(RUNS, simulator=twice), BEND)
    assert fit.coordinates[0] + fit.coordinates[2] == pytest.approx(solved(design(RUNS), Y)[0], abs=1e-6)
    assert np.all(np.isfinite(fit.covariance))
    np.testing.assert_allclose(fit.covariance[0, 2], fit.covariance[0, 0], rtol=1e-6)


def test_the_same_parameters_are_scored_under_another_noise():
    fit = fitted(PROBLEM)
    louder = fit.under(PROBLEM.with_noise({"y": 3.0 * SIGMA}))
    assert louder.chi2 == pytest.approx(fit.chi2 / 9.0)
    assert louder.coordinates is fit.coordinates


def test_a_simulator_that_fails_at_the_start_leaves_an_infinite_chi2():
    def broken(inputs, p):
        if p["level"] < 0.5:
            raise ValueError("below the ground")
        return LINE.run(inputs, p)

    problem = problem_of(RUNS, simulator=replace(LINE, run=broken))
    fit = fitted(problem)
    assert fit.chi2 == np.inf
    assert (problem.model.calls(problem.case).count, problem.model.calls(problem.case).of) == (1, 1)
    assert "below the ground" in problem.model.calls(problem.case).first


def test_a_derivative_is_taken_from_the_side_that_does_not_fail():
    def broken(inputs, p):
        return {"y": np.full(len(inputs["x"]), np.nan)} if p["level"] > 1.0 else LINE.run(inputs, p)

    result = fit(
        problem_of(RUNS, simulator=replace(LINE, run=broken)), Hypothesis(of_all=LINE.base), np.array([1.0, 2.0]), 0
    )
    np.testing.assert_allclose(result.slopes, design(RUNS).T, atol=1e-6)


T_s = 0.05 * np.arange(200)


def swing(inputs, p):
    t_s = inputs["t_s"]
    return {"y": inputs["push"] * np.exp(-p["damping"] * t_s) * np.cos(2.0 * np.pi * p["pitch_Hz"] * t_s)}


SWING = Simulator(
    "swing", swing, ("push",), ("y",),
    (Parameter("damping", "1/s", 0.01, 5.0, 0.4, scale="log"), Parameter("pitch_Hz", "Hz", 0.1, 3.0, 0.7)),
    (candidate("late", "clock", Parameter("by", "s", -0.1, 0.1, 0.01, neutral=0.0)),),
)  # fmt: skip


def test_a_damped_oscillator_ends_where_scipy_does():
    rng = np.random.default_rng(3)
    columns = {"t_s": T_s, "push": np.full(len(T_s), 1.5)}
    y = swing(columns, {"damping": 0.33, "pitch_Hz": 0.62})["y"] + rng.normal(0.0, 0.02, len(T_s))
    run = recorded(SWING, "1", columns | {"y": y})
    problem = Problem(SimulatorModel(SWING), Case("S1", (run,)), {"y": 0.02})
    result = fit(problem, Hypothesis(of_all=SWING.base), np.array([np.log(0.5), 0.6]))

    def error(x):
        return (y - swing(columns, {"damping": x[0], "pitch_Hz": x[1]})["y"]) / 0.02

    expected = least_squares(error, (0.5, 0.6), xtol=1e-12)
    np.testing.assert_allclose([np.exp(result.coordinates[0]), result.coordinates[1]], expected.x, rtol=1e-3)
    assert result.chi2 == pytest.approx(2.0 * expected.cost, abs=0.03)
    assert result.chi2 >= 2.0 * expected.cost - 1e-6
    # The error of a logarithm is the relative error.
    covariance = np.linalg.inv(expected.jac.T @ expected.jac)
    assert result.covariance[0, 0] == pytest.approx(covariance[0, 0] / expected.x[0] ** 2, rel=0.01)
    assert result.covariance[1, 1] == pytest.approx(covariance[1, 1], rel=0.01)


# What it costs, and how probable it is.


def test_the_penalty_is_that_of_schwarz_with_the_odds_of_causes():
    half = replace(RIPPLE, parameters=(replace(RIPPLE.parameters[0], weight=0.5),))
    for effects, count in (((), 2.0), ((BEND,), 3.0), ((BEND, half), 3.5)):
        fit = fitted(PROBLEM, *effects)
        expected = count * np.log(N) - 2.0 * len(effects) * np.log(EVIDENCE.prior_odds)
        assert fit.penalty == pytest.approx(expected)
        assert fit.bic == pytest.approx(fit.chi2 + expected)
        assert exact_log_evidence(fit) == pytest.approx(-0.5 * (fit.chi2 + penalty(fit)))


def test_a_size_pays_what_its_data_tell_of_it():
    """Schwarz's ln n is replaced by −2·ln of posterior over prior width, by Laplace, never below 0 nor above ln n."""
    for sigma in (SIGMA, 10.0 * SIGMA, 1e-3 * SIGMA):
        fit = fitted(problem_of(RUNS, sigma), BEND)
        variance = sigma**2 * np.linalg.inv(design(RUNS, "bend").T @ design(RUNS, "bend"))[2, 2]
        width = EVIDENCE.usual_range * 0.2 / np.sqrt(2.0 * np.pi * variance)
        pays = min(np.log(N), 2.0 * np.log(max(width, 1.0)))
        # A size beyond the usual ones pays −2·ln of Cauchy's density, relative to that of none.
        unusual = 2.0 * np.log(1.0 + (fit.effect_values[0][0] / (EVIDENCE.usual_range * 0.2)) ** 2)
        expected = 2.0 * np.log(N) - 2.0 * np.log(EVIDENCE.prior_odds) + pays + unusual
        assert penalty(fit) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("low", "high", "bounds"), [(-50.0, 0.1, 1), (0.5, 50.0, 1), (-50.0, 50.0, 0), (0.0, 50.0, 0)])
def test_a_size_on_its_bound_pays_for_it(low, high, bounds):
    cause = candidate("bend", "shape", size(0.2, low, high))
    fit = fitted(PROBLEM, cause)
    spared = np.log(N) - 2.0 * np.log(max(EVIDENCE.usual_range * 0.2 / np.sqrt(2 * np.pi * fit.covariance[2, 2]), 1.0))
    unusual = 2.0 * np.log(1.0 + (fit.effect_values[0][0] / (EVIDENCE.usual_range * 0.2)) ** 2)
    paid = penalty(fit) - fit.penalty + max(spared, 0.0) - unusual
    assert paid == pytest.approx(bounds * EVIDENCE.bound_cost, abs=1e-6)


def by_hand(fits: dict) -> dict:
    min_chi2, max_chi2 = min(f.chi2 for f in fits.values()), max(f.chi2 for f in fits.values())
    tolerance = EVIDENCE.exactness * (max_chi2 - min_chi2)
    out = {}
    for ids, fit_of_set in fits.items():
        excess = fit_of_set.chi2 - min_chi2 + tolerance
        modes = EVIDENCE.modes
        cost = excess if excess < modes else modes * (1.0 + np.log(excess / modes))
        out[ids] = -0.5 * (cost + penalty(fit_of_set))
    return out


def test_probabilities_are_those_of_all_sets_by_bayes():
    fits = fits_of(PROBLEM, (BEND,), (RIPPLE,), (KINK,), (BEND, RIPPLE), (BEND, KINK))
    logs = log_evidences(fits)
    expected = by_hand(fits)
    assert logs == pytest.approx(expected)
    weights = {ids: np.exp(v - max(expected.values())) for ids, v in expected.items()}
    total = sum(weights.values())
    chances = probabilities(logs, ["bend", "ripple", "kink", "rust"])
    for name in ("bend", "ripple", "kink"):
        assert chances[name] == pytest.approx(sum(w for ids, w in weights.items() if name in ids) / total)
    assert chances["rust"] == 0.0
    assert chances["bend"] > 0.9 > 0.1 > chances["ripple"]


def test_structure_that_even_the_closest_leaves_raises_the_floor():
    smooth = 0.4 * np.sin(np.arange(N) / 25.0)
    runs = [
        replace(
            r, columns={**r.columns, "y": r.columns["y"] + smooth[:60].mean() + 0.3 * np.sin(np.arange(len(r)) / 9)}
        )
        for r in RUNS
    ]
    fits = fits_of(problem_of(runs), (BEND,))
    yardstick = Yardstick.from_fits(fits.values())
    closest = fits["bend",]
    sums = np.concatenate([
        closest.residual[b.rows][: len(closest.residual[b.rows]) // 8 * 8].reshape(-1, 8).sum(axis=1) / np.sqrt(8)
        for b in closest.problem.blocks
    ])  # fmt: skip
    assert yardstick.chi2 == closest.chi2
    assert yardstick.noise_floor == pytest.approx((np.mean(sums**2) - 1.0) / 8 * N)
    assert yardstick.log_evidence(closest) == pytest.approx(
        -0.5 * (misfit(yardstick.noise_floor, EVIDENCE.modes) + penalty(closest))
    )


def test_the_hidden_fraction_is_what_a_regression_on_the_base_takes():
    fit = fitted(PROBLEM, BEND, RIPPLE)
    for name in ("bend", "ripple"):
        shape = design(RUNS, name)[:, 2]
        residual = left_of(design(RUNS), shape)
        assert hidden_fraction(fit, name) == pytest.approx(1.0 - residual @ residual / (shape @ shape), rel=1e-5)


def test_what_is_off_is_wholly_hidden():
    at_zero = replace(fitted(PROBLEM, BEND), coordinates=np.array([1.0, 2.0, 0.0]))
    at_zero = replace(at_zero, predicted=PROBLEM.predict(at_zero.hypothesis, at_zero.coordinates))
    assert hidden_fraction(at_zero, "bend") == 1.0


# Which hypotheses stay in play.


def weighed(*rows: tuple[tuple[str, ...], float]) -> tuple[dict, dict]:
    """Fits of sets of causes, all of white residuals, and log evidences that are given."""
    of = {e.id: e for e in CAUSES}
    fits = {ids: fitted(PROBLEM, *(of[i] for i in ids)) for ids, _ in rows}
    return fits, dict(rows)


def test_competing_hypotheses_are_other_causes_within_the_odds():
    fits, logs = weighed(
        (("bend",), 0.0), (("ripple",), -COMPETING.odds + 0.1), (("kink",), -COMPETING.odds - 0.1), ((), -1.0)
    )
    assert [f.ids for f in competing_hypotheses(fits, fits["bend",], logs)] == [("bend",), ("ripple",)]
    assert [f.ids for f in competing_hypotheses(fits, fits["bend",], {**logs, ("ripple",): -COMPETING.odds})] == [
        ("bend",)
    ]


def test_nothing_competes_with_no_cause():
    fits, logs = weighed(((), 0.0), (("bend",), -0.1))
    assert competing_hypotheses(fits, fits[()], logs) == (fits[()],)


def test_a_set_that_holds_a_likelier_one_is_no_competing_hypothesis():
    fits, logs = weighed((("bend",), 0.0), (("bend", "ripple"), -4.0), (("kink",), -2.0))
    assert [f.ids for f in competing_hypotheses(fits, fits["bend",], logs)] == [("bend",), ("kink",)]


def test_one_more_cause_that_is_hardly_behind_is_a_competing_hypothesis():
    fits, logs = weighed((("bend",), 0.0), (("bend", "ripple"), -0.9 * COMPETING.added))
    assert [f.ids for f in competing_hypotheses(fits, fits["bend",], logs)] == [("bend",), ("bend", "ripple")]
    fits, logs = weighed((("bend",), 0.0), (("bend", "ripple"), -1.1 * COMPETING.added))
    assert [f.ids for f in competing_hypotheses(fits, fits["bend",], logs)] == [("bend",)]


def test_the_number_of_competing_hypotheses_is_bounded():
    fits, logs = weighed((("bend",), 0.0), (("ripple",), -1.0), (("kink",), -2.0), (("kink", "ripple"), -0.5))
    group = competing_hypotheses(fits, fits["bend",], logs)
    assert [f.ids for f in group] == [("bend",), ("kink", "ripple"), ("ripple",)][: COMPETING.max_hypotheses]


def test_a_cause_held_open_is_in_play_behind_the_best():
    fits, logs = weighed((("bend",), 0.0), (("kink",), -1.0), (("bend", "ripple"), -40.0))
    group = competing_hypotheses(fits, fits["bend",], logs, (fits["bend", "ripple"],))
    assert [f.ids for f in group] == [("bend",), ("bend", "ripple"), ("kink",)]


def test_pairs_that_stand_for_one_another():
    fits, _ = weighed((("bend",), 0.0), (("ripple",), 0.0), (("bend", "kink"), 0.0), (("kink", "ripple"), 0.0))
    group = (fits["bend",], fits["ripple",])
    assert confused_pairs(group) == [["bend", "ripple"]]
    # What is added stands for what the larger of the shared ones leaves.
    assert confused_pairs((fits["bend",], fits["bend", "kink"])) == [["bend", "kink"]]
    both = confused_pairs((fits["bend", "kink"], fits["kink", "ripple"]))
    assert both == [["bend", "ripple"]]
    assert confused_pairs((fits["bend", "kink"],)) == []
    larger = fitted(PROBLEM, BEND, RIPPLE, KINK)
    two = fitted(PROBLEM, BEND, RIPPLE)
    strongest = max(("bend", "ripple"), key=lambda i: abs(two.effect_values[("bend", "ripple").index(i)][0])
                    * np.linalg.norm(design(RUNS, i)[:, 2]))  # fmt: skip
    assert confused_pairs((two, larger)) == [[strongest, "kink"]]


# What a score test promises.


@pytest.mark.parametrize("cause", CAUSES, ids=lambda c: c.id)
@pytest.mark.parametrize("step", [0.01, -0.1])
def test_the_predicted_gain_of_a_linear_candidate_is_that_of_its_fit(cause, step):
    base = fitted(PROBLEM)
    (candidate,) = screen(base, [Probe(cause, (step,), False)])
    columns = design(RUNS, cause.id)
    shape, visible = columns[:, 2], left_of(columns[:, :2], columns[:, 2])
    gain = (np.sum(left_of(columns[:, :2], Y) ** 2) - np.sum(left_of(columns, Y) ** 2)) / SIGMA**2
    assert candidate.gain == pytest.approx(gain, rel=1e-4, abs=1e-6)
    assert candidate.hidden == pytest.approx(1.0 - visible @ visible / (shape @ shape), rel=1e-4)
    exact = solved(columns, Y)
    if abs(exact[2] / step) < 30.0:
        assert candidate.values[0] == pytest.approx(exact[2], rel=1e-4, abs=1e-6)
        np.testing.assert_allclose(candidate.start(base), exact, atol=1e-5)
    np.testing.assert_allclose(fit_jointly(base, candidate).coordinates, exact, atol=1e-3)


def test_a_start_at_a_share_goes_that_share_of_the_predicted_step():
    base = fitted(PROBLEM)
    (candidate,) = screen(base, [Probe(BEND, (0.05,), False)])
    half = base.coordinates + 0.5 * (candidate.start(base)[:2] - base.coordinates)
    np.testing.assert_allclose(candidate.start(base, 0.5), [*half, 0.5 * candidate.values[0]], atol=1e-9)


def test_candidates_come_best_first_one_for_each_effect():
    base = fitted(PROBLEM)
    probes = [Probe(e, (s,), False) for e in (RIPPLE, BEND, KINK) for s in (0.1, 0.2)]
    candidates = screen(base, probes)
    assert [candidate.effect.id for candidate in candidates][0] == "bend"
    assert len(candidates) == 3
    assert [candidate.gain for candidate in candidates] == sorted(
        (candidate.gain for candidate in candidates), reverse=True
    )
    assert "bend" not in [candidate.effect.id for candidate in screen(fitted(PROBLEM, BEND), probes)]


def test_a_one_sided_effect_has_no_predicted_gain_the_other_way():
    base = fitted(PROBLEM)
    assert screen(base, [Probe(one_sided(BEND), (0.1,), True)])
    assert not screen(base, [Probe(one_sided(BEND), (-0.1,), True)])


def test_a_shape_that_the_base_has_has_no_predicted_gain():
    same = replace(LINE, run=lambda i, p: LINE.run(i, {**p, "level": p["level"] + p["bend.size"], "bend.size": 0.0}))
    base = fitted(problem_of(RUNS, simulator=same))
    assert screen(base, [Probe(BEND, (0.1,), False)]) == []
    assert [
        p.effect.id for p in find_hidden_probes(base, [Probe(BEND, (0.1,), False), Probe(RIPPLE, (0.1,), False)], 0.99)
    ] == ["bend"]


def test_what_hides_does_so_by_its_share():
    base = fitted(PROBLEM)
    columns = design(RUNS, "kink")
    residual = left_of(columns[:, :2], columns[:, 2])
    hidden = 1.0 - residual @ residual / (columns[:, 2] @ columns[:, 2])
    probes = [Probe(KINK, (0.1,), False), Probe(KINK, (0.2,), False)]
    assert find_hidden_probes(base, probes, hidden - 1e-3) == [probes[1]]
    assert find_hidden_probes(base, probes, hidden + 1e-3) == []


def test_what_a_tangent_sees_is_orthogonal_to_every_fitted_row():
    fit = fitted(PROBLEM, BEND)
    shape = design(RUNS, "ripple")[:, 2] / SIGMA
    visible = Tangent(fit).visible(shape)
    np.testing.assert_allclose(visible, left_of(design(RUNS, "bend"), shape), atol=1e-6)
    np.testing.assert_allclose(Tangent(fit, base_only=True).visible(shape), left_of(design(RUNS), shape), atol=1e-6)


def test_an_estimate_has_its_interval_of_90_per_cent():
    fit = fitted(PROBLEM, BEND)
    columns = design(RUNS, "bend")
    error = SIGMA * np.sqrt(np.linalg.inv(columns.T @ columns)[2, 2])
    one = estimates_of(fit, "bend")["size"]
    assert one.value == pytest.approx(solved(columns, Y)[2], abs=1e-6)
    assert one.high - one.value == pytest.approx(1.6449 * error, rel=1e-3)
    assert one.value - one.low == pytest.approx(1.6449 * error, rel=1e-3)
    assert estimates_of(fit, "ripple") == {}


def test_a_fit_keeps_its_problem():
    assert isinstance(fitted(PROBLEM), Fit)
