"""The published equations against their own formulae, and the seeds against being found."""

import json
from dataclasses import asdict

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import erf

from softcal.core.challenge import published_equations
from softcal.core.challenge.case_generator import LINES, SIZES, draw_case, draw_challenge
from softcal.core.challenge.published_equations import PUBLISHED_FORMS, PUBLISHED_OUTSIDE
from softcal.core.challenge.rig import Moment, Rig

STEP_s = 0.002
T = np.arange(20_000) * STEP_s
RIG = Rig(0.3, 1.2, 0.1, 4.0, 0.06, 1e-3, 0.01, 3.3, 10.0, 12, 50.0)


def moment(compression_mm=None, force_N=None) -> Moment:
    nothing = np.zeros(len(T))
    force_N = nothing if force_N is None else force_N
    compression_mm = nothing if compression_mm is None else compression_mm
    return Moment(RIG, T, STEP_s, T, T, np.random.default_rng(1), compression_mm, force_N)


def form(effect: str):
    return next(e.apply for (name, _), e in PUBLISHED_FORMS.items() if name == effect)


STEP = np.where(T > 0, 5.0, 0.0)


def test_a_held_force_relaxes_as_kohlrausch_wrote():
    values = form("stress_relaxation")(STEP, moment(), 0.2, 3.0)
    expected = 5.0 * (1.0 - 0.2 * (1.0 - np.exp(-np.sqrt(T / 3.0))))
    np.testing.assert_allclose(values[50:], expected[50:], atol=0.01)


def test_a_held_cell_creeps_with_the_cube_root_of_time():
    values = form("loadcell_creep")(STEP, moment(), 0.02, 12.0)
    np.testing.assert_allclose(values[100:], (5.0 * (1.0 + 0.6 * 0.02 * np.cbrt(T / 12.0)))[100:], atol=0.002)


def test_a_first_press_is_not_softened_and_the_way_back_is():
    depth = np.interp(T, [0, 10, 20, 40], [0, 3, 0, 2])
    force = RIG.k1_N_mm * depth + RIG.k3_N_mm3 * depth**3
    softened = form("mullins_softening")(force, moment(depth), 0.1, 2.0)
    ratio = np.divide(softened, force, out=np.ones(len(T)), where=force > 0)
    np.testing.assert_allclose(ratio[T < 10], 1.0, atol=1e-12)
    energy = 0.5 * RIG.k1_N_mm * 9.0 + RIG.k3_N_mm3 * 81.0 / 4.0
    at = np.argmin(np.abs(T - 15))
    energy_left = 0.5 * RIG.k1_N_mm * depth[at] ** 2 + RIG.k3_N_mm3 * depth[at] ** 4 / 4.0
    assert ratio[at] == pytest.approx(1.0 - 0.1 * erf((energy - energy_left) / (2.0 * 4.5 / 2.4)), abs=1e-4)


def test_the_friction_state_solves_dahls_equation():
    speed = np.where(T < 10, 0.4, -0.25)
    load = np.cumsum(speed) * STEP_s
    expected = solve_ivp(
        lambda t, z: (0.4 if t < 10 else -0.25) * (1 - z * (1 if t < 10 else -1)) ** 2, (0, T[-1]), [0.0],
        t_eval=T, max_step=0.02, rtol=1e-8,
    ).y[0]  # fmt: skip
    np.testing.assert_allclose(published_equations._dahl_state(load, 1.0), expected, atol=5e-3)


def test_the_low_pass_delays_a_ramp_by_its_tau_and_passes_a_constant():
    ramp = form("readout_lag")(T.copy(), moment(), 0.1)
    np.testing.assert_allclose((T - ramp)[500:], 0.1, atol=3 * STEP_s)
    np.testing.assert_allclose(form("readout_lag")(np.full(len(T), 2.0), moment(), 0.1), 2.0, atol=1e-9)


def test_the_cell_swings_at_its_frequency():
    push = np.where(T > 1.0, 5.0, 0.0)
    values = PUBLISHED_OUTSIDE["cell_ringing"].apply(push, moment(), 4.0, 0.05)
    after = values[T > 1.0] - 5.0
    ups = np.flatnonzero((after[:-1] < 0) & (after[1:] >= 0))
    assert 1.0 / (np.diff(ups)[0] * STEP_s) == pytest.approx(4.0, rel=0.02)
    assert after.max() / 5.0 == pytest.approx(np.exp(-np.pi * 0.05 / np.sqrt(1 - 0.05**2)), rel=0.05)


def test_film_and_stiffening_and_growth_are_their_formulae():
    force = np.linspace(0, 8, len(T))
    film = PUBLISHED_OUTSIDE["film_contact"].apply(np.full(len(T), 4.0), moment(force_N=force), 0.3, 0.5)
    np.testing.assert_allclose(film, 4.0 + 0.3 / np.sqrt(1 + force / 0.5))
    depth = 2.0 * T
    stiff = PUBLISHED_OUTSIDE["rate_stiffening"].apply(np.ones(len(T)), moment(depth), 0.05, 2.0)
    np.testing.assert_allclose(stiff, 1.05, atol=1e-9)
    grown = PUBLISHED_OUTSIDE["screw_growth"].apply(np.ones(len(T)), moment(), 0.02, 60.0)
    np.testing.assert_allclose(grown, 1.0 - 0.02 * (1 - np.exp(-T / 60.0)))


def test_a_stray_tone_is_not_the_mains():
    for seed in range(200):
        case = draw_case(seed, "case", "published_outside")
        for cause in case.causes:
            if cause.effect == "stray_tone":
                rate = case.rig.sample_rate_Hz
                aliases = [abs(m - rate * round(m / rate)) for m in (50.0, 60.0)]
                assert all(abs(cause.values["frequency_Hz"] - a) > 1.5 for a in aliases)


def test_every_published_equation_is_drawn_and_has_a_size():
    forms = {(c.effect, c.form) for s in range(150) for c in draw_case(s, "case", "published_form").causes}
    outside = {c.effect for s in range(150) for c in draw_case(s, "case", "published_outside").causes}
    assert forms == set(PUBLISHED_FORMS) and outside == set(PUBLISHED_OUTSIDE) <= set(SIZES)
    assert {effect for effect, _ in PUBLISHED_FORMS} <= set(SIZES)


@pytest.mark.parametrize("line", LINES)
def test_seeds_cannot_be_tried_one_by_one(line: str) -> None:
    case = draw_challenge(2**127 + 5, 1)[0]
    sealed_case = draw_case(2**127 + 5, "case", line)
    for plan in (*case.plans, *sealed_case.plans, sealed_case.kept_back):
        assert plan.seed.bit_length() > 96, "31 bits were tried against a path in minutes"
    again = msgspec.convert(json.loads(json.dumps(asdict(sealed_case))), type(sealed_case))
    assert again.plans == sealed_case.plans


def test_what_is_printed_of_a_rig_carries_no_draw():
    printed, dummies = set(), set()
    for seed in range(300):
        case = draw_case(seed, "case", "usual")
        printed.add(f"{case.rig.r_series_ohm:.6g}")
        dummies.add(case.measure(type(case.plans[0])("dummy_resistor", seed)).dummy_ohm)
        assert case.rig.r_series_ohm == float(f"{case.rig.r_series_ohm:.1e}")
    assert len(printed) < 150 and len(dummies) == 3
