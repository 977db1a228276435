"""Noise that fades, against the Gaussian of its covariance; tests of a residual, against their distributions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2 as chi2_law
from scipy.stats import multivariate_normal, norm

from softcal.core.gap.case import straightened
from softcal.core.gap.fit import structure
from softcal.core.gap.linear import (
    NoiseCorrelation,
    Stretch,
    filter_of,
    filtered,
    log_likelihood,
    orthonormal,
    projected,
)
from softcal.core.gap.method import METHOD, NoiseCorrelationConfig
from softcal.core.gap.residual import is_noise, noise_chance, noise_levels, noise_of, read_noise, with_correlated_noise
from softcal.core.gap.simulator_model import SimulatorModel
from softcal.core.gap.simulator_reach import columns_of
from tests.core.linear_mechanism import BEND, SIGMA, design, fitted, left_of, measured, problem_of, runs_of

WHITE, SPREAD, FADING_s = 0.3, 0.7, 0.4
T_s = np.cumsum(np.random.default_rng(1).uniform(0.01, 0.2, 40))
STEP_s = np.diff(T_s, prepend=T_s[0])
IS_USED = (np.random.default_rng(2).random(40) < 0.8).astype(float)


def covariance(t_s, white=WHITE, spread=SPREAD, fading_s=FADING_s):
    """Of white noise beside an Ornstein–Uhlenbeck process."""
    return white**2 * np.eye(len(t_s)) + spread**2 * np.exp(-np.abs(np.subtract.outer(t_s, t_s)) / fading_s)


def draw_noise(seed, t_s=T_s, **noise):
    return np.random.default_rng(seed).multivariate_normal(np.zeros(len(t_s)), covariance(t_s, **noise))


def test_the_likelihood_is_that_of_the_gaussian():
    stretches = [Stretch(draw_noise(k), STEP_s, IS_USED) for k in (1, 2)]
    rows = IS_USED > 0
    law = multivariate_normal(cov=covariance(T_s)[np.ix_(rows, rows)])
    # Up to the constant of the Gaussian, n/2·ln 2π.
    expected = sum(law.logpdf(s.error[rows]) + 0.5 * rows.sum() * np.log(2 * np.pi) for s in stretches)
    assert log_likelihood(stretches, WHITE, NoiseCorrelation(SPREAD, FADING_s)) == pytest.approx(expected)


def test_a_filter_makes_independent_values_of_variance_1():
    noise = np.full(40, WHITE) * np.linspace(0.5, 2.0, 40)
    steps = filter_of(noise, IS_USED, STEP_s, SPREAD, FADING_s)
    rows = IS_USED > 0
    whole = np.diag(noise**2) + covariance(T_s, white=0.0)
    values = draw_noise(3)
    out = filtered(values, steps)
    assert np.all(out[~rows] == 0.0)
    expected = values[rows] @ np.linalg.solve(whole[np.ix_(rows, rows)], values[rows])
    assert out @ out == pytest.approx(expected)
    # A filter is linear and looks back alone: its matrix is the inverse of a Cholesky factor.
    matrix = np.array([filtered(row, steps) for row in np.eye(40)]).T[np.ix_(rows, rows)]
    np.testing.assert_allclose(matrix, np.linalg.inv(np.linalg.cholesky(whole[np.ix_(rows, rows)])), atol=1e-9)


def test_slow_noise_is_the_sum_of_all_correlations():
    step_s = 0.05
    lags = np.arange(-2000, 2001)
    expected = np.sum(SPREAD**2 * np.exp(-np.abs(lags) * step_s / FADING_s))
    assert NoiseCorrelation(SPREAD, FADING_s).slow_variance(step_s) == pytest.approx(expected)


def long_record(seed, runs=2, count=400, step_s=0.05):
    t_s = step_s * np.arange(count)
    return [Stretch(draw_noise(seed + k, t_s), np.diff(t_s, prepend=0.0), np.ones(count)) for k in range(runs)]


def test_the_noise_that_is_read_is_the_likeliest():
    stretches = long_record(5)
    noise = read_noise(stretches, METHOD.noise_correlation)

    def negative_log_likelihood(x):
        return -log_likelihood(stretches, np.exp(x[0]), NoiseCorrelation(np.exp(x[1]), np.exp(x[2])))

    best = minimize(
        negative_log_likelihood,
        np.log([WHITE, SPREAD, FADING_s]),
        method="Nelder-Mead",
        options={"xatol": 1e-4, "fatol": 1e-4},
    )
    assert noise.log_likelihood == pytest.approx(-best.fun, abs=0.1)
    assert log_likelihood(stretches, noise.white, noise.correlation) == pytest.approx(noise.log_likelihood, abs=1e-6)
    assert noise.white == pytest.approx(np.exp(best.x[0]), rel=0.1)
    assert noise.correlation.spread == pytest.approx(np.exp(best.x[1]), rel=0.1)
    assert noise.correlation.fading_s == pytest.approx(np.exp(best.x[2]), rel=0.15)
    every = np.concatenate([s.error for s in stretches])
    alone = norm.logpdf(every, 0.0, np.sqrt(np.mean(every**2))).sum() + 0.5 * len(every) * np.log(2 * np.pi)
    assert noise.gain == pytest.approx(noise.log_likelihood - alone, abs=1e-6)


def test_a_fading_time_stays_within_its_bounds():
    config = NoiseCorrelationConfig(longest_s=0.2)
    assert read_noise(long_record(5), config).correlation.fading_s == pytest.approx(0.2, rel=0.02)
    config = NoiseCorrelationConfig(shortest_s=0.8)
    assert read_noise(long_record(5), config).correlation.fading_s == pytest.approx(0.8, rel=0.02)


def test_white_noise_gains_nothing_by_a_fading_part():
    t_s = 0.05 * np.arange(400)
    white = Stretch(np.random.default_rng(8).normal(0.0, 2.0, 400), np.diff(t_s, prepend=0.0), np.ones(400))
    noise = read_noise([white], METHOD.noise_correlation)
    assert 0.0 <= noise.gain + 0.05 < 5.0 < METHOD.noise_correlation.gain


def test_what_is_left_out_does_not_count():
    t_s = 0.05 * np.arange(400)
    weights = np.ones(400)
    weights[100:150] = 0.0
    error = draw_noise(7, t_s)
    disturbed = error + 50.0 * (weights == 0.0)
    one, other = (
        read_noise([Stretch(e, np.diff(t_s, prepend=0.0), weights)], METHOD.noise_correlation)
        for e in (error, disturbed)
    )
    assert one.white == pytest.approx(other.white)
    assert one.log_likelihood == pytest.approx(other.log_likelihood)


def test_a_rig_that_is_slower_is_read_the_same():
    stretches = long_record(5)
    slow = [replace(s, step_s=10.0 * s.step_s) for s in stretches]
    one, other = (
        read_noise(stretches, METHOD.noise_correlation),
        read_noise(slow, METHOD.noise_correlation.slower(10.0)),
    )
    assert other.correlation.fading_s == pytest.approx(10.0 * one.correlation.fading_s, rel=1e-6)
    assert (other.white, other.gain) == pytest.approx((one.white, one.gain))


# In a problem.

COUNTS = (400, 300)


def faded(seed=0, spread=0.15, **truth):
    """Runs with noise that fades on top of the white one."""
    runs = runs_of(truth, COUNTS)
    out = []
    for k, run in enumerate(runs):
        slow = draw_noise(seed + k, run.t_s, white=0.0, spread=spread)
        out.append(replace(run, columns={**run.columns, "y": run.columns["y"] + slow}))
    return out


def test_a_problem_with_fading_noise_is_generalised_least_squares():
    runs = faded()
    problem = problem_of(runs).with_noise({"y": SIGMA}, {"y": NoiseCorrelation(0.15, FADING_s)})
    whole = np.zeros((700, 700))
    for k, at in enumerate((slice(0, 400), slice(400, 700))):
        whole[at, at] = covariance(runs[k].t_s, SIGMA, 0.15)
    columns, y = design(runs, "bend"), measured(runs)
    weighted = np.linalg.solve(whole, columns)
    exact = np.linalg.solve(columns.T @ weighted, weighted.T @ y)
    fit = fitted(problem, BEND)
    np.testing.assert_allclose(fit.coordinates, exact, atol=1e-4)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(columns.T @ weighted), rtol=1e-4)
    error = y - columns @ exact
    assert fit.chi2 == pytest.approx(error @ np.linalg.solve(whole, error), rel=1e-6)
    assert problem.noise_floor("y") == pytest.approx(np.hypot(SIGMA, 0.15))
    np.testing.assert_allclose(problem.total_noise, np.hypot(SIGMA, 0.15))
    np.testing.assert_allclose(problem.slow_noise**2, SIGMA**2 + NoiseCorrelation(0.15, FADING_s).slow_variance(0.05))
    np.testing.assert_allclose(problem.noise, SIGMA)
    assert problem.count == 700


def test_noise_is_read_from_a_residual_and_called_fading_by_its_gain():
    fit = fitted(problem_of(faded()))
    levels, correlations = noise_of(fit, ["y"])
    assert correlations["y"].spread == pytest.approx(0.15, rel=0.2)
    assert correlations["y"].fading_s == pytest.approx(FADING_s, rel=0.5)
    assert levels["y"] == pytest.approx(SIGMA, rel=0.2)
    assert noise_of(fit) == (noise_levels(fit), {})
    white = fitted(problem_of(runs_of({}, COUNTS)))
    assert noise_of(white, ["y"])[1] == {}
    assert with_correlated_noise(white) is None
    assert with_correlated_noise(fit).correlation == correlations


def test_a_noise_level_is_that_of_second_differences_whatever_is_smooth():
    smooth = 3.0 * np.sin(np.arange(2000) / 200.0)
    runs = runs_of({}, (2000,), noise=0.2)
    # In the order of time the line is rough; its residual is white, and something smooth beside it does not show.
    bent = [replace(r, columns={**r.columns, "y": r.columns["y"] + smooth}) for r in runs]
    level = noise_levels(fitted(problem_of(bent)))["y"]
    assert level == pytest.approx(0.2, rel=0.08)
    silent = [replace(r, columns={**r.columns, "y": 1.0 + 2.0 * r.columns["x"]}) for r in runs]
    assert noise_levels(fitted(problem_of(silent)))["y"] == pytest.approx(
        1e-9 * np.ptp(silent[0].columns["y"]), rel=0.5
    )


def test_the_share_of_the_largest_squares_is_taken_off_and_made_good():
    rng = np.random.default_rng(3)
    run = runs_of({}, (4000,), noise=0.1)[0]
    y = run.columns["y"] + 40.0 * (rng.random(4000) < 0.001)
    level = noise_levels(fitted(problem_of([replace(run, columns={**run.columns, "y": y})])))["y"]
    assert level == pytest.approx(0.1, rel=0.06)


# Structure.


def test_structure_is_the_excess_of_block_sums():
    fit = fitted(problem_of(runs_of({"ripple.size": 0.1}, (97, 85))))
    best = -np.inf
    for length in METHOD.structure.block_samples:
        sums = []
        for block in fit.problem.blocks:
            part = fit.residual[block.rows]
            sums += [part[k : k + length].sum() / np.sqrt(length) for k in range(0, len(part) - length + 1, length)]
        if len(sums) > 3:
            best = max(best, (np.mean(np.square(sums)) - 1.0) / np.sqrt(2.0 / len(sums)))
        if length == METHOD.structure.block_samples[0]:
            rms = np.sqrt(max(np.mean(np.square(sums)) - 1.0, 0.0) / length)
    one = structure(fit)
    assert (one.z, one.rms) == pytest.approx((best, rms))
    assert structure(fit, "y") == one
    assert (not structure(fit).is_significant) == (not one.z > METHOD.structure.structured_z)


def test_structure_counts_from_its_level_on():
    at = METHOD.structure.structured_z
    fit = fitted(problem_of(runs_of({}, COUNTS)))
    assert structure(fit).is_significant == (structure(fit).z > at)


def test_too_few_blocks_decide_nothing():
    fit = fitted(problem_of(runs_of({}, (31,), noise=10 * SIGMA)))
    assert structure(fit).z == -np.inf
    assert not structure(fit).is_significant


# How likely noise leaves as much.


def worst_of(tests):
    return min(1.0, len(tests) * norm.sf(max(tests)))


def standard(chi2, freedom):
    """χ² as a standard normal value of the same chance."""
    return norm.isf(chi2_law.sf(chi2, freedom))


@pytest.mark.parametrize("truth", [{}, {"bend.size": 0.02}, {"ripple.size": 0.06}])
def test_the_chance_is_that_of_the_worst_of_all_tests(truth):
    runs = runs_of(truth, COUNTS)
    fit = fitted(problem_of(runs))
    residual = left_of(design(runs), measured(runs)) / SIGMA
    parts, n = (residual[:400], residual[400:]), 700
    tests = [(residual @ residual - n) / np.sqrt(2 * n)]
    lags = range(1, METHOD.noise_test.lags + 1)
    squares = [(sum(p[k:] @ p[:-k] for p in parts) / (residual @ residual)) ** 2 for k in lags]
    tests.append(standard(n * sum(squares), METHOD.noise_test.lags))
    for group in fit.problem.model.followed(fit, "y"):
        # By a rank and a regression instead of an orthonormal basis.
        regressors = np.column_stack([design(runs), *group])
        explained = residual @ residual - left_of(regressors, residual) @ left_of(regressors, residual)
        rank = np.linalg.matrix_rank(regressors, tol=1e-3 * np.linalg.norm(regressors, ord=2)) - 2
        tests.append(standard(explained, max(rank, 1)))
    chance = noise_chance(fit)
    assert np.log10(max(chance, 1e-12)) == pytest.approx(np.log10(max(worst_of(tests), 1e-12)), abs=0.8)
    assert (chance > METHOD.noise_test.chance) == (truth == {})
    alone = noise_chance(replace(fit, problem=replace(fit.problem, model=Plain(fit.problem.model.simulator))))
    assert alone == pytest.approx(worst_of(tests[:2]), rel=0.2)


class Plain(SimulatorModel):
    """A model of which nothing is known that a residual may follow."""

    def followed(self, fit, channel):
        return []

    def halves(self, fit, block):
        return (np.arange(block.rows.stop - block.rows.start) % 2 == 0,)


def test_noise_of_the_right_colour_is_noise_and_a_wander_is_none():
    runs = faded(spread=0.1)
    problem = problem_of(runs).with_noise({"y": SIGMA}, {"y": NoiseCorrelation(0.1, FADING_s)})
    fit = fitted(problem)
    assert is_noise(replace(fit, problem=replace(problem, model=Plain(fit.problem.model.simulator))))
    longest_s = problem.correlation_config.longest_s
    wander = fitted(
        problem.with_noise(
            {"y": SIGMA}, {"y": NoiseCorrelation(0.1, 0.95 * METHOD.noise_test.wanders / 0.9 * longest_s)}
        )
    )
    assert not is_noise(replace(wander, problem=replace(wander.problem, model=Plain(fit.problem.model.simulator))))


def test_orthonormal_rows_span_the_rows():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(3, 50)) * np.array([[1e-3], [1.0], [1e4]])
    rows = np.vstack([rows, rows[0] + rows[1] * 1e-3, np.zeros(50)])
    basis = orthonormal(rows)
    assert basis.shape == (3, 50)
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-9)
    for row in rows:
        np.testing.assert_allclose(basis.T @ (basis @ row), row, atol=1e-8 * max(np.linalg.norm(row), 1))
    assert len(orthonormal(np.zeros((2, 50)))) == 0
    assert len(orthonormal(np.zeros((0, 50)))) == 0


def test_projected_rows_are_what_others_leave():
    rng = np.random.default_rng(0)
    fitted_rows, rows = rng.normal(size=(2, 50)), rng.normal(size=(3, 50))
    basis = projected([*rows, fitted_rows[0] + 1e-4 * rows[0], 0.0 * rows[0]], fitted_rows)
    assert len(basis) == 3
    np.testing.assert_allclose(basis @ fitted_rows.T, 0.0, atol=1e-9)
    residuals = np.array([left_of(fitted_rows.T, row) for row in rows])
    np.testing.assert_allclose(residuals @ basis.T @ basis, residuals, atol=1e-9)
    np.testing.assert_allclose(
        projected(list(rows), np.zeros((0, 50))) @ rows[0] @ (projected(list(rows), np.zeros((0, 50))) @ rows[0]),
        rows[0] @ rows[0],
    )


def test_columns_of_a_signal_are_its_equations():
    run = runs_of({}, (200,))[0]
    signal = np.sin(run.t_s)
    groups = columns_of(signal, run, 1.0, METHOD.noise_test)
    rate = np.gradient(signal, run.t_s)
    np.testing.assert_allclose(np.sum(groups["level"], axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(groups["rate"][:4], [rate, np.abs(rate), rate * np.abs(rate), signal * rate])
    np.testing.assert_allclose(groups["rate"][4][2:-2], -np.sin(run.t_s)[2:-2], atol=2e-3)
    np.testing.assert_allclose(groups["way"], [np.sign(rate), signal * np.sign(rate), signal**2 * np.sign(rate)])
    np.testing.assert_allclose(groups["time"], [run.elapsed_s, signal * run.elapsed_s])
    memories = len(METHOD.noise_test.memory_s)
    for k, tau_s in enumerate(METHOD.noise_test.memory_s):
        # τ·dy/dt = x − y from rest, in closed form for a sine.
        t_s, w = run.elapsed_s, tau_s
        exact = (np.sin(t_s) - w * np.cos(t_s) + w * np.exp(-t_s / w)) / (1.0 + w**2)
        np.testing.assert_allclose(groups["memory"][k], exact, atol=2e-3)
        np.testing.assert_allclose(groups["memory"][memories + k], signal * exact, atol=2e-3)
    slow = columns_of(signal, run, 3.0, METHOD.noise_test)["memory"]
    w = 3.0 * METHOD.noise_test.memory_s[0]
    exact = (np.sin(run.t_s) - w * np.cos(run.t_s) + w * np.exp(-run.t_s / w)) / (1.0 + w**2)
    np.testing.assert_allclose(slow[0], exact, atol=2e-3)


# A measured force, smoothed.


def test_a_straightened_signal_is_a_local_line():
    rng = np.random.default_rng(1)
    half, sigma = 4, 0.1
    signal = 0.3 * np.arange(60) + rng.normal(0.0, sigma, 60)
    out, share = straightened(signal, 3.0 * sigma, half)
    for k in range(60):
        first, last = (k - half, k + half) if half <= k < 60 - half else ((k, k + half) if k < half else (k - half, k))
        x = np.arange(first, last + 1)
        assert out[k] == pytest.approx(np.polyval(np.polyfit(x, signal[first : last + 1], 1), k))
        columns = np.column_stack([np.ones(len(x)), x])
        row = np.array([1.0, k])
        assert share[k] == pytest.approx(row @ np.linalg.inv(columns.T @ columns) @ row)


def test_a_corner_stays_where_it_is():
    x = np.arange(60.0)
    corner = np.maximum(0.0, x - 30.0)
    out, share = straightened(corner, 1e-3, 4)
    np.testing.assert_allclose(out, corner, atol=1e-12)
    assert np.all(share <= 1.0)
    jump = 1.0 * (x >= 30)
    np.testing.assert_allclose(straightened(jump, 1e-3, 4)[0], jump, atol=1e-12)
    noisy = np.random.default_rng(0).normal(0.0, 1.0, 60)
    smoothed, share = straightened(noisy, 1e-6, 4)
    np.testing.assert_array_equal(smoothed, noisy)
    np.testing.assert_array_equal(share, 1.0)
