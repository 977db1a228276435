"""Recursions, other forms of causes, probes and records of the twin, by their own equations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from softcal.core.errors import InputError
from softcal.core.twin import properties
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import (
    Effect,
    ExcitationRange,
    Flow,
    Hook,
    Parameter,
    SearchTarget,
    Signs,
    adds,
    grows,
    hands_on,
    set_signal,
)
from softcal.core.twin.electronics import CLIPPED_BELOW, digitise
from softcal.core.twin.empirical_terms import VARIABLES, EmpiricalTerm, MEMORY_s
from softcal.core.twin.forms import STOPS
from softcal.core.twin.mechanics import elastic_force, elastic_force_at, soft_contact
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.probes import Shapes, Sizes, TAU_s, TimeConstants
from softcal.core.twin.properties import PROPERTIES, Violation
from softcal.core.twin.signals import completed_presses, direction_state, largest_so_far, low_pass, play, read_at
from softcal.core.twin.simulate import Chain, EffectSetting, Twin, TwinStream, simulate, twin_from_record, twin_record
from softcal.core.twin.transduction import COLLAPSED, channel_resistance

BASE = BaseParameters(u0_mm=0.3, k1_N_mm=1.1, k3_N_mm3=0.1, r0_ohm=4.0, kappa_per_N=0.06)
FINE = ReadoutMetadata(vref_V=5.0, adc_bits=32, r_series_ohm=10.0, sample_rate_Hz=100.0)
T = np.arange(801) / 100.0
STAGE_mm = 1.5 * np.minimum(np.mod(T, 4.0), 4.0 - np.mod(T, 4.0))
DEPTH_mm = np.maximum(0.0, STAGE_mm - 0.3)
FORCE_N = 1.1 * DEPTH_mm + 0.1 * DEPTH_mm**3


def volt(resistance):
    return 5.0 * resistance / (resistance + 10.0)


def resistance(force):
    return 4.0 / (1.0 - 0.06 * force)


REST_V = volt(4.0)
CLEAN_V = volt(resistance(FORCE_N))


def run(effect_id, form="", episodes=(), temperature_C=None, base=BASE, readout=FINE, **values):
    twin = Twin(base, (EffectSetting(effect_id, values, episodes, form),), readout)
    return simulate(twin, T, STAGE_mm, temperature_C=temperature_C)


def low_passed(values, tau_s, start=0.0):
    """τ·dy/dt = x − y along straight lines between the samples."""
    solution = solve_ivp(
        lambda t, y: (np.interp(t, T, values) - y) / tau_s, (0, T[-1]), [start], t_eval=T, max_step=0.005, rtol=1e-8
    )
    return solution.y[0]


# Recursions.


def test_a_low_pass_is_exact_along_linear_segments_of_any_step():
    rng = np.random.default_rng(1)
    t_s = np.cumsum(rng.uniform(0.01, 0.4, 30))
    x = rng.normal(size=30)
    state = np.array([0.3, -0.2])
    step_s = np.concatenate([[0.15], np.diff(t_s)])
    out = low_pass(x, step_s, 0.2, state)
    y, before = 0.3, -0.2
    for k in range(30):
        h, slope = step_s[k], (x[k] - before) / step_s[k]
        # The particular solution of a ramp is the ramp τ later.
        y = x[k] - slope * 0.2 + (y - before + slope * 0.2) * np.exp(-h / 0.2)
        before = x[k]
        assert out[k] == pytest.approx(y, abs=1e-12)
    assert tuple(state) == pytest.approx((y, x[-1]))
    assert low_pass(np.ones(3), np.full(3, 1e-12), 1.0, np.zeros(2))[-1] == pytest.approx(0.0, abs=1e-11)


def test_a_play_follows_only_what_pushes_it():
    x = np.array([0.0, 0.05, 0.2, 0.5, 0.45, 0.38, 0.3, 0.6])
    state = np.array([-0.1])
    np.testing.assert_allclose(play(x, 0.1, state), [-0.1, -0.05, 0.1, 0.4, 0.4, 0.38, 0.3, 0.5])
    assert state[0] == 0.5


def test_a_direction_state_relaxes_by_the_way_travelled():
    x = np.array([0.0, 0.3, 0.3, 0.8, 0.6])
    state = np.array([0.2, 0.0])
    up = 1.0 - 0.8 * np.exp(-0.3 / 0.4)
    more = 1.0 - (1.0 - up) * np.exp(-0.5 / 0.4)
    down = -1.0 + (1.0 + more) * np.exp(-0.2 / 0.4)
    np.testing.assert_allclose(direction_state(x, 0.4, state), [0.2, up, up, more, down])
    np.testing.assert_allclose(state, [down, 0.6])


def test_presses_are_counted_when_they_are_over():
    depth = np.array([0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0, 0.0, 3.0])
    state = np.zeros(2)
    np.testing.assert_array_equal(completed_presses(depth, state), [0, 0, 0, 0, 1, 1, 1, 2, 2])
    np.testing.assert_array_equal(state, [2.0, 1.0])
    np.testing.assert_array_equal(completed_presses(np.array([0.0]), state), [3])


def test_the_largest_so_far_goes_on_over_chunks():
    state = np.array([2.0])
    np.testing.assert_array_equal(largest_so_far(np.array([1.0, 3.0, 2.0]), state), [2.0, 3.0, 3.0])
    assert state[0] == 3.0


def test_a_signal_is_read_at_other_instants_across_chunks():
    t_s, state = np.arange(60) / 10.0, {}
    values = np.sin(t_s)
    parts = [read_at(t_s[a:b], values[a:b], t_s[a:b] - 0.25, state) for a, b in ((0, 7), (7, 8), (8, 33), (33, 60))]
    np.testing.assert_allclose(np.concatenate(parts), np.interp(t_s - 0.25, t_s, values), atol=1e-12)
    assert len(state["t_s"]) < 8


# Mechanics.


@pytest.mark.parametrize("softness", [(0.2, 0.0, 0.0), (0.2, 0.7, 0.0), (0.0, 0.0, 0.15), (0.2, 0.7, 0.15)])
def test_a_soft_contact_solves_its_equation(softness):
    toe, tail, compliance = softness

    def rest(x):
        if toe == 0.0:
            return 0.0
        return np.exp(-x / toe) if tail == 0.0 else (1.0 + tail * x / toe) ** (-1.0 / tail)

    def depth(travel):
        def deformation(x):
            return x - toe * (1.0 - rest(x))

        def missed(x):
            d = deformation(x)
            return x + compliance * (1.1 * d + 0.1 * d**3) - travel

        return deformation(brentq(missed, 0.0, travel + 1e-9, xtol=1e-14)) if travel > 0 else 0.0

    expected = [depth(travel) for travel in DEPTH_mm]
    np.testing.assert_allclose(soft_contact(DEPTH_mm, softness, 1.1, 0.1), expected, atol=1e-9)


def test_an_elastic_force_is_its_polynomial():
    np.testing.assert_allclose(elastic_force(DEPTH_mm, 1.1, 0.1), FORCE_N)
    np.testing.assert_allclose(elastic_force_at(STAGE_mm, BASE), FORCE_N)


def test_a_joint_that_closes_is_frame_and_toe():
    force, _ = run("frame_compliance", "joint that closes", c_f=0.05, l=0.1)
    d = np.array([brentq(lambda f, x=x: 1.1 * f + 0.1 * f**3 - x, 0, 5) for x in force])
    x = DEPTH_mm - 0.05 * force
    inside = x > 0
    np.testing.assert_allclose(d[inside], (x - 0.1 * (1.0 - np.exp(-x / 0.1)))[inside], atol=1e-7)


def test_two_of_one_are_their_sum():
    force, _ = run("contact_shift", "two settling times", s=0.1, tau=0.5, s2=-0.05, tau2=4.0)
    d = np.maximum(0.0, STAGE_mm - 0.3 - 0.1 * (1 - np.exp(-T / 0.5)) + 0.05 * (1 - np.exp(-T / 4.0)))
    np.testing.assert_allclose(force, 1.1 * d + 0.1 * d**3, atol=1e-12)
    force, _ = run("stress_relaxation", "two relaxation times", g=0.1, tau=0.3, g2=0.2, tau2=3.0)
    expected = FORCE_N - 0.1 * low_passed(FORCE_N, 0.3) - 0.2 * low_passed(FORCE_N, 3.0)
    np.testing.assert_allclose(force, np.maximum(0.0, expected), atol=1e-5)
    _, output = run("channel_creep", "two creep times", c=0.1, tau=0.3, c2=0.2, tau2=3.0)
    sensed_N = 0.7 * FORCE_N + 0.1 * low_passed(FORCE_N, 0.3) + 0.2 * low_passed(FORCE_N, 3.0)
    np.testing.assert_allclose(output, volt(resistance(sensed_N)), atol=1e-5)
    force, _ = run("loadcell_creep", "two creep times", k=0.05, tau=0.5, k2=0.1, tau2=3.0)
    np.testing.assert_allclose(
        force, FORCE_N + 0.05 * low_passed(FORCE_N, 0.5) + 0.1 * low_passed(FORCE_N, 3.0), atol=1e-5
    )


def loop(x, scale):
    """z by its exact solution between two samples."""
    z, out = 0.0, [0.0]
    for before, after in zip(x[:-1], x[1:], strict=True):
        way = np.sign(after - before)
        z = way + (z - way) * np.exp(-abs(after - before) / scale)
        out.append(z)
    return np.array(out)


def test_two_loops_are_their_sum():
    force, _ = run("mechanical_hysteresis", "two loops", a=0.05, d0=0.2, a2=0.1, d02=1.0)
    np.testing.assert_allclose(force, FORCE_N * (1 + 0.05 * loop(DEPTH_mm, 0.2) + 0.1 * loop(DEPTH_mm, 1.0)), atol=1e-9)
    _, output = run("channel_hysteresis", "two loops", a=0.05, f0=0.5, a2=0.1, f02=2.0)
    sensed_N = FORCE_N * (1 + 0.05 * loop(FORCE_N, 0.5) + 0.1 * loop(FORCE_N, 2.0))
    np.testing.assert_allclose(output, volt(resistance(sensed_N)), atol=1e-8)


def stop(x, width):
    """x less a play of this width that starts one width below x."""
    y, out = x[0] - width, []
    for now in x:
        y = min(max(y, now - width), now)
        out.append(now - y)
    return np.array(out)


WEIGHTS = {"w0": 0.1, "w1": -0.05, "w2": 0.2, "w3": 0.15}


def test_stop_operators_are_a_sum_of_stops():
    max_N = float(FORCE_N.max())
    added = sum(w * stop(FORCE_N, share * max_N) for w, share in zip(WEIGHTS.values(), STOPS, strict=True))
    force, _ = run("mechanical_hysteresis", "stop operators on the force", **WEIGHTS, reach_N=max_N)
    np.testing.assert_allclose(force, np.maximum(0.0, FORCE_N + (DEPTH_mm > 0) * added), atol=1e-9)
    _, output = run("channel_hysteresis", "stop operators on the force", **WEIGHTS, reach_N=max_N)
    np.testing.assert_allclose(output, volt(resistance(FORCE_N + added)), atol=1e-8)
    max_mm = float(DEPTH_mm.max())
    bent = sum(w * stop(DEPTH_mm, share * max_mm) for w, share in zip(WEIGHTS.values(), STOPS, strict=True))
    values = {**WEIGHTS, "reach_mm": max_mm, "stiffness_N_mm": 1.7}
    force, _ = run("mechanical_hysteresis", "stop operators on the compression", **values)
    np.testing.assert_allclose(force, np.maximum(0.0, FORCE_N + (DEPTH_mm > 0) * 1.7 * bent), atol=1e-9)


@pytest.mark.parametrize("cause", ["mechanical_hysteresis", "channel_hysteresis"])
def test_constants_are_read_off_the_run_where_a_fit_gives_none(cause):
    for form in (f.effect for f in EFFECTS[cause].forms if f.effect.constants):
        read = {"reach_N": FORCE_N.max(), "reach_mm": DEPTH_mm.max(), "stiffness_N_mm": FORCE_N.max() / DEPTH_mm.max()}
        results = []
        for constants in ((), tuple(read[name] for name, _ in form.constants)):
            flow = Flow(T, np.diff(T, prepend=0.0), STAGE_mm, None, 5.0)
            chain = Chain([form])
            chain.run(flow, BASE, FINE, [(*WEIGHTS.values(), *constants)], chain.fresh_memories())
            results.append((flow.force_N, flow.output_V))
        np.testing.assert_allclose(results[0], results[1])


def test_softening_has_three_laws():
    is_over = (DEPTH_mm[1:] == 0.0) & (DEPTH_mm[:-1] > 0.0)
    press_counts = np.concatenate([[0.0], np.cumsum(is_over)])
    force, _ = run("mullins_softening", "power of the presses", m=0.3, N0=2.0, power=0.5)
    np.testing.assert_allclose(force, FORCE_N * (1 - 0.3 * (1 - (1 + press_counts / 2.0) ** -0.5)), atol=1e-9)
    force, _ = run("mullins_softening", "softening with the deepest press so far", m=0.3, depth=2.0)
    deepest = np.maximum.accumulate(DEPTH_mm)
    np.testing.assert_allclose(force, FORCE_N * (1 - 0.3 * (1 - np.exp(-deepest / 2.0))), atol=1e-9)


# Transduction.


def test_a_shut_channel_does_not_change_its_sign():
    drive = np.array([0.0, 5.0, 0.98 / 0.06, 30.0])
    np.testing.assert_allclose(channel_resistance(drive, 4.0, 0.06), [4.0, 4 / 0.7, 4 / COLLAPSED, 4 / COLLAPSED])


def test_a_collapse_of_any_power():
    _, output = run("channel_collapse", "power law", beta=0.1, Fc=2.0, power=3.0)
    np.testing.assert_allclose(
        output, volt(resistance(FORCE_N) * (1 + 0.1 * np.maximum(0.0, FORCE_N - 2.0) ** 3)), atol=1e-8
    )


def test_temperature_may_act_late_and_nonlinearly():
    warm_C = 22.0 + 2.0 * np.sin(T)
    _, output = run(
        "thermal_drift", "curved, felt with a delay", temperature_C=warm_C, alpha=0.002, alpha2=0.001, tau=0.5
    )
    sensed_C = low_passed(warm_C - 22.0, 0.5)
    np.testing.assert_allclose(
        output, volt(resistance(FORCE_N) * (1 + 0.002 * sensed_C + 0.001 * sensed_C**2)), atol=1e-6
    )
    _, at_once = run(
        "thermal_drift", "curved, felt with a delay", temperature_C=warm_C, alpha=0.002, alpha2=0.001, tau=0.0
    )
    rise = warm_C - 22.0
    np.testing.assert_allclose(at_once, volt(resistance(FORCE_N) * (1 + 0.002 * rise + 0.001 * rise**2)), atol=1e-8)
    np.testing.assert_allclose(run("thermal_drift", alpha=0.01)[1], CLEAN_V, atol=1e-8)


@pytest.mark.parametrize("power", [0.5, -1.0, 0.0])
def test_ageing_by_a_power(power):
    _, output = run("ageing_drift", "power law", gamma=0.01, tau=2.0, power=power)
    x = 1.0 + T / 2.0
    aged = np.log(x) if power == 0.0 else (x**power - 1.0) / power
    np.testing.assert_allclose(output, volt(resistance(FORCE_N) * (1 + 0.01 * aged)), atol=1e-8)


def test_a_contact_is_unforeseeable_where_it_opens_or_closes():
    flow = Flow(T, np.diff(T, prepend=0.0), STAGE_mm, None, 5.0, {"intermittent_contact": np.array([[1.0, 1.5]])})
    chain = Chain([EFFECTS["intermittent_contact"]])
    chain.run(flow, BASE, FINE, [(0.7,)], chain.fresh_memories())
    assert flow.is_unforeseeable is not None
    np.testing.assert_array_equal(np.flatnonzero(flow.is_unforeseeable), [100, 150])


# Electronics.


def test_codes_are_rounded_and_clipped():
    readout = ReadoutMetadata(3.0, 2, 10.0, 50.0)
    assert readout.step_V == 1.0
    np.testing.assert_array_equal(
        digitise(np.array([-0.4, 0.4, 0.6, 2.4, 9.0]), np.array([0.0, 0.2, 0.0, 0.05, 0.0]), readout), [0, 1, 1, 2, 3]
    )


def test_a_second_lag_follows_the_first():
    _, output = run("readout_lag", "second order", tau=0.2, tau2=0.1)
    first = REST_V + low_passed(CLEAN_V - REST_V, 0.2)
    np.testing.assert_allclose(output, REST_V + low_passed(first - REST_V, 0.1), atol=1e-5)


def test_a_sampled_lag_answers_later():
    _, output = run("readout_lag", "computed sample by sample", tau=0.2, late=0.5, period_s=0.03)
    first = REST_V + low_passed(CLEAN_V - REST_V, 0.2)
    np.testing.assert_allclose(output[5:], np.interp(T - 0.015, T, first)[5:], atol=1e-5)


def test_drifts_slow_down_by_a_power_or_to_a_stand():
    _, output = run("reference_drift", "power of time", rho=0.001, power=0.7)
    np.testing.assert_allclose(output, CLEAN_V * (1 + 0.001 * 30.0 * (T / 30.0) ** 0.7), atol=1e-8)
    force, _ = run("loadcell_drift", "settling", r=0.01, tau=5.0)
    np.testing.assert_allclose(force, FORCE_N + 0.01 * 5.0 * (1 - np.exp(-T / 5.0)), atol=1e-12)


def test_a_hum_has_a_phase_in_every_run():
    hum = EFFECTS["mains_hum"].of_runs(2)
    assert [p.name for p in hum.parameters] == ["A", "f", "phi0", "phi1"]
    assert [p.weight for p in hum.parameters] == [1.0, 1.0, 0.5, 0.5]
    for run_, phase in ((0, 0.3), (1, 1.1)):
        flow = Flow(T, np.diff(T, prepend=0.0), STAGE_mm, None, 5.0, run=run_)
        chain = Chain([hum])
        chain.run(flow, BASE, FINE, [(0.01, 7.0, 0.3, 1.1)], chain.fresh_memories())
        np.testing.assert_allclose(flow.output_V, CLEAN_V + 0.01 * np.sin(2 * np.pi * 7.0 * T + phase), atol=1e-12)


def test_an_output_may_be_clipped_below_or_softly():
    _, output = run("adc_saturation", V_min=1.6)
    np.testing.assert_allclose(output, np.maximum(CLEAN_V, 1.6), atol=1e-8)
    _, output = run("adc_saturation", "soft clip", V_max=1.6, width=0.05)
    np.testing.assert_allclose(output, 1.6 - 0.05 * np.log1p(np.exp((1.6 - CLEAN_V) / 0.05)), atol=1e-8)
    assert EFFECTS["adc_saturation"].find_side(["V_min"]) is CLIPPED_BELOW
    assert EFFECTS["adc_saturation"].find_side(["V_max"]) is EFFECTS["adc_saturation"]


# Load cell and clock.


def test_a_cell_that_saturates_with_a_knee():
    force, _ = run("loadcell_saturation", "knee", F_sat=5.0, sharpness=3.0)
    np.testing.assert_allclose(force, FORCE_N / (1 + (FORCE_N / 5.0) ** 3) ** (1 / 3), atol=1e-12)
    for form in ("", "knee"):
        effect = EFFECTS["loadcell_saturation"].find_form(form)
        flow = Flow(T, np.diff(T, prepend=0.0), STAGE_mm, None, 5.0)
        chain = Chain([effect])
        chain.run(flow, BASE, FINE, [(np.inf, 3.0)[: len(effect.parameters)]], chain.fresh_memories())
        np.testing.assert_allclose(flow.reading_N, FORCE_N)


def test_a_cell_may_bend_by_a_cubic_and_a_quartic_term():
    values = {"lambda": 0.05, "quadratic": 0.02, "cubic": -0.03}
    force, _ = run("loadcell_nonlinearity", "cubic and quartic term", **values)
    part = FORCE_N / 10.0
    expected = FORCE_N * (1 + 0.05 * (1 - part) + 0.02 * (1 - part**2) - 0.03 * (1 - part**3))
    np.testing.assert_allclose(force, expected, atol=1e-12)


def test_a_clock_may_bend():
    _, output = run("clock_skew", "bending clock", epsilon=-0.01, bend=-1e-3)
    np.testing.assert_allclose(output, np.interp(T * (1 - 0.01 - 1e-3 * T), T, CLEAN_V), atol=1e-8)


def test_a_clock_ahead_is_extrapolated_linearly_at_the_end():
    _, output = run("clock_offset", delta=-0.05)
    np.testing.assert_allclose(output[:-5], CLEAN_V[5:], atol=1e-8)
    slope = (CLEAN_V[-1] - CLEAN_V[-2]) / 0.01
    np.testing.assert_allclose(output[-5:], CLEAN_V[-1] + slope * 0.01 * np.arange(1, 6), atol=1e-8)
    flow = Flow(T, np.diff(T, prepend=0.0), STAGE_mm, None, 5.0)
    chain = Chain([EFFECTS["clock_offset"]])
    chain.run(flow, BASE, FINE, [(-0.05,)], chain.fresh_memories())
    np.testing.assert_array_equal(np.flatnonzero(flow.is_unforeseeable), np.arange(796, 801))


def test_losses_add_up():
    _, output = run("dropped_samples", episodes=((2.0, 3.0), (5.0, 4.0)))
    np.testing.assert_allclose(output[:200], CLEAN_V[:200], atol=1e-8)
    np.testing.assert_allclose(output[200:500], CLEAN_V[203:503], atol=1e-8)
    np.testing.assert_allclose(output[500:794], CLEAN_V[507:801], atol=1e-8)


def test_a_loss_beside_a_contact_hides_what_stands_beside_a_step():
    bad = {"intermittent_contact": np.array([[1.0, 1.5]]), "dropped_samples": np.array([[0.5, 10.0]])}
    flow = Flow(T, np.diff(T, prepend=0.0), STAGE_mm, None, 5.0, bad)
    chain = Chain([EFFECTS["dropped_samples"], EFFECTS["intermittent_contact"]])
    chain.run(flow, BASE, FINE, [(5.0,), (0.7,)], chain.fresh_memories())
    unknown = np.flatnonzero(flow.is_unforeseeable)
    # Ten samples earlier, and what is interpolated across the step; the end is past what was read.
    assert {90, 140} <= set(unknown) <= {89, 90, 91, 139, 140, 141, *range(791, 801)}
    assert set(range(791, 801)) <= set(unknown)


# Empirical terms.


def term(target, variable, coefficient=0.1):
    return EmpiricalTerm(target, variable, coefficient, load_N=float(FORCE_N.max()), depth_mm=float(DEPTH_mm.max()))


LOAD, DEPTH = FORCE_N / FORCE_N.max(), DEPTH_mm / DEPTH_mm.max()
RATE = np.diff(LOAD, prepend=0.0) / 0.01
SPEED = np.diff(DEPTH, prepend=0.0) / 0.01
WARM_K = np.sin(T)
COLUMNS = {
    "t": T, "load": LOAD, "load²": LOAD**2, "load³": LOAD**3, "rate": RATE, "T": WARM_K,
    "direction": loop(DEPTH, 0.01) * (DEPTH > 0), "blunt direction": loop(DEPTH, 0.1) * (DEPTH > 0),
    "deepest": np.maximum.accumulate(DEPTH) * (DEPTH > 0), "touch": np.exp(-DEPTH / 0.05) * (DEPTH > 0),
    "acceleration": np.diff(SPEED, prepend=0.0) / 0.01,
    "position": np.maximum(STAGE_mm, 0.3 - DEPTH_mm.max()) / DEPTH_mm.max(),
    **{f"memory(load, {tau:g} s)": low_passed(LOAD, tau) for tau in MEMORY_s},
}  # fmt: skip
COLUMNS["touch·direction"] = COLUMNS["touch"] * COLUMNS["direction"]
COLUMNS |= {name: LOAD * COLUMNS[name.removeprefix("load·")] for name in VARIABLES if name.startswith("load·")}


@pytest.mark.parametrize("name", VARIABLES)
def test_a_term_follows_its_variable(name):
    twin = Twin(BASE, (), FINE, (term("force_N", name),))
    force, _ = simulate(twin, T, STAGE_mm, temperature_C=22.0 + WARM_K)
    tolerance = 1e-6 * max(1.0, np.abs(COLUMNS[name]).max())
    np.testing.assert_allclose(force - FORCE_N, 0.1 * COLUMNS[name], atol=tolerance)


def test_a_term_acts_at_its_place():
    force, output = simulate(Twin(BASE, (), FINE, (term("output_V", "load"),)), T, STAGE_mm)
    np.testing.assert_allclose(force, FORCE_N)
    np.testing.assert_allclose(output, CLEAN_V + 0.1 * LOAD, atol=1e-8)
    force, output = simulate(Twin(BASE, (), FINE, (term("F", "t", -1.0),)), T, STAGE_mm)
    expected_N = np.maximum(0.0, FORCE_N - T * (DEPTH_mm > 0))
    np.testing.assert_allclose(force, expected_N)
    np.testing.assert_allclose(output, volt(resistance(expected_N)), atol=1e-8)


@pytest.mark.parametrize(
    ("target", "variable", "unit"),
    [
        ("F", "t", "N/s"),
        ("force_N", "T", "N/K"),
        ("output_V", "rate", "V·s"),
        ("output_V", "load", "V"),
        ("F", "acceleration", "N·s²"),
    ],
)
def test_a_coefficient_has_the_unit_of_place_over_variable(target, variable, unit):
    assert term(target, variable).unit == unit
    assert term(target, variable).formula == f"{target} += 0.1 {unit} · {variable}"


def test_a_term_that_cannot_be_is_refused():
    for wrong in (
        {"place": "R"},
        {"variable": "luck"},
        {"coefficient": np.nan},
        {"load_N": 0.0},
        {"depth_mm": -1.0},
        {"depth_mm": np.inf},
    ):
        with pytest.raises(InputError):
            replace(term("F", "t"), **wrong)
    (size,) = term("F", "t").effect.parameters
    assert size.low < 0.0 < size.high and size.neutral == 0.0
    assert size.usual == pytest.approx(0.01 * FORCE_N.max())
    assert term("output_V", "t").effect.parameters[0].usual == pytest.approx(0.01)


# Where a search begins.


RANGE = ExcitationRange(
    depth_mm=3.0, force_N=6.0, lowest_V=1.0, highest_V=2.0, duration_s=10.0, period_s=0.02, series_ohm=20.0
)


def test_natural_units_of_a_case_are_its_ratios():
    expected = {"one": 1.0, "depth_mm": 3.0, "force_N": 6.0, "series_ohm": 20.0, "duration_s": 10.0, "period_s": 0.02,
                "softness_mm_N": 0.5, "rate_per_s": 0.1, "force_rate_N_s": 0.6, "period_per_duration": 0.002,
                "per_force2": 1 / 36}  # fmt: skip
    for name, value in expected.items():
        assert RANGE.measure(name) == pytest.approx(value)


def test_probes_are_multiples_of_natural_units():
    assert Sizes((0.5, 2.0), "force_N")(RANGE) == [(3.0,), (12.0,)]
    np.testing.assert_allclose(Shapes(0.1, (0.5, 2.0), "depth_mm", "force_N")(RANGE), [(0.6, 1.5), (0.6, 6.0)])
    assert TimeConstants(0.02)(RANGE) == [(0.02, tau) for tau in TAU_s if tau < 10.0]
    assert TimeConstants(0.02, without=2)(RANGE) == [(0.02, tau) for tau in TAU_s if tau < 10.0][2:]
    assert list(TAU_s) == sorted(TAU_s)
    ratios = np.diff(np.log(TAU_s))
    assert np.all((ratios > np.log(2.5)) & (ratios < np.log(4.5)))


SIZE, SHAPE = Parameter("a", "", 0.0, 1.0, 0.5, neutral=0.0), Parameter("b", "s", 1.0, 8.0, 4.0)


def bare(*parameters, **more):
    return Effect("x", "mechanics", Hook.FORCE, "", "", parameters, lambda flow, v, state: None, **more)


def test_without_probes_of_its_own_a_search_begins_at_a_fifth_of_the_usual_size():
    assert bare(SIZE).probes(RANGE) == [(pytest.approx(0.1),)]
    assert bare(SIZE, SHAPE).probes(RANGE) == [(pytest.approx(0.1), b) for b in (1.0, 4.0, 8.0)]
    wide = bare(SIZE, replace(SHAPE, high=100.0))
    assert [row[1] for row in wide.probes(RANGE)] == [1.0, 4.0, 16.0]
    assert bare(SIZE, signs=Signs(search_target=SearchTarget.LINE)).probes(RANGE) == []
    assert bare(SIZE, signs=Signs(search_target=SearchTarget.LOSSES)).probes(RANGE) == []
    assert len(bare(SIZE, signs=Signs(search_target=SearchTarget.CEILING)).probes(RANGE)) == 1
    doubled = bare(SIZE, SHAPE).probes(RANGE, lambda p: replace(p, usual=2 * p.usual, high=2 * p.high))
    assert doubled == [(pytest.approx(0.2), b) for b in (2.0, 8.0, 16.0)]


def test_what_an_effect_is_follows_from_its_parameters():
    assert bare(SIZE).is_one_sided and not bare(replace(SIZE, low=-1.0)).is_one_sided
    assert bare(Parameter("level", "V", 0.5, 9.0, 2.0, neutral=np.inf)).is_one_sided
    assert bare(SIZE, SHAPE).neutral_values == (0.0, 4.0)
    assert bare(SIZE, is_episodic=True).belongs_to_run
    assert bare(SIZE, of_runs=lambda runs: bare(SIZE)).belongs_to_run and not bare(SIZE).belongs_to_run
    with pytest.raises(ValueError, match="neutral"):
        bare(SHAPE)
    assert bare(SIZE).find_form("") is not None and bare(SIZE).find_form("none") is None


def test_steps_set_add_grow_and_hand_on():
    flow = Flow(T, T, STAGE_mm, None, 5.0)
    flow.force_N = np.full(3, 2.0)
    for step, expected in (
        (set_signal("force_N", lambda flow, v, state: np.full(3, v[0])), 0.5),
        (adds("force_N", lambda flow, v, state: 3.0), 2.0),
        (grows("force_N", lambda flow, v, state: 3.0), 5.0),
    ):
        step(flow, (0.5,), {})
        np.testing.assert_allclose(flow.force_N, expected)
    hands_on("toe_mm", "toe_tail")(flow, (0.1, 0.2), {})
    assert (flow.toe_mm, flow.toe_tail) == (0.1, 0.2)
    with pytest.raises(ValueError):
        hands_on("toe_mm")(flow, (0.1, 0.2), {})
    np.testing.assert_array_equal(flow.warmed_K, np.zeros(801))


@pytest.mark.parametrize("cause", [e for e in EFFECTS.values() if e.forms], ids=lambda e: e.id)
def test_a_form_begins_where_the_catalogue_ended(cause):
    """At the catalogue's values a form adds nothing of its own, or splits what was fitted around its shape."""
    for form in cause.forms:
        values = [p.usual for p in cause.parameters]
        start = form.start(values)
        if form.effect.equation.startswith("two "):
            assert start == pytest.approx([values[0] / 2, values[1] / 4, values[0] / 2, values[1] * 4])
        elif not form.effect.constants and len(start) > len(values):
            assert start[: len(values)] == pytest.approx(values)
        grown = form.start(values, lambda unit: 3.0)
        for (index, number), one, other in zip(form.carry, start, grown, strict=True):
            assert other == pytest.approx(one if index is not None else 3.0 * number)
            assert one == pytest.approx(number if index is None else values[index] * number)


