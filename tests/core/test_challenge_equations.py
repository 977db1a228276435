"""The generator of sealed cases against the twin's written equations, in closed form or by SciPy."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from softcal.core.challenge.cases import EQUATIONS
from softcal.core.challenge.equations import OTHER_FORMS
from softcal.core.challenge.rig import (
    DEAD_WEIGHTS,
    DUMMY_RESISTOR,
    RIGID_BLOCK,
    Cause,
    Measured,
    Path,
    Rack,
    Rig,
    record,
)
from softcal.core.recording import Array

RIG = Rig(
    u0_mm=0.3,
    k1_N_mm=1.2,
    k3_N_mm3=0.15,
    r0_ohm=4.0,
    kappa_per_N=0.06,
    noise_V=0.0,
    noise_N=0.0,
    vref_V=3.3,
    r_series_ohm=10.0,
    adc_bits=30,
    sample_rate_Hz=50.0,
)
SPEED_mm_s = 0.5
UP = Path("up", np.array([0.0, 5.0]), np.array([0.0, 5.0 * SPEED_mm_s]))
TRIANGLES = Path("triangles", np.arange(0.0, 26.0, 5.0), np.array([0.0, 2.5, 0.0, 2.5, 0.0, 2.5]))
HOLD = Path("hold", np.array([0.0, 1.0, 30.0]), np.array([0.0, 2.3, 2.3]))


def measure(path: Path, *causes: Cause, rig: Rig = RIG, **special: object) -> Measured:
    return record(rig, Rack(causes, EQUATIONS), path, lambda t_s: 20.0 + 0.3 * t_s, np.random.default_rng(1), **special)


def columns(path: Path, effect: str, rig: Rig = RIG, **values: float) -> Mapping[str, Array]:
    return measure(path, Cause(effect, "catalogue", values), rig=rig).columns


def pad(compression_mm: Array) -> Array:
    return 1.2 * compression_mm + 0.15 * compression_mm**3


def volts(
    force_N: Array, r0_ohm: float | Array = 4.0, lead_ohm: float | Array = 0.0, vref_V: float | Array = 3.3
) -> Array:
    ohm = r0_ohm / (1.0 - 0.06 * force_N) + lead_ohm
    return vref_V * ohm / (ohm + 10.0)


def compression(t_s: Array) -> Array:
    return np.maximum(0.0, SPEED_mm_s * t_s - 0.3)


def test_base_model_is_the_written_one() -> None:
    measured = measure(UP).columns
    force_N = pad(compression(measured["t_s"]))
    np.testing.assert_allclose(measured["force_N"], force_N, atol=1e-12)
    np.testing.assert_allclose(measured["output_V"], volts(force_N), atol=1e-8)


FORCE: list[tuple[str, dict[str, float], Callable[[Array], Array]]] = [
    ("backlash", {"width_mm": 0.1}, lambda t: pad(np.maximum(0.0, SPEED_mm_s * t - 0.1 - 0.3))),
    (
        "contact_shift",
        {"shift_mm": 0.2, "tau_s": 2.0},
        lambda t: pad(np.maximum(0.0, SPEED_mm_s * t - 0.3 - 0.2 * (1 - np.exp(-t / 2)))),
    ),
    (
        "misaligned_contact",
        {"length_mm": 0.4},
        lambda t: pad(compression(t) - 0.4 * (1 - np.exp(-compression(t) / 0.4))),
    ),
    (
        "mechanical_hysteresis",
        {"size": 0.1, "scale_mm": 0.4},
        lambda t: pad(compression(t)) * (1 + 0.1 * (1 - np.exp(-compression(t) / 0.4))),
    ),
    ("loadcell_saturation", {"saturation_N": 6.0}, lambda t: 6.0 * np.tanh(pad(compression(t)) / 6.0)),
    (
        "loadcell_nonlinearity",
        {"size": 0.05, "capacity_N": 10.0},
        lambda t: pad(compression(t)) * (1.05 - 0.005 * pad(compression(t))),
    ),
    ("loadcell_drift", {"rate_N_per_s": 0.02}, lambda t: pad(compression(t)) + 0.02 * t),
]


@pytest.mark.parametrize(("effect", "values", "expected"), FORCE, ids=[row[0] for row in FORCE])
def test_force_of_a_rising_ramp_follows_the_closed_form(
    effect: str, values: dict[str, float], expected: Callable[[Array], Array]
) -> None:
    measured = columns(UP, effect, **values)
    # The contact falls between two grid points; z and LP see its first 2 ms as a straight line.
    np.testing.assert_allclose(measured["force_N"], expected(measured["t_s"]), atol=2e-4)


def _hysteresis_load(t_s: Array) -> Array:
    force_N = pad(compression(t_s))
    return force_N * (1 + 0.08 * (1 - np.exp(-force_N / 0.9)))


OUTPUT: list[tuple[str, dict[str, float], Callable[[Array], Array]]] = [
    ("channel_hysteresis", {"size": 0.08, "scale_N": 0.9}, lambda t: volts(_hysteresis_load(t))),
    ("thermal_drift", {"coefficient_per_K": 0.01}, lambda t: volts(pad(compression(t)), 4.0 * (1 + 0.003 * t))),
    (
        "ageing_drift",
        {"size": 0.02, "tau_s": 1.5},
        lambda t: volts(pad(compression(t)), 4.0 * (1 + 0.02 * np.log(1 + t / 1.5))),
    ),
    ("wiring_resistance", {"wire_ohm": 0.7}, lambda t: volts(pad(compression(t)), lead_ohm=0.7)),
    ("reference_drift", {"rate_per_s": 0.004}, lambda t: volts(pad(compression(t)), vref_V=3.3 * (1 + 0.004 * t))),
    ("adc_saturation", {"low_V": 1.0, "high_V": 1.1}, lambda t: np.clip(volts(pad(compression(t))), 1.0, 1.1)),
    ("clock_offset", {"delay_s": 0.07}, lambda t: volts(pad(compression(t - 0.07)))),
    ("clock_skew", {"skew": -0.01}, lambda t: volts(pad(compression(0.99 * t)))),
]


@pytest.mark.parametrize(("effect", "values", "expected"), OUTPUT, ids=[row[0] for row in OUTPUT])
def test_output_of_a_rising_ramp_follows_the_closed_form(
    effect: str, values: dict[str, float], expected: Callable[[Array], Array]
) -> None:
    measured = columns(UP, effect, **values)
    np.testing.assert_allclose(measured["output_V"], expected(measured["t_s"]), atol=2e-5)


def test_channel_collapse_acts_above_its_onset() -> None:
    measured = columns(UP, "channel_collapse", size_per_N2=0.05, onset_N=2.0)
    force_N = measured["force_N"]
    ohm = 4.0 / (1 - 0.06 * force_N) * (1 + 0.05 * np.maximum(0.0, force_N - 2.0) ** 2)
    np.testing.assert_allclose(measured["output_V"], 3.3 * ohm / (ohm + 10.0), atol=1e-8)


def test_soft_frame_solves_its_implicit_equation() -> None:
    measured = columns(UP, "frame_compliance", compliance_mm_per_N=0.08)
    for stage_mm, force_N in zip(measured["stage_mm"][::25], measured["force_N"][::25], strict=True):
        travel_mm = max(0.0, stage_mm - 0.3)
        expected = brentq(lambda f, r=travel_mm: f - pad(np.array(max(0.0, r - 0.08 * f))), 0.0, 20.0)
        assert force_N == pytest.approx(expected, abs=1e-7)


def _low_pass(t_s: Array, signal: Callable[[float], float], tau_s: float, start: float) -> Array:
    solved = solve_ivp(
        lambda t, y: [(signal(t) - y[0]) / tau_s],
        (0, t_s[-1]),
        [start],
        t_eval=t_s,
        rtol=1e-9,
        atol=1e-11,
        max_step=0.01,
    )
    return np.asarray(solved.y[0])


def _hold_force(t: float) -> float:
    return float(pad(np.array(max(0.0, 2.3 * min(t, 1.0) - 0.3))))


@pytest.mark.parametrize("effect", ["stress_relaxation", "channel_creep", "loadcell_creep"])
def test_memory_in_a_hold_agrees_with_an_ode_solver(effect: str) -> None:
    measured = columns(HOLD, effect, share=0.2, tau_s=3.0)
    force_N = np.array([_hold_force(t) for t in measured["t_s"]])
    slow_N = _low_pass(measured["t_s"], _hold_force, 3.0, 0.0)
    expected_N = {"stress_relaxation": force_N - 0.2 * slow_N, "loadcell_creep": force_N + 0.2 * slow_N}
    np.testing.assert_allclose(measured["force_N"], np.maximum(0.0, expected_N.get(effect, force_N)), atol=1e-4)
    if effect == "channel_creep":
        np.testing.assert_allclose(measured["output_V"], volts(0.8 * force_N + 0.2 * slow_N), atol=1e-5)


def test_readout_lag_agrees_with_an_ode_solver() -> None:
    measured = columns(HOLD, "readout_lag", tau_s=0.4)
    expected = _low_pass(
        measured["t_s"], lambda t: float(volts(np.array(_hold_force(t)))), 0.4, float(volts(np.array(0.0)))
    )
    np.testing.assert_allclose(measured["output_V"], expected, atol=1e-5)


def test_hysteresis_does_not_depend_on_the_rate() -> None:
    slow = columns(TRIANGLES, "mechanical_hysteresis", size=0.1, scale_mm=0.3)["force_N"]
    quick_path = Path("quick", TRIANGLES.corner_s / 5.0, TRIANGLES.corner_mm)
    quick = columns(quick_path, "mechanical_hysteresis", size=0.1, scale_mm=0.3)["force_N"]
    np.testing.assert_allclose(quick, slow[::5], atol=5e-3)


def test_backlash_meets_the_stage_when_it_falls() -> None:
    measured = columns(TRIANGLES, "backlash", width_mm=0.1)
    falling = (measured["t_s"] > 5.5) & (measured["t_s"] < 9.0)
    np.testing.assert_allclose(
        measured["force_N"][falling], pad(np.maximum(0.0, measured["stage_mm"][falling] - 0.3)), atol=1e-9
    )


def test_mullins_softens_with_every_completed_compression() -> None:
    measured, base = columns(TRIANGLES, "mullins_softening", size=0.2, cycles=1.5), measure(TRIANGLES).columns
    for cycle, middle_s in enumerate((4.0, 14.0, 24.0)):
        k = int(middle_s * 50)
        factor = 1 - 0.2 * (1 - np.exp(-cycle / 1.5))
        assert measured["force_N"][k] == pytest.approx(base["force_N"][k] * factor)


def test_hum_is_one_line_in_the_spectrum() -> None:
    still = Path("still", np.array([0.0, 19.98]), np.zeros(2))
    output_V = columns(still, "mains_hum", amplitude_V=0.01, frequency_Hz=10.0)["output_V"]
    spectrum = 2.0 * np.abs(np.fft.rfft(output_V - output_V.mean())) / len(output_V)
    assert np.argmax(spectrum) == 200
    assert spectrum[200] == pytest.approx(0.01, rel=1e-3)


def test_dropped_samples_close_up() -> None:
    output_V, whole = (
        columns(TRIANGLES, "dropped_samples", count=6.0)["output_V"],
        measure(TRIANGLES).columns["output_V"],
    )
    np.testing.assert_allclose(output_V[:20], whole[:20])
    np.testing.assert_allclose(output_V[-106:-6], whole[-100:], atol=1e-9)


def test_intermittent_contact_adds_one_step_of_resistance() -> None:
    still = Path("still", np.array([0.0, 40.0]), np.zeros(2))
    output_V = columns(still, "intermittent_contact", step_ohm=0.5, count=3.0, mean_s=1.0)["output_V"]
    levels = np.unique(np.round(output_V, 6))
    np.testing.assert_allclose(levels, [volts(np.array(0.0)), volts(np.array(0.0), lead_ohm=0.5)], atol=1e-6)


def test_special_runs_show_what_they_isolate() -> None:
    frame, wire = (
        Cause("frame_compliance", "catalogue", {"compliance_mm_per_N": 0.02}),
        Cause("wiring_resistance", "catalogue", {"wire_ohm": 0.5}),
    )
    cell = Cause("loadcell_nonlinearity", "catalogue", {"size": 0.05, "capacity_N": 10.0})
    still = Path("still", np.array([0.0, 4.0]), np.zeros(2))
    block = measure(Path("block", np.array([0.0, 4.0]), np.array([0.3, 0.5])), frame, kind=RIGID_BLOCK).columns
    dummy = measure(still, wire, kind=DUMMY_RESISTOR, dummy_ohm=6.0).columns
    dead = measure(still, cell, kind=DEAD_WEIGHTS, known_force=lambda t_s: 2.0 + 0.0 * t_s).columns
    assert set(block) >= {"stage_mm", "force_N"} and "output_V" not in block
    np.testing.assert_allclose(np.diff(block["stage_mm"])[1:] / np.diff(block["force_N"])[1:], 0.020002, rtol=1e-6)
    np.testing.assert_allclose(dummy["output_V"], 3.3 * 6.5 / 16.5, atol=1e-8)
    np.testing.assert_allclose(dead["force_N"], 2.0 * 1.05 - 0.005 * 4.0, atol=1e-9)


def test_noise_and_adc_are_those_of_the_rig() -> None:
    still = Path("still", np.array([0.0, 400.0]), np.zeros(2))
    noisy = replace(RIG, noise_V=2e-3, noise_N=0.01, adc_bits=12)
    measured = measure(still, rig=noisy).columns
    assert np.std(measured["output_V"]) == pytest.approx(noisy.noise_floor_V, rel=0.03)
    assert np.std(measured["force_N"]) == pytest.approx(0.01, rel=0.03)
    codes = measured["output_V"] / (3.3 / 4095)
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-6)


def test_strain_sensor_follows_the_compression_and_not_the_force() -> None:
    strain = replace(RIG, sensor_type="strain", kappa_per_N=0.1)
    measured = columns(HOLD, "stress_relaxation", rig=strain, share=0.3, tau_s=2.0)
    assert np.ptp(measured["output_V"][100:]) < 1e-8 < np.ptp(measured["force_N"][100:])


@pytest.mark.parametrize(("effect", "form"), OTHER_FORMS)
def test_another_form_resembles_the_catalogue_effect_without_being_it(effect: str, form: str) -> None:
    values = VALUES[effect]
    base = measure(TRIANGLES).columns
    catalogue, other = (measure(TRIANGLES, Cause(effect, f, values)).columns for f in ("catalogue", form))
    channel = "force_N" if np.ptp(catalogue["force_N"] - base["force_N"]) > 0 else "output_V"
    first, second = catalogue[channel] - base[channel], other[channel] - base[channel]
    assert 0.3 < np.linalg.norm(second) / np.linalg.norm(first) < 3.0
    assert np.linalg.norm(second - first) > 0.02 * np.linalg.norm(first)


VALUES: dict[str, dict[str, float]] = {
    "contact_shift": {"shift_mm": 0.1, "tau_s": 8.0},
    "frame_compliance": {"compliance_mm_per_N": 0.02},
    "misaligned_contact": {"length_mm": 0.2},
    "stress_relaxation": {"share": 0.1, "tau_s": 3.0},
    "mechanical_hysteresis": {"size": 0.05, "scale_mm": 0.3},
    "mullins_softening": {"size": 0.1, "cycles": 2.0},
    "channel_creep": {"share": 0.1, "tau_s": 3.0},
    "channel_hysteresis": {"size": 0.05, "scale_N": 1.0},
    "channel_collapse": {"size_per_N2": 0.03, "onset_N": 2.0},
    "thermal_drift": {"coefficient_per_K": 1e-3},
    "ageing_drift": {"size": 6e-3, "tau_s": 10.0},
    "intermittent_contact": {"step_ohm": 0.3, "count": 3.0, "mean_s": 0.6},
    "readout_lag": {"tau_s": 0.1},
    "reference_drift": {"rate_per_s": 3e-4},
    "mains_hum": {"amplitude_V": 4e-3, "frequency_Hz": 10.0},
    "adc_saturation": {"low_V": 0.0, "high_V": 1.1},
    "loadcell_saturation": {"saturation_N": 12.0},
    "loadcell_nonlinearity": {"size": 0.05, "capacity_N": 8.0},
    "loadcell_creep": {"share": 0.02, "tau_s": 12.0},
    "loadcell_drift": {"rate_N_per_s": 2e-3},
    "clock_offset": {"delay_s": 0.05},
    "clock_skew": {"skew": 1e-3},
}
