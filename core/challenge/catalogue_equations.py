"""The 25 effects of TWIN.md's catalogue in its own equations, each on a hook of the chain."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from softcal.core.challenge.chain import Apply, Equation, Moment, equations
from softcal.core.challenge.operators import loop, low_pass, play
from softcal.core.recording import Array

CATALOGUE_FORM = "catalogue"


def completed_compressions(compression_mm: Array) -> Array:
    """Count, at each point, the compressions that ended before: contact made and lost again."""
    pressed = compression_mm > 0.0
    released = pressed[:-1] & ~pressed[1:]
    return np.concatenate([[0.0], np.cumsum(released)])


def follows_temperature(values: Array, at: Moment, coefficient_per_K: float) -> Array:
    """Grow in proportion to the warming since the start of the run."""
    return np.asarray(values * (1.0 + coefficient_per_K * (at.temperature_C - at.temperature_C[0])))


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


def tone(volts: Array, at: Moment, amplitude_V: float | Array, frequency_Hz: float, phase: float) -> Array:
    """Add a sine."""
    return np.asarray(volts + amplitude_V * np.sin(2.0 * np.pi * frequency_Hz * at.t_s + phase))


def hum(volts: Array, at: Moment, amplitude_V: float, frequency_Hz: float) -> Array:
    """Add a sine whose phase is drawn for this run."""
    return tone(volts, at, amplitude_V, frequency_Hz, at.rng.uniform(0.0, 2.0 * np.pi))


def _dropped_samples(instants_s: Array, at: Moment, count: float) -> Array:
    """Drop `count` samples of this run in up to three blocks; the later ones close up."""
    blocks = min(3, round(count))
    sizes = at.rng.multinomial(round(count) - blocks, np.full(blocks, 1.0 / blocks)) + 1
    places = at.rng.integers(len(instants_s) // 20, 9 * len(instants_s) // 10, blocks)
    missing = np.zeros(len(instants_s))
    for place, size in zip(places, sizes, strict=True):
        missing[place:] += size
    return instants_s + missing / at.rig.sample_rate_Hz


def _mullins_softening(force_N: Array, at: Moment, size: float, cycles: float) -> Array:
    done = completed_compressions(at.compression_mm)
    return force_N * (1.0 - size * (1.0 - np.exp(-done / cycles)))


def _channel_creep(load: Array, at: Moment, share: float, tau_s: float) -> Array:
    return (1.0 - share) * load + share * low_pass(load, at.step_s, tau_s)


def _channel_collapse(ohm: Array, at: Moment, size_per_N2: float, onset_N: float) -> Array:
    return ohm * (1.0 + size_per_N2 * np.maximum(0.0, at.force_N - onset_N) ** 2)


def _stress_relaxation(force_N: Array, at: Moment, share: float, tau_s: float) -> Array:
    return np.maximum(0.0, force_N - share * low_pass(force_N, at.step_s, tau_s))


CATALOGUE = equations(
    CATALOGUE_FORM,
    {
        "backlash": ("position", lambda mm, at, width_mm: play(mm, width_mm)),
        "contact_shift": ("contact", lambda mm, at, shift_mm, tau_s: mm + shift_mm * (1.0 - np.exp(-at.t_s / tau_s))),
        "frame_compliance": ("yielding", lambda mm, at, compliance_mm_per_N: mm + compliance_mm_per_N * at.force_N),
        "misaligned_contact": ("landing", lambda mm, at, length_mm: mm - length_mm * (1.0 - np.exp(-mm / length_mm))),
        "stress_relaxation": ("relaxed", _stress_relaxation),
        "mechanical_hysteresis": (
            "elastic",
            lambda force_N, at, size, scale_mm: force_N * (1.0 + size * loop(at.compression_mm, scale_mm)),
        ),
        "mullins_softening": ("elastic", _mullins_softening),
        "channel_creep": ("channel", _channel_creep),
        "channel_hysteresis": ("channel", lambda load, at, size, scale_N: load * (1.0 + size * loop(load, scale_N))),
        "channel_collapse": ("resistance", _channel_collapse),
        "thermal_drift": ("rest_resistance", follows_temperature),
        "ageing_drift": ("rest_resistance", lambda ohm, at, size, tau_s: ohm * (1.0 + size * np.log1p(at.t_s / tau_s))),
        "intermittent_contact": ("resistance", _intermittent_contact),
        "readout_lag": ("voltage", lambda volts, at, tau_s: low_pass(volts, at.step_s, tau_s, start=float(volts[0]))),
        "wiring_resistance": ("lead", lambda ohm, at, wire_ohm: ohm + wire_ohm),
        "reference_drift": ("reference", lambda volts, at, rate_per_s: volts * (1.0 + rate_per_s * at.t_s)),
        "mains_hum": ("pickup", hum),
        "adc_saturation": ("limit", lambda volts, at, low_V, high_V: np.clip(volts, low_V, high_V)),
        "loadcell_saturation": (
            "cell",
            lambda force_N, at, saturation_N: np.asarray(saturation_N * np.tanh(force_N / saturation_N)),
        ),
        "loadcell_nonlinearity": (
            "cell",
            lambda force_N, at, size, capacity_N: force_N + size * force_N * (1.0 - force_N / capacity_N),
        ),
        "loadcell_creep": (
            "cell",
            lambda force_N, at, share, tau_s: force_N + share * low_pass(force_N, at.step_s, tau_s),
        ),
        "loadcell_drift": ("cell", lambda force_N, at, rate_N_per_s: force_N + rate_N_per_s * at.t_s),
        "clock_offset": ("instant", lambda instants_s, at, delay_s: instants_s - delay_s),
        "clock_skew": ("instant", lambda instants_s, at, skew: instants_s * (1.0 + skew)),
        "dropped_samples": ("instant", _dropped_samples),
    },
)
"""Every effect of the catalogue by its identifier."""


def in_other_forms(rows: Mapping[tuple[str, str], Apply]) -> dict[tuple[str, str], Equation]:
    """Return other equations of the catalogue's effects by (effect, form)."""
    return {
        (effect, form): replace(CATALOGUE[effect], form=form, apply=apply) for (effect, form), apply in rows.items()
    }
