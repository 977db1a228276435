"""The 25 effects of TWIN.md's catalogue in the page's own equations, each on a hook of the chain."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from softcal.core.challenge.chain import Apply, Equation, Moment, equations
from softcal.core.challenge.operators import loop, low_pass, play
from softcal.core.recording import Array

CATALOGUE_FORM = "catalogue"


def _backlash(stage_mm: Array, at: Moment, width_mm: float) -> Array:
    return play(stage_mm, width_mm)


def _contact_shift(contact_mm: Array, at: Moment, shift_mm: float, tau_s: float) -> Array:
    return contact_mm + shift_mm * (1.0 - np.exp(-at.t_s / tau_s))


def _frame_compliance(yielding_mm: Array, at: Moment, compliance_mm_per_N: float) -> Array:
    return yielding_mm + compliance_mm_per_N * at.force_N


def _misaligned_contact(compression_mm: Array, at: Moment, length_mm: float) -> Array:
    return compression_mm - length_mm * (1.0 - np.exp(-compression_mm / length_mm))


def _stress_relaxation(force_N: Array, at: Moment, share: float, tau_s: float) -> Array:
    return np.maximum(0.0, force_N - share * low_pass(force_N, at.step_s, tau_s))


def _mechanical_hysteresis(force_N: Array, at: Moment, size: float, scale_mm: float) -> Array:
    return force_N * (1.0 + size * loop(at.compression_mm, scale_mm))


def completed_compressions(compression_mm: Array) -> Array:
    """Count, at each point, the compressions that ended before: contact made and lost again."""
    pressed = compression_mm > 0.0
    released = pressed[:-1] & ~pressed[1:]
    return np.concatenate([[0.0], np.cumsum(released)])


def _mullins_softening(force_N: Array, at: Moment, size: float, cycles: float) -> Array:
    done = completed_compressions(at.compression_mm)
    return force_N * (1.0 - size * (1.0 - np.exp(-done / cycles)))


def _channel_creep(load: Array, at: Moment, share: float, tau_s: float) -> Array:
    return (1.0 - share) * load + share * low_pass(load, at.step_s, tau_s)


def _channel_hysteresis(load: Array, at: Moment, size: float, scale_N: float) -> Array:
    return load * (1.0 + size * loop(load, scale_N))


def _channel_collapse(ohm: Array, at: Moment, size_per_N2: float, onset_N: float) -> Array:
    return ohm * (1.0 + size_per_N2 * np.maximum(0.0, at.force_N - onset_N) ** 2)


def _thermal_drift(rest_ohm: Array, at: Moment, coefficient_per_K: float) -> Array:
    return np.asarray(rest_ohm * (1.0 + coefficient_per_K * (at.temperature_C - at.temperature_C[0])))


def _ageing_drift(rest_ohm: Array, at: Moment, size: float, tau_s: float) -> Array:
    return rest_ohm * (1.0 + size * np.log1p(at.t_s / tau_s))


def drawn_intervals(at: Moment, count: float, mean_s: float) -> list[tuple[float, float]]:
    """Draw this run's intervals: `count` of them, exponential lengths of at least five samples."""
    end_s = float(at.t_s[-1])
    lengths_s = np.maximum(5.0 / at.rig.sample_rate_Hz, at.rng.exponential(mean_s, round(count)))
    starts_s = at.rng.uniform(0.05, 0.9, round(count)) * end_s
    return list(zip(starts_s.tolist(), (starts_s + lengths_s).tolist(), strict=True))


def _intermittent_contact(ohm: Array, at: Moment, step_ohm: float, count: float, mean_s: float) -> Array:
    is_open = np.zeros(len(ohm), dtype=bool)
    for start_s, stop_s in drawn_intervals(at, count, mean_s):
        is_open |= (at.t_s >= start_s) & (at.t_s < stop_s)
    return ohm + step_ohm * is_open


def _readout_lag(volts: Array, at: Moment, tau_s: float) -> Array:
    return low_pass(volts, at.step_s, tau_s, start=float(volts[0]))


def _wiring_resistance(ohm: Array, at: Moment, wire_ohm: float) -> Array:
    return ohm + wire_ohm


def _reference_drift(reference_V: Array, at: Moment, rate_per_s: float) -> Array:
    return reference_V * (1.0 + rate_per_s * at.t_s)


