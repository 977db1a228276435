"""The catalogue's causes by other equations: a rig does not know which one that chose."""

import numpy as np

from softcal.core.challenge.catalogue_equations import completed_compressions, drawn_intervals, in_other_forms, tone
from softcal.core.challenge.chain import Apply, Moment
from softcal.core.challenge.operators import bouc_wen, low_pass, low_passes, power_law, prandtl_ishlinskii
from softcal.core.recording import Array


def _three_times(signal: Array, at: Moment, tau_s: float) -> Array:
    """A memory of three relaxation times over a factor of 25 around τ."""
    return low_passes(signal, at.step_s, [0.4, 0.35, 0.25], [tau_s / 5.0, tau_s, 5.0 * tau_s])


def _power_law(signal: Array, at: Moment, tau_s: float) -> Array:
    """A memory by a power law: straight in log t over three decades around τ."""
    return power_law(signal, at.step_s, tau_s / 30.0, tau_s * 30.0)


def _relaxation(memory: Apply) -> Apply:
    return lambda force_N, at, share, tau_s: np.maximum(0.0, force_N - share * memory(force_N, at, tau_s))


def _creep(memory: Apply) -> Apply:
    return lambda load, at, share, tau_s: (1.0 - share) * load + share * memory(load, at, tau_s)


def _pad_loop(loop: Apply) -> Apply:
    return lambda force_N, at, size, scale_mm: force_N * (1.0 + size * loop(at.compression_mm, scale_mm))


def _channel_loop(loop: Apply) -> Apply:
    return lambda load, at, size, scale_N: load * (1.0 + size * loop(load, scale_N))


def _hertzian_frame(yielding_mm: Array, at: Moment, compliance_mm_per_N: float) -> Array:
    """A frame with a joint that closes about like F^(2/3), equal to the linear one at 3 N."""
    force_N = np.maximum(0.0, at.force_N)
    return np.asarray(yielding_mm + compliance_mm_per_N * force_N * (3.05 / (force_N + 0.05)) ** (1.0 / 3.0))


def _softening_by_power(force_N: Array, at: Moment, size: float, cycles: float) -> Array:
    """Softening that grows by cycles as 1 − (1 + N/N0)^(−1.5) instead of exponentially."""
    done = completed_compressions(at.compression_mm)
    return force_N * (1.0 - size * (1.0 - (1.0 + done / cycles) ** -1.5))


def _hard_knee(ohm: Array, at: Moment, size_per_N2: float, onset_N: float) -> Array:
    """A straight rise above the onset, with the catalogue's size 2 N above it."""
    return ohm * (1.0 + 2.0 * size_per_N2 * np.maximum(0.0, at.force_N - onset_N))


def _curved_temperature(rest_ohm: Array, at: Moment, coefficient_per_K: float) -> Array:
    """A coefficient that grows by 3 % per kelvin away from the start."""
    warming_K = at.temperature_C - at.temperature_C[0]
    return np.asarray(rest_ohm * (1.0 + coefficient_per_K * warming_K * (1.0 + 0.03 * np.abs(warming_K))))


def _uneven_contact(ohm: Array, at: Moment, step_ohm: float, count: float, mean_s: float) -> Array:
    """Intervals whose steps differ by a factor of up to two."""
    added = np.zeros_like(ohm)
    for start_s, stop_s in drawn_intervals(at, count, mean_s):
        added[(at.t_s >= start_s) & (at.t_s < stop_s)] = step_ohm * at.rng.uniform(0.7, 1.4)
    return ohm + added


def _second_order_lag(volts: Array, at: Moment, tau_s: float) -> Array:
    """Two equal low-passes in a row with the same total delay."""
    start = float(volts[0])
    return low_pass(low_pass(volts, at.step_s, tau_s / 2.0, start), at.step_s, tau_s / 2.0, start)


def _settling_reference(reference_V: Array, at: Moment, rate_per_s: float) -> Array:
    """A reference that settles within a minute; the catalogue's rate is its mean over 40 s."""
    drift = rate_per_s * 40.0 * (1.0 - np.exp(-at.t_s / 60.0)) / (1.0 - np.exp(-40.0 / 60.0))
    return np.asarray(reference_V * (1.0 + drift))


def _soft_clip(volts: Array, at: Moment, low_V: float, high_V: float) -> Array:
    """An input stage that bends over the last 15 mV before it clips."""
    knee_V = 0.015
    return np.maximum(low_V, high_V - knee_V * np.logaddexp(0.0, (high_V - volts) / knee_V))


