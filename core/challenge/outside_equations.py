"""Effects outside the catalogue: the honest answer to each is `unknown`, with its stage."""

import numpy as np

from softcal.core.challenge.catalogue_equations import follows_temperature
from softcal.core.challenge.chain import Moment, equations
from softcal.core.challenge.operators import loop, low_pass
from softcal.core.recording import Array

OUTSIDE_FORM = "outside"


def _slip(stage_mm: Array, at: Moment, jump_mm: float) -> Array:
    """The carriage loses steps once, somewhere in the middle of the run."""
    return np.asarray(stage_mm - jump_mm * (at.t_s > at.rng.uniform(0.25, 0.6) * at.t_s[-1]))


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


def _contact_growth(load: Array, at: Moment, growth: float, half_N: float) -> Array:
    """Pressure F/A(F) with an area that grows by `growth`, half of it by `half_N`."""
    return load / (1.0 + growth * load / (load + half_N))


def _adc_inl(volts: Array, at: Moment, amplitude_V: float, period_V: float) -> Array:
    return np.asarray(volts + amplitude_V * np.sin(2.0 * np.pi * (volts - volts[0]) / period_V))


def _spikes(volts: Array, at: Moment, height_V: float, rate_per_s: float) -> Array:
    hit = at.rng.random(len(volts)) < rate_per_s / at.rig.sample_rate_Hz
    sign, size = at.rng.choice([-1.0, 1.0], len(volts)), at.rng.uniform(0.5, 1.0, len(volts))
    return np.asarray(volts + hit * sign * size * height_V)


def _inertia(force_N: Array, at: Moment, mass_kg: float) -> Array:
    """The platen's mass on the cell; the drive turns corners with a time constant of 15 ms."""
    smooth_mm = low_pass(low_pass(at.stage_mm, at.step_s, 0.015), at.step_s, 0.015)
    return force_N + mass_kg * 1e-3 * np.gradient(np.gradient(smooth_mm, at.step_s), at.step_s)


OUTSIDE = equations(
    OUTSIDE_FORM,
    {
        "slip": ("position", _slip),
        "pitch_error": (
            "position",
            lambda mm, at, amplitude_mm, pitch_mm: mm + amplitude_mm * np.sin(2.0 * np.pi * mm / pitch_mm),
        ),
        "permanent_set": ("contact", _permanent_set),
        "adhesion": ("elastic", _adhesion),
        "guide_friction": ("elastic", _guide_friction),
        "modulus_temperature": ("elastic", follows_temperature),
        "contact_growth": ("channel", _contact_growth),
        "sensitivity_ageing": ("channel", lambda load, at, rate_per_s: load * (1.0 + rate_per_s * at.t_s)),
        "divider_temperature": ("series", follows_temperature),
        "adc_inl": ("voltage", _adc_inl),
        "spikes": ("pickup", _spikes),
        "cable_drag": ("cell", lambda force_N, at, drag_N_per_mm: force_N + drag_N_per_mm * at.stage_mm),
        "inertia": ("cell", _inertia),
        "cell_filter": ("cell", lambda force_N, at, tau_s: low_pass(force_N, at.step_s, tau_s)),
        "cell_hysteresis": ("cell", lambda force_N, at, size, scale_N: force_N * (1.0 + size * loop(force_N, scale_N))),
        "cell_span_temperature": ("cell", follows_temperature),
        "jitter": (
            "instant",
            lambda instants_s, at, spread_s: instants_s + at.rng.normal(0.0, spread_s, len(instants_s)),
        ),
    },
)
"""Every effect outside the catalogue by its name."""

ALIASES = {"divider_temperature": "thermal_drift"}
"""Effects that one of the catalogue imitates on ordinary runs: only R/Rs enters the divider."""