@pytest.mark.parametrize("cause", EFFECTS.values(), ids=lambda e: e.id)
def test_typical_sizes_lie_well_inside_the_bounds(cause):
    for one in (cause, *(f.effect for f in cause.forms)):
        for p in one.parameters:
            assert one is not cause or p.is_fixed or p.low <= p.usual <= p.high
            if p.scale == "log":
                assert p.high / p.usual >= 2.0 and p.usual / p.low >= 2.0


PUBLISHED = {
    ("backlash", "b"): (0.005, 0.15),
    ("frame_compliance", "c_f"): (0.001, 0.05),
    ("stress_relaxation", "g"): (0.02, 0.2),
    ("mechanical_hysteresis", "a"): (0.02, 0.1),
    ("mullins_softening", "m"): (0.05, 0.3),
    ("channel_creep", "c"): (0.01, 0.1),
    ("channel_creep", "tau"): (0.05, 100.0),
    ("channel_hysteresis", "a"): (0.01, 0.05),
    ("thermal_drift", "alpha"): (0.0008, 0.0012),
    ("ageing_drift", "gamma"): (0.001, 0.05),
    ("readout_lag", "tau"): (0.001, 0.3),
    ("wiring_resistance", "Rw"): (0.05, 1.0),
    ("mains_hum", "A"): (0.001, 0.01),
    ("loadcell_nonlinearity", "lambda"): (0.0002, 0.03),
    ("clock_offset", "delta"): (0.001, 0.05),
    ("clock_skew", "epsilon"): (1e-5, 0.01),
    ("dropped_samples", "count"): (1.0, 100.0),
}
"""Sizes that data sheets, standards and papers give, as the sources of the catalogue say."""


