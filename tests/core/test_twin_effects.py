"""Every effect against a closed form or an independent integration of its own equation in the catalogue."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from softcal.core.errors import InputError
from softcal.core.twin.catalogue import EFFECTS, effect
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

BASE = BaseParameters(u0_mm=0.3, k1_N_mm=1.1, k3_N_mm3=0.1, r0_ohm=4.0, kappa_per_N=0.06)
FINE = ReadoutMetadata(vref_V=5.0, adc_bits=32, r_series_ohm=10.0, sample_rate_Hz=100.0)
RATE_Hz, HALF_s, SPEED_mm_s = 100.0, 2.0, 1.5
T = np.arange(int(8 * RATE_Hz) + 1) / RATE_Hz


def stage_mm(t_s):
    """Two triangles of 2 s up and 2 s down, 3 mm deep."""
    return SPEED_mm_s * np.minimum(np.mod(t_s, 2 * HALF_s), 2 * HALF_s - np.mod(t_s, 2 * HALF_s))


def depth_mm(t_s):
    return np.maximum(0.0, stage_mm(t_s) - BASE.u0_mm)


def force_N(t_s):
    d = depth_mm(t_s)
    return BASE.k1_N_mm * d + BASE.k3_N_mm3 * d**3


def volt(resistance):
    return 5.0 * resistance / (resistance + 10.0)


def resistance(force):
    return 4.0 / (1.0 - 0.06 * force)


def run(effect_id, episodes=(), temperature_C=None, **values):
    twin = Twin(BASE, (EffectSetting(effect_id, values, episodes),), FINE)
    return simulate(twin, T, stage_mm(T), temperature_C=temperature_C)


def low_passed(signal, tau_s):
    """Integrate τ·dy/dt = x − y with SciPy, independent of the recursion."""
    solution = solve_ivp(lambda t, y: (signal(t) - y) / tau_s, (0, T[-1]), [0.0], t_eval=T, max_step=0.01, rtol=1e-9)
    return solution.y[0]


def test_the_base_twin_is_its_equations():
    force, output = simulate(Twin(BASE, (), FINE), T, stage_mm(T))
    np.testing.assert_allclose(force, force_N(T), atol=1e-12)
    np.testing.assert_allclose(output, volt(resistance(force_N(T))), atol=1e-8)


def test_a_strain_sensor_follows_deformation():
    twin = Twin(BASE, (), ReadoutMetadata(5.0, 32, 10.0, RATE_Hz, "strain"))
    np.testing.assert_allclose(simulate(twin, T, stage_mm(T))[1], volt(resistance(depth_mm(T))), atol=1e-8)


def test_noise_and_adc_are_those_of_the_parameters():
    coarse = ReadoutMetadata(vref_V=5.0, adc_bits=10, r_series_ohm=10.0, sample_rate_Hz=RATE_Hz)
    force, output = simulate(Twin(BASE, (), coarse), T, np.zeros(len(T)), np.random.default_rng(1))
    assert force.std() == pytest.approx(BASE.sigma_force_N, rel=0.1)
    np.testing.assert_allclose(output / coarse.step_V, np.round(output / coarse.step_V), atol=1e-9)


def test_backlash_flattens_the_turn_and_shifts_the_way_back():
    force, _ = run("backlash", b=0.1)
    rising, falling = (T > 0.5) & (T < 1.9), (T > 2.2) & (T < 3.5)
    lag_mm = np.array([brentq(lambda d, f=f: 1.1 * d + 0.1 * d**3 - f, 0, 5) for f in force[falling]])
    np.testing.assert_allclose(lag_mm - (stage_mm(T[falling]) - 0.3), 0.0, atol=1e-9)
    down_mm = np.maximum(0.0, stage_mm(T[rising]) - 0.1 - 0.3)
    np.testing.assert_allclose(force[rising], 1.1 * down_mm + 0.1 * down_mm**3, atol=1e-9)


def test_contact_shift_settles_exponentially():
    force, _ = run("contact_shift", s=0.2, tau=3.0)
    d = np.maximum(0.0, stage_mm(T) - 0.3 - 0.2 * (1 - np.exp(-T / 3.0)))
    np.testing.assert_allclose(force, 1.1 * d + 0.1 * d**3, atol=1e-12)


def test_frame_compliance_solves_its_implicit_equation():
    force, _ = run("frame_compliance", c_f=0.05)
    d = np.maximum(0.0, stage_mm(T) - 0.3 - 0.05 * force)
    np.testing.assert_allclose(force, 1.1 * d + 0.1 * d**3, atol=1e-7)


def test_misaligned_contact_lands_softly():
    force, _ = run("misaligned_contact", l=0.4)
    d = depth_mm(T) - 0.4 * (1 - np.exp(-depth_mm(T) / 0.4))
    np.testing.assert_allclose(force, 1.1 * d + 0.1 * d**3, atol=1e-9)


def test_stress_relaxation_takes_away_the_low_passed_force():
    force, _ = run("stress_relaxation", g=0.2, tau=1.3)
    np.testing.assert_allclose(force, np.maximum(0.0, force_N(T) - 0.2 * low_passed(force_N, 1.3)), atol=2e-4)


def loop(signal, scale):
    """Integrate dz/dx = (1 − z·sign(dx))/scale by small Euler steps between samples."""
    z, out = 0.0, [0.0]
    for before, after in zip(signal[:-1], signal[1:], strict=True):
        for _ in range(200):
            step = (after - before) / 200
            z += step / scale * (1 - z * np.sign(step))
        out.append(z)
    return np.array(out)


def test_mechanical_hysteresis_follows_its_differential_equation():
    force, _ = run("mechanical_hysteresis", a=0.1, d0=0.4)
    np.testing.assert_allclose(force, force_N(T) * (1 + 0.1 * loop(depth_mm(T), 0.4)), atol=1e-4)


def test_mullins_softening_counts_completed_presses():
    force, _ = run("mullins_softening", m=0.3, N0=2.0)
    completed_presses = np.where(T < 2 * HALF_s - 0.2, 0, 1)
    completed_presses[-1] = 2
    np.testing.assert_allclose(force, force_N(T) * (1 - 0.3 * (1 - np.exp(-completed_presses / 2.0))), atol=1e-9)


def test_channel_creep_mixes_force_and_low_passed_force():
    _, output = run("channel_creep", c=0.3, tau=0.9)
    mixed_force_N = 0.7 * force_N(T) + 0.3 * low_passed(force_N, 0.9)
    np.testing.assert_allclose(output, volt(resistance(mixed_force_N)), atol=5e-5)


def test_channel_hysteresis_follows_its_differential_equation():
    _, output = run("channel_hysteresis", a=0.05, f0=1.0)
    np.testing.assert_allclose(output, volt(resistance(force_N(T) * (1 + 0.05 * loop(force_N(T), 1.0)))), atol=1e-4)


def test_channel_collapse_bends_the_top():
    _, output = run("channel_collapse", beta=0.1, Fc=2.0)
    over = np.maximum(0.0, force_N(T) - 2.0)
    np.testing.assert_allclose(output, volt(resistance(force_N(T)) * (1 + 0.1 * over**2)), atol=1e-8)


def test_thermal_drift_follows_the_recorded_temperature():
    temperature_C = 22.0 + 2.0 * T
    _, output = run("thermal_drift", temperature_C=temperature_C, alpha=0.002)
    np.testing.assert_allclose(output, volt(resistance(force_N(T)) * (1 + 0.004 * T)), atol=1e-8)


def test_ageing_drift_is_logarithmic():
    _, output = run("ageing_drift", gamma=0.01, tau=2.0)
    np.testing.assert_allclose(output, volt(resistance(force_N(T)) * (1 + 0.01 * np.log(1 + T / 2.0))), atol=1e-8)


def test_intermittent_contact_adds_a_step_in_its_intervals_only():
    _, output = run("intermittent_contact", episodes=((1.0, 1.5), (5.0, 5.25)), dR=0.7)
    bad = ((T >= 1.0) & (T < 1.5)) | ((T >= 5.0) & (T < 5.25))
    np.testing.assert_allclose(output, volt(resistance(force_N(T)) + 0.7 * bad), atol=1e-8)


def test_readout_lag_is_a_first_order_low_pass_that_starts_settled():
    _, output = run("readout_lag", tau=0.25)
    rest_V = volt(4.0)
    expected = rest_V + low_passed(lambda t: volt(resistance(force_N(t))) - rest_V, 0.25)
    np.testing.assert_allclose(output, expected, atol=2e-4)


def test_wiring_resistance_stands_in_series():
    np.testing.assert_allclose(run("wiring_resistance", Rw=0.8)[1], volt(resistance(force_N(T)) + 0.8), atol=1e-8)


def test_reference_drift_scales_the_output_with_time():
    expected = volt(resistance(force_N(T))) * (1 + 0.001 * T)
    np.testing.assert_allclose(run("reference_drift", rho=0.001)[1], expected, atol=1e-8)


def test_mains_hum_is_a_sine_on_the_output():
    expected = volt(resistance(force_N(T))) + 0.01 * np.sin(2 * np.pi * 10.0 * T + 0.5)
    np.testing.assert_allclose(run("mains_hum", A=0.01, f=10.0, phi=0.5)[1], expected, atol=1e-8)


def test_adc_saturation_clips_the_output():
    np.testing.assert_allclose(
        run("adc_saturation", V_max=1.6)[1], np.minimum(volt(resistance(force_N(T))), 1.6), atol=1e-8
    )


def test_load_cell_effects_are_their_formulas():
    F = force_N(T)
    np.testing.assert_allclose(run("loadcell_saturation", F_sat=6.0)[0], 6.0 * np.tanh(F / 6.0), atol=1e-12)
    np.testing.assert_allclose(
        run("loadcell_nonlinearity", **{"lambda": 0.05})[0], F + 0.05 * F * (1 - F / 10.0), atol=1e-12
    )
    np.testing.assert_allclose(run("loadcell_creep", k=0.1, tau=2.0)[0], F + 0.1 * low_passed(force_N, 2.0), atol=1e-4)
    np.testing.assert_allclose(run("loadcell_drift", r=0.01)[0], F + 0.01 * T, atol=1e-12)


def test_clock_offset_reads_the_output_of_an_earlier_instant():
    _, output = run("clock_offset", delta=0.05)
    inside = T > 0.1
    np.testing.assert_allclose(output[inside], volt(resistance(force_N(T[inside] - 0.05))), atol=1e-8)


def test_clock_skew_stretches_the_time_of_the_output():
    _, output = run("clock_skew", epsilon=-0.01)
    np.testing.assert_allclose(output, volt(resistance(force_N(T * 0.99))), atol=1e-3)


def test_dropped_samples_close_up():
    _, output = run("dropped_samples", episodes=((3.0, 7.0),), count=7.0)
    _, whole = simulate(Twin(BASE, (), FINE), T, stage_mm(T))
    row_lost = int(3.0 * RATE_Hz)
    np.testing.assert_allclose(output[:row_lost], whole[:row_lost], atol=1e-9)
    np.testing.assert_allclose(output[row_lost : len(T) - 7], whole[row_lost + 7 :], atol=1e-8)


def test_every_effect_says_what_it_is():
    for effect_id, entry in EFFECTS.items():
        assert entry.id == effect_id and entry.equation and entry.source
        fixed, fitted = ([p for p in entry.parameters if p.is_fixed is side] for side in (True, False))
        assert all(p.low < p.high and p.low <= p.usual <= p.high for p in fitted)
        assert all(p.low == p.usual == p.high and p.weight == 0.0 for p in fixed)
        assert not entry.parameters[0].is_fixed


def test_unknown_effects_and_parameters_are_refused_by_name():
    with pytest.raises(InputError, match="'rust'"):
        effect("rust")
    with pytest.raises(InputError, match="'width'"):
        EffectSetting("backlash", {"width": 1.0})
    with pytest.raises(InputError):
        Twin(BASE, (EffectSetting("backlash"), EffectSetting("backlash")))
