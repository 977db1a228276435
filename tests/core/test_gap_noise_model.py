"""Noise that fades is read from what a fit leaves, and a gap is never called noise."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cho_solve, cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter

from softcal.core import profiles
from softcal.core.gap.case import Case, Run
from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import BASE as PARAMETERS
from softcal.core.gap.hypothesis import Hypothesis, to_fit
from softcal.core.gap.linear import NoiseCorrelation, Stretch, filter_of, filtered, log_likelihood
from softcal.core.gap.method import NoiseCorrelationConfig
from softcal.core.gap.model import Problem
from softcal.core.gap.residual import is_noise, read_noise
from softcal.core.gap.twin import TWIN, diagnose
from softcal.core.recording import Array
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=16, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(
    u0_mm=0.35, k1_N_mm=1.5, k3_N_mm3=0.12, kappa_per_N=0.06, sigma_output_V=0.0012, sigma_force_N=0.012
)
DEPTH_mm = 3.1
STEP_s = 0.02


def _fading(rng: np.random.Generator, count: int, spread: float, fading_s: float) -> Array:
    decay = np.exp(-STEP_s / fading_s)
    kicks = rng.normal(0.0, spread * np.sqrt(1.0 - decay**2), count)
    kicks[0] = rng.normal(0.0, spread)
    return np.asarray(lfilter([1.0], [1.0, -decay], kicks))


def _covariance(count: int, white: float, correlation: NoiseCorrelation) -> Array:
    fade = correlation.spread**2 * np.exp(-STEP_s * np.arange(count) / correlation.fading_s)
    return np.asarray(toeplitz(fade) + white**2 * np.eye(count))


@pytest.mark.parametrize("left_out", [0, 37])
def test_likelihood_and_whitening_are_those_of_the_whole_covariance(left_out: int) -> None:
    rng, count, white, correlation = np.random.default_rng(3), 200, 0.7, NoiseCorrelation(1.3, 0.3)
    values, weights = rng.normal(size=count), np.ones(count)
    weights[rng.permutation(count)[:left_out]] = 0.0
    rows = weights > 0.0
    factor = cholesky(_covariance(count, white, correlation)[np.ix_(rows, rows)], lower=True)
    step_s = np.full(count, STEP_s)
    whitened = filtered(
        values, filter_of(np.full(count, white), weights, step_s, correlation.spread, correlation.fading_s)
    )
    assert whitened[rows] == pytest.approx(solve_triangular(factor, values[rows], lower=True), abs=1e-9)
    assert np.all(whitened[~rows] == 0.0)
    exact = -0.5 * (values[rows] @ cho_solve((factor, True), values[rows])) - float(np.sum(np.log(np.diag(factor))))
    assert log_likelihood([Stretch(values, step_s, weights)], white, correlation) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("fading_s", [0.1, 0.5, 2.0])
def test_noise_is_read_as_it_was_made(fading_s: float) -> None:
    rng, step_s = np.random.default_rng(5), np.full(2000, STEP_s)
    parts = [
        Stretch(_fading(rng, 2000, 2.0, fading_s) + rng.normal(0.0, 1.0, 2000), step_s, np.ones(2000)) for _ in range(6)
    ]
    noise = read_noise(parts, NoiseCorrelationConfig())
    assert noise.white == pytest.approx(1.0, rel=0.05)
    assert noise.correlation.spread == pytest.approx(2.0, rel=0.25)
    assert noise.correlation.fading_s == pytest.approx(fading_s, rel=0.5)
    assert noise.gain > 100.0


def test_white_noise_has_no_colour() -> None:
    rng, step_s = np.random.default_rng(6), np.full(2000, STEP_s)
    for _ in range(20):
        stretch = Stretch(rng.normal(0.0, 3.0, 2000), step_s, np.ones(2000))
        assert read_noise([stretch], NoiseCorrelationConfig()).gain < NoiseCorrelationConfig().gain


def _case(seed: int, *effects: EffectSetting, volts: float = 0.0, newtons: float = 0.0, fading_s: float = 0.5) -> Case:
    rng, runs = np.random.default_rng(seed), []
    press_profiles = (
        profiles.ramps([DEPTH_mm] * 3, 0.5),
        profiles.ramps([DEPTH_mm] * 8, 4.0),
        profiles.steps_with_holds([1.2, 2.4, DEPTH_mm, 1.8], hold_s=4.0),
        profiles.ramps([2.0, 2.9, 1.1, DEPTH_mm, 2.5], 1.3),
    )
    for profile in press_profiles:
        t_s, stage_mm = profile.sample(1.0 / STEP_s)
        force_N, output_V = simulate(Twin(BASE, effects, READOUT), t_s, stage_mm, rng, np.full(len(t_s), 22.0))
        force_N = force_N + _fading(rng, len(t_s), newtons, fading_s)
        output_V = output_V + _fading(rng, len(t_s), volts, fading_s)
        runs.append(Run(profile.name, t_s, READOUT, stage_mm, force_N, output_V, profile=profile.name))
    return Case("G1", tuple(runs))


@pytest.mark.long
@pytest.mark.parametrize(("volts", "newtons", "fading_s"), [(0.003, 0.0, 0.5), (0.0, 0.03, 0.5), (0.004, 0.05, 0.15)])
def test_a_rig_without_a_gap_has_none_whatever_the_correlation_of_its_noise(
    volts: float, newtons: float, fading_s: float
) -> None:
    diagnosis = diagnose(_case(8, volts=volts, newtons=newtons, fading_s=fading_s))
    assert diagnosis.verdict == "no_gap"
    noise_floor = diagnosis.gap["output_V"].noise_floor
    assert noise_floor == pytest.approx(np.hypot(BASE.sigma_output_V, volts), rel=0.25)


@pytest.mark.long
def test_a_cause_is_named_through_coloured_noise() -> None:
    relaxes = EffectSetting("stress_relaxation", {"g": 0.08, "tau": 5.0})
    diagnosis = diagnose(_case(9, relaxes, newtons=0.03))
    assert diagnosis.verdict == "explained"
    assert diagnosis.best.hypothesis.ids == ("stress_relaxation",)


def _as_noise(case: Case, spread_N: float, fading_s: float = 0.5) -> bool:
    problem = TWIN.base_fit(case).problem.with_noise(
        {"force_N": 0.012, "output_V": 0.0012, "stage_mm": 0.002}, {"force_N": NoiseCorrelation(spread_N, fading_s)}
    )
    start = np.array([to_fit(p, getattr(BASE, p.name)) for p in PARAMETERS])
    return is_noise(fit(problem, Hypothesis(), start))


def _under_load(case: Case, newtons: Callable[[Run], Array]) -> Case:
    """The case with a force added where the sensor is pressed."""
    loaded_runs = (replace(r, force_N=r.force_N + newtons(r) * (r.stage_mm > BASE.u0_mm)) for r in case.runs)
    return Case("G1", tuple(loaded_runs))


def test_what_follows_the_load_is_no_noise_however_large_noise_is_taken_to_be() -> None:
    dragging = _under_load(_case(10), lambda run: 0.1 * np.sign(np.gradient(run.stage_mm)))
    assert not _as_noise(dragging, 0.1)
    assert _as_noise(_case(11, newtons=0.1), 0.1)


def test_noise_that_comes_with_the_load_is_no_floor() -> None:
    rng = np.random.default_rng(12)
    assert not _as_noise(_under_load(_case(12), lambda run: _fading(rng, len(run), 0.06, 0.5)), 0.06)


def test_white_noise_may_grow_with_the_load() -> None:
    rng = np.random.default_rng(13)
    assert _as_noise(_under_load(_case(13, newtons=0.06), lambda run: rng.normal(0.0, 0.025, len(run))), 0.06)


def test_what_does_not_fade_is_no_noise() -> None:
    assert not _as_noise(_case(11, newtons=0.1), 0.1, fading_s=NoiseCorrelationConfig().longest_s)


@pytest.mark.long
@pytest.mark.parametrize("seed", [14, 15])
def test_a_resistance_that_wanders_is_no_floor(seed: int) -> None:
    rng, case = np.random.default_rng(seed), _case(seed)
    walks = [replace(r, output_V=r.output_V + np.cumsum(rng.normal(0.0, 2e-4, len(r)))) for r in case.runs]
    diagnosis = diagnose(Case("G1", tuple(walks)))
    assert diagnosis.verdict != "no_gap"
    assert not [c.effect for c in diagnosis.causes if c.probability > 0.5]


def test_a_problem_of_white_noise_is_weighted_as_ever() -> None:
    problem = Problem(TWIN, _case(1), {"force_N": 0.012, "output_V": 0.0012})
    values = np.random.default_rng(1).normal(size=len(problem.measured))
    assert np.array_equal(problem.whitened(values), values * problem.weights)
    assert np.array_equal(problem.slow_noise, problem.noise)