@pytest.mark.parametrize(("cause", "name"), PUBLISHED)
def test_published_sizes_lie_within_the_bounds_and_the_usual_among_them(cause, name):
    (p,) = (p for p in EFFECTS[cause].parameters if p.name == name)
    low, high = PUBLISHED[cause, name]
    assert p.low <= low and high <= p.high
    assert low <= p.usual <= high


# Base, readout, records.


@pytest.mark.parametrize("name", ["k1_N_mm", "k3_N_mm3", "r0_ohm", "kappa_per_N", "sigma_output_V", "sigma_force_N"])
def test_base_parameters_are_physical(name):
    for value in (-1e-9, np.nan, np.inf):
        with pytest.raises(InputError, match=name):
            BaseParameters(**{name: value})
    if name == "r0_ohm":
        with pytest.raises(InputError, match="r0_ohm is 0"):
            BaseParameters(r0_ohm=0.0)
    else:
        BaseParameters(**{name: 0.0})
    assert BaseParameters(u0_mm=-1.0).with_values(u0_mm=-2.0).u0_mm == -2.0


def test_readouts_are_physical():
    for name in ("vref_V", "r_series_ohm", "sample_rate_Hz"):
        for value in (0.0, -1.0, np.inf, np.nan):
            with pytest.raises(InputError, match=name):
                ReadoutMetadata(**{name: value})
    for bits in (0, 33):
        with pytest.raises(InputError, match="adc_bits"):
            ReadoutMetadata(adc_bits=bits)
    for bits in (1, 32):
        ReadoutMetadata(adc_bits=bits)
    with pytest.raises(InputError, match="sensor_type"):
        ReadoutMetadata(sensor_type="optical")
    assert ReadoutMetadata(vref_V=5.0, adc_bits=10).step_V == 5.0 / 1023