def _bending_cell(force_N: Array, at: Moment, saturation_N: float) -> Array:
    """A cell that bends like F/(1 + (F/Fs)³)^(1/3): later and harder than tanh."""
    return force_N / (1.0 + np.abs(force_N / saturation_N) ** 3) ** (1.0 / 3.0)


def _bowed_cell(force_N: Array, at: Moment, size: float, capacity_N: float) -> Array:
    """A half sine over the cell's range instead of a parabola, with the same size."""
    return force_N + size * capacity_N / 4.0 * np.sin(np.pi * force_N / capacity_N)


def _cell_warm_up(force_N: Array, at: Moment, rate_N_per_s: float) -> Array:
    """A zero that drifts ever more slowly; the catalogue's rate is its mean over 40 s."""
    return np.asarray(force_N + rate_N_per_s * 40.0 * (1.0 - np.exp(-at.t_s / 80.0)) / (1.0 - np.exp(-40.0 / 80.0)))


def _bent_clock(instants_s: Array, at: Moment, skew: float) -> Array:
    """A rate that changes while the oscillator warms up: t² instead of t, equal after 40 s."""
    return instants_s + skew * instants_s * (0.5 + 0.5 * instants_s / 40.0)


def _wandering_delay(instants_s: Array, at: Moment, delay_s: float) -> Array:
    return instants_s - delay_s * (1.0 + 0.15 * np.sin(2.0 * np.pi * instants_s / 17.0))


def _beating_hum(volts: Array, at: Moment, amplitude_V: float, frequency_Hz: float) -> Array:
    """Hum whose amplitude rises and falls by 30 % over eight seconds."""
    phase, beat = at.rng.uniform(0.0, 2.0 * np.pi, 2)
    swell = 1.0 + 0.3 * np.sin(2.0 * np.pi * at.t_s / 8.0 + beat)
    return tone(volts, at, amplitude_V * swell, frequency_Hz, phase)


OTHER_FORMS = in_other_forms(
    {
        ("contact_shift", "square_root"): lambda mm, at, shift_mm, tau_s: (
            mm + shift_mm * np.sqrt(at.t_s / (at.t_s + tau_s))
        ),
        ("frame_compliance", "closing_joint"): _hertzian_frame,
        # δ²/(δ + ℓ), which also loses ℓ at large δ.
        ("misaligned_contact", "rounded_edge"): lambda mm, at, length_mm: mm**2 / (mm + length_mm),
        ("stress_relaxation", "three_times"): _relaxation(_three_times),
        ("stress_relaxation", "power_law"): _relaxation(_power_law),
        ("mechanical_hysteresis", "prandtl_ishlinskii"): _pad_loop(prandtl_ishlinskii),
        ("mechanical_hysteresis", "bouc_wen"): _pad_loop(bouc_wen),
        ("mullins_softening", "power_of_cycles"): _softening_by_power,
        ("channel_creep", "three_times"): _creep(_three_times),
        ("channel_creep", "power_law"): _creep(_power_law),
        ("channel_hysteresis", "prandtl_ishlinskii"): _channel_loop(prandtl_ishlinskii),
        ("channel_hysteresis", "bouc_wen"): _channel_loop(bouc_wen),
        ("channel_collapse", "hard_knee"): _hard_knee,
        ("thermal_drift", "curved"): _curved_temperature,
        ("ageing_drift", "square_root"): lambda ohm, at, size, tau_s: (
            ohm * (1.0 + size * (np.sqrt(1.0 + at.t_s / tau_s) - 1.0))
        ),
        ("intermittent_contact", "uneven"): _uneven_contact,
        ("readout_lag", "second_order"): _second_order_lag,
        ("reference_drift", "settling"): _settling_reference,
        ("mains_hum", "beating"): _beating_hum,
        ("adc_saturation", "soft_clip"): _soft_clip,
        ("loadcell_saturation", "bending"): _bending_cell,
        ("loadcell_nonlinearity", "half_sine"): _bowed_cell,
        ("loadcell_creep", "three_times"): lambda force_N, at, share, tau_s: (
            force_N + share * _three_times(force_N, at, tau_s)
        ),
        ("loadcell_drift", "warm_up"): _cell_warm_up,
        ("clock_offset", "wandering"): _wandering_delay,
        ("clock_skew", "warming"): _bent_clock,
    }
)
"""By (effect, form); each takes the parameters of the catalogue's and is about as large."""