def _mains_hum(volts: Array, at: Moment, amplitude_V: float, frequency_Hz: float) -> Array:
    phase = at.rng.uniform(0.0, 2.0 * np.pi)
    return volts + amplitude_V * np.sin(2.0 * np.pi * frequency_Hz * at.t_s + phase)


def _adc_saturation(volts: Array, at: Moment, low_V: float, high_V: float) -> Array:
    return np.clip(volts, low_V, high_V)


def _loadcell_saturation(force_N: Array, at: Moment, saturation_N: float) -> Array:
    return np.asarray(saturation_N * np.tanh(force_N / saturation_N))


def _loadcell_nonlinearity(force_N: Array, at: Moment, size: float, capacity_N: float) -> Array:
    return force_N + size * force_N * (1.0 - force_N / capacity_N)


def _loadcell_creep(force_N: Array, at: Moment, share: float, tau_s: float) -> Array:
    return force_N + share * low_pass(force_N, at.step_s, tau_s)


def _loadcell_drift(force_N: Array, at: Moment, rate_N_per_s: float) -> Array:
    return force_N + rate_N_per_s * at.t_s


def _clock_offset(instants_s: Array, at: Moment, delay_s: float) -> Array:
    return instants_s - delay_s


def _clock_skew(instants_s: Array, at: Moment, skew: float) -> Array:
    return instants_s * (1.0 + skew)


def _dropped_samples(instants_s: Array, at: Moment, count: float) -> Array:
    """Drop `count` samples of this run in up to three blocks; the later ones close up."""
    blocks = min(3, round(count))
    sizes = at.rng.multinomial(round(count) - blocks, np.full(blocks, 1.0 / blocks)) + 1
    places = at.rng.integers(len(instants_s) // 20, 9 * len(instants_s) // 10, blocks)
    missing = np.zeros(len(instants_s))
    for place, size in zip(places, sizes, strict=True):
        missing[place:] += size
    return instants_s + missing / at.rig.sample_rate_Hz


CATALOGUE = equations(
    CATALOGUE_FORM,
    (
        ("backlash", "motion", "position", _backlash),
        ("contact_shift", "mechanics", "contact", _contact_shift),
        ("frame_compliance", "mechanics", "yielding", _frame_compliance),
        ("misaligned_contact", "mechanics", "landing", _misaligned_contact),
        ("stress_relaxation", "mechanics", "relaxed", _stress_relaxation),
        ("mechanical_hysteresis", "mechanics", "elastic", _mechanical_hysteresis),
        ("mullins_softening", "mechanics", "elastic", _mullins_softening),
        ("channel_creep", "transduction", "channel", _channel_creep),
        ("channel_hysteresis", "transduction", "channel", _channel_hysteresis),
        ("channel_collapse", "transduction", "resistance", _channel_collapse),
        ("thermal_drift", "transduction", "rest_resistance", _thermal_drift),
        ("ageing_drift", "transduction", "rest_resistance", _ageing_drift),
        ("intermittent_contact", "transduction", "resistance", _intermittent_contact),
        ("readout_lag", "electronics", "voltage", _readout_lag),
        ("wiring_resistance", "electronics", "lead", _wiring_resistance),
        ("reference_drift", "electronics", "reference", _reference_drift),
        ("mains_hum", "electronics", "pickup", _mains_hum),
        ("adc_saturation", "electronics", "limit", _adc_saturation),
        ("loadcell_saturation", "load_cell", "cell", _loadcell_saturation),
        ("loadcell_nonlinearity", "load_cell", "cell", _loadcell_nonlinearity),
        ("loadcell_creep", "load_cell", "cell", _loadcell_creep),
        ("loadcell_drift", "load_cell", "cell", _loadcell_drift),
        ("clock_offset", "acquisition", "instant", _clock_offset),
        ("clock_skew", "acquisition", "instant", _clock_skew),
        ("dropped_samples", "acquisition", "instant", _dropped_samples),
    ),
)
"""Every effect of the catalogue by its identifier."""


def in_other_forms(rows: Iterable[tuple[str, str, Apply]]) -> dict[tuple[str, str], Equation]:
    """Return other equations of the catalogue's effects by (effect, form), from rows of both and what each does."""
    return {(effect, form): replace(CATALOGUE[effect], form=form, apply=apply) for effect, form, apply in rows}