def test_the_default_pad_is_as_its_docstring_says():
    """EGaIn in Ecoflex, about 7 N at 3.5 mm."""
    assert elastic_force_at(np.array([3.5]), BaseParameters())[0] == pytest.approx(7.0, abs=0.5)


def test_a_twin_goes_through_its_record():
    twin = Twin(
        BASE,
        (EffectSetting("stress_relaxation", {"g": 0.1}), EffectSetting("dropped_samples", {}, ((1.0, 2.0),))),
        FINE,
    )
    record = twin_record(twin)
    assert record["schema"] == "softcal.twin/1" and record["empirical"] == []
    again = twin_from_record(record, "here")
    assert again == twin
    richer = replace(twin, empirical=(term("F", "t"),))
    assert twin_from_record(twin_record(richer), "here") == richer
    formed = replace(twin, effects=(EffectSetting("readout_lag", {"tau": 0.1, "tau2": 0.2}, form="second order"),))
    assert twin_from_record(twin_record(formed), "here") == formed
    for wrong in (
        {**record, "schema": "softcal.twin/9"}, {k: v for k, v in record.items() if k != "metadata"},
        {**record, "parameters": {"k": 1.0}}, {**record, "effects": 3},
        {**twin_record(richer), "empirical": [{**twin_record(richer)["empirical"][0], "unit": "V"}]},
    ):  # fmt: skip
        with pytest.raises(InputError, match="here|coefficient"):
            twin_from_record(wrong, "here")
    assert twin.clean == Twin(BASE, (), FINE)


