"""Effects outside the catalogue: the honest answer to each is `unknown`, with its stage."""

import numpy as np

from softcal.core.challenge.chain import Apply, Moment, equations
from softcal.core.challenge.operators import loop, low_pass
from softcal.core.recording import Array

OUTSIDE_FORM = "outside"


def _slip(stage_mm: Array, at: Moment, jump_mm: float) -> Array:
    """The carriage loses steps once, somewhere in the middle of the run."""
    return np.asarray(stage_mm - jump_mm * (at.t_s > at.rng.uniform(0.25, 0.6) * at.t_s[-1]))


def _pitch_error(stage_mm: Array, at: Moment, amplitude_mm: float, pitch_mm: float) -> Array:
    return stage_mm + amplitude_mm * np.sin(2.0 * np.pi * stage_mm / pitch_mm)


def _permanent_set(contact_mm: Array, at: Moment, share: float) -> Array:
    deepest_mm = np.maximum.accumulate(np.maximum(0.0, at.stage_mm - contact_mm))
    return contact_mm + share * deepest_mm


def _adhesion(force_N: Array, at: Moment, pull_N: float, reach_mm: float) -> Array:
    """On the way out the pad sticks: −Fa·exp(−δ/d) while the surfaces touch."""
    leaving = 0.5 * (1.0 - loop(at.compression_mm, 0.02))
    touching = at.compression_mm > 0.0
    return force_N - pull_N * np.exp(-at.compression_mm / reach_mm) * leaving * touching


def _guide_friction(force_N: Array, at: Moment, friction_N: float) -> Array:
    """Coulomb friction of the guide while it loads the pad, turned within 5 µm of a reversal."""
    return force_N + friction_N * loop(at.compression_mm, 0.005) * (at.compression_mm > 0.0)


def _follows_temperature(values: Array, at: Moment, coefficient_per_K: float) -> Array:
    return np.asarray(values * (1.0 + coefficient_per_K * (at.temperature_C - at.temperature_C[0])))


def _contact_growth(load: Array, at: Moment, growth: float, half_N: float) -> Array:
    """Pressure F/A(F) with an area that grows by `growth`, half of it by `half_N`."""
    return load / (1.0 + growth * load / (load + half_N))


def _sensitivity_ageing(load: Array, at: Moment, rate_per_s: float) -> Array:
    return load * (1.0 + rate_per_s * at.t_s)


def _adc_inl(volts: Array, at: Moment, amplitude_V: float, period_V: float) -> Array:
    return np.asarray(volts + amplitude_V * np.sin(2.0 * np.pi * (volts - volts[0]) / period_V))


def _spikes(volts: Array, at: Moment, height_V: float, rate_per_s: float) -> Array:
    hit = at.rng.random(len(volts)) < rate_per_s / at.rig.sample_rate_Hz
    return np.asarray(
        volts + hit * at.rng.choice([-1.0, 1.0], len(volts)) * at.rng.uniform(0.5, 1.0, len(volts)) * height_V
    )


def _cable_drag(force_N: Array, at: Moment, drag_N_per_mm: float) -> Array:
    return force_N + drag_N_per_mm * at.stage_mm


def _inertia(force_N: Array, at: Moment, mass_kg: float) -> Array:
    """The platen's mass on the cell; the drive turns corners with a time constant of 15 ms."""
    smooth_mm = low_pass(low_pass(at.stage_mm, at.step_s, 0.015), at.step_s, 0.015)
    return force_N + mass_kg * 1e-3 * np.gradient(np.gradient(smooth_mm, at.step_s), at.step_s)


def _cell_filter(force_N: Array, at: Moment, tau_s: float) -> Array:
    return low_pass(force_N, at.step_s, tau_s)


def _cell_hysteresis(force_N: Array, at: Moment, size: float, scale_N: float) -> Array:
    return force_N * (1.0 + size * loop(force_N, scale_N))


def _jitter(instants_s: Array, at: Moment, spread_s: float) -> Array:
    return instants_s + at.rng.normal(0.0, spread_s, len(instants_s))


_ROWS: tuple[tuple[str, str, str, Apply], ...] = (
    ("slip", "motion", "position", _slip),
    ("pitch_error", "motion", "position", _pitch_error),
    ("permanent_set", "mechanics", "contact", _permanent_set),
    ("adhesion", "mechanics", "elastic", _adhesion),
    ("guide_friction", "mechanics", "elastic", _guide_friction),
    ("modulus_temperature", "mechanics", "elastic", _follows_temperature),
    ("contact_growth", "transduction", "channel", _contact_growth),
    ("sensitivity_ageing", "transduction", "channel", _sensitivity_ageing),
    ("divider_temperature", "electronics", "series", _follows_temperature),
    ("adc_inl", "electronics", "voltage", _adc_inl),
    ("spikes", "electronics", "pickup", _spikes),
    ("cable_drag", "load_cell", "cell", _cable_drag),
    ("inertia", "load_cell", "cell", _inertia),
    ("cell_filter", "load_cell", "cell", _cell_filter),
    ("cell_hysteresis", "load_cell", "cell", _cell_hysteresis),
    ("cell_span_temperature", "load_cell", "cell", _follows_temperature),
    ("jitter", "acquisition", "instant", _jitter),
)

OUTSIDE = equations(OUTSIDE_FORM, _ROWS)
"""Every effect outside the catalogue by its name."""

ALIASES = {"divider_temperature": "thermal_drift"}
"""Outside effects that a catalogue effect imitates exactly on ordinary runs: only R/Rs enters the divider."""