def test_a_setting_is_checked_and_completed():
    setting = EffectSetting("stress_relaxation", {"g": 0.2})
    assert setting.ordered_values == (0.2, [p.usual for p in EFFECTS["stress_relaxation"].parameters][1])
    with pytest.raises(InputError, match="finite"):
        EffectSetting("stress_relaxation", {"g": np.inf})
    with pytest.raises(InputError, match="reach_N is missing"):
        EffectSetting("mechanical_hysteresis", {"w0": 0.1}, form="stop operators on the force")
    with pytest.raises(InputError, match="no form"):
        EffectSetting("backlash", {}, form="rust")


def test_effects_of_one_hook_act_in_the_order_of_the_catalogue():
    both = (
        EffectSetting("adc_saturation", {"V_max": 1.6}),
        EffectSetting("mains_hum", {"A": 0.05, "f": 7.0, "phi": 0.0}),
    )
    _, output = simulate(Twin(BASE, both, FINE), T, STAGE_mm)
    np.testing.assert_allclose(output, np.minimum(CLEAN_V + 0.05 * np.sin(2 * np.pi * 7.0 * T), 1.6), atol=1e-8)
    _, other = simulate(Twin(BASE, both[::-1], FINE), T, STAGE_mm)
    np.testing.assert_array_equal(other, output)


def test_a_stream_goes_on_and_starts_again():
    stream = TwinStream(Twin(BASE, (EffectSetting("thermal_drift", {"alpha": 0.002}),), FINE), None)
    warm_C = 22.0 + T
    whole = stream.advance(T, STAGE_mm, warm_C)
    with pytest.raises(ValueError, match="later"):
        stream.advance(T[-1:], STAGE_mm[-1:])
    stream.restart()
    parts = [stream.advance(T[a:b], STAGE_mm[a:b], warm_C[a:b]) for a, b in ((0, 1), (1, 300), (300, 801))]
    np.testing.assert_allclose(np.concatenate(parts, axis=1), whole, atol=1e-12)
    assert [len(v) for v in stream.advance(T[:0], STAGE_mm[:0])] == [0, 0]
    with pytest.raises(ValueError, match="samples"):
        stream.advance(T, STAGE_mm[:-1])
    stream.restart()
    with pytest.raises(ValueError, match="later"):
        stream.advance(T[[0, 1, 1]], STAGE_mm[:3])


def test_noise_is_drawn_per_channel_by_its_own_size():
    readout = ReadoutMetadata(5.0, 24, 10.0, 100.0)
    base = replace(BASE, sigma_output_V=0.003, sigma_force_N=0.05)
    force, output = simulate(
        Twin(base, (), readout), np.arange(20000) / 100.0, np.zeros(20000), np.random.default_rng(1)
    )
    assert (force.std(), output.std()) == pytest.approx((0.05, 0.003), rel=0.03)
    assert abs(np.corrcoef(force, output)[0, 1]) < 0.03


def test_a_run_begins_at_its_first_instant():
    moved = simulate(Twin(BASE, (EffectSetting("loadcell_drift", {"r": 0.01}),), FINE), T + 100.0, STAGE_mm)
    np.testing.assert_allclose(moved[0], FORCE_N + 0.01 * T, atol=1e-9)


# The properties find what is wrong.


GOOD = Effect("wear", "mechanics", Hook.FORCE, "F·(1 − w)", "", (Parameter("w", "", 0.0, 0.9, 0.1, neutral=0.0),),
              lambda flow, v, state: setattr(flow, "force_N", flow.force_N * (1.0 - v[0])))  # fmt: skip


def doing(change, **more):
    return replace(GOOD, step=lambda flow, v, state: change(flow, v), **more)


def drags(flow, v):
    flow.force_N = flow.force_N - v[0] * flow.force_N + 1e-3


def infinite(flow, v):
    flow.force_N = flow.force_N * np.where(v[0] > 0.89, np.inf, 1.0)


def infinite_below(flow, v):
    flow.force_N = flow.force_N * np.where(v[0] < 0.01, np.nan, 1.0)


def hardly(flow, v):
    flow.force_N = flow.force_N * (1.0 + 1e-4 * v[0])


def backwards(flow, v):
    flow.reading_N = flow.reading_N * (1.0 - v[0])
    flow.output_V = flow.output_V * (1.0 + v[0])


def reads_force(flow, v):
    flow.force_N = flow.force_N * (1.0 + v[0])


BROKEN = [
    (properties.switched_off_it_changes_nothing, doing(drags)),
    (properties.at_its_usual_size_it_shows, doing(hardly)),
    (properties.it_stays_finite_within_its_bounds, doing(infinite)),
    (properties.it_stays_finite_within_its_bounds, doing(infinite_below)),
    (properties.it_acts_where_it_says, doing(backwards, hook=Hook.READING, stage="load_cell")),
    (properties.it_acts_where_it_says, doing(reads_force, stage="transduction")),
    (properties.it_acts_where_it_says, doing(reads_force, hook=Hook.CHANNEL, stage="transduction")),
    (properties.a_search_finds_where_to_begin, replace(GOOD, signs=Signs(probes=lambda at: []))),
    (properties.a_search_finds_where_to_begin, replace(GOOD, signs=Signs(probes=lambda at: [(0.91,)]))),
    (properties.a_search_finds_where_to_begin, replace(GOOD, signs=Signs(probes=lambda at: [(-0.01,)]))),
    (properties.a_search_finds_where_to_begin, replace(GOOD, is_episodic=True)),
]  # fmt: skip


@pytest.mark.parametrize(("holds", "broken"), BROKEN, ids=lambda x: getattr(x, "__name__", ""))
def test_a_broken_effect_is_reported(holds, broken):
    with pytest.raises(Violation, match="wear"):
        holds(broken)


@pytest.mark.parametrize("holds", PROPERTIES, ids=lambda holds: holds.__name__)
def test_a_good_effect_satisfies_all(holds):
    holds(GOOD)


@pytest.mark.parametrize("end", [0.0, 0.9])
def test_probes_on_a_bound_are_within(end):
    properties.a_search_finds_where_to_begin(replace(GOOD, signs=Signs(probes=lambda at: [(end,)])))
