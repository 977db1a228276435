"""How large an effect usually is on a rig, drawn at random (magnitudes from the literature)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softcal.core.challenge.rig import Rig

Rng = np.random.Generator
MAINS_Hz = (50.0, 60.0)


@dataclass(frozen=True)
class Scope:
    """What sizes are measured against on one rig."""

    rig: Rig
    peak_N: float
    rest_V: float
    peak_V: float

    @property
    def span_V(self) -> float:
        """Range of the output between rest and peak."""
        return self.peak_V - self.rest_V


def near(rng: Rng, centre: float, factor: float = 1.6) -> float:
    """Draw log-uniformly between centre/factor and centre·factor."""
    return float(centre * factor ** rng.uniform(-1.0, 1.0))


def _signed(rng: Rng, centre: float) -> float:
    return float(rng.choice([-1.0, 1.0])) * near(rng, centre)


def _saturation(rng: Rng, scope: Scope, scale: float) -> dict[str, float]:
    """One rail or the other, so far inside the used range that 4–12 % of it are lost at scale 1."""
    lost_V = scale * rng.uniform(0.04, 0.12) * scope.span_V
    if rng.random() < 0.25:
        return {"low_V": scope.rest_V + lost_V, "high_V": scope.rig.vref_V}
    return {"low_V": 0.0, "high_V": scope.peak_V - lost_V}


def alias_Hz(line_Hz: float, rate_Hz: float) -> float:
    """Return where a line stands in the spectrum of samples."""
    return float(abs(line_Hz - rate_Hz * round(line_Hz / rate_Hz)))


def _hum_Hz(rng: Rng, rate_Hz: float) -> float:
    """Alias of 50 or 60 Hz mains, away from 0 and from half the rate, where no sine is left."""
    mains_Hz = [m for m in MAINS_Hz if 0.5 < alias_Hz(m, rate_Hz) < rate_Hz / 2.0 - 0.5]
    return alias_Hz(float(rng.choice(mains_Hz)) + rng.normal(0.0, 0.03), rate_Hz)


Draw = Callable[[Rng, Scope, float], dict[str, float]]

CATALOGUE_SIZES: dict[str, Draw] = {
    "backlash": lambda rng, at, scale: {"width_mm": scale * near(rng, 0.05)},
    "contact_shift": lambda rng, at, scale: {"shift_mm": scale * _signed(rng, 0.06), "tau_s": near(rng, 20.0)},
    "frame_compliance": lambda rng, at, scale: {"compliance_mm_per_N": scale * near(rng, 0.02)},
    "misaligned_contact": lambda rng, at, scale: {"length_mm": scale * near(rng, 0.25)},
    "stress_relaxation": lambda rng, at, scale: {"share": scale * near(rng, 0.08), "tau_s": near(rng, 5.0, 2.5)},
    "mechanical_hysteresis": lambda rng, at, scale: {"size": scale * near(rng, 0.05), "scale_mm": near(rng, 0.3)},
    "mullins_softening": lambda rng, at, scale: {"size": scale * near(rng, 0.08), "cycles": near(rng, 2.0)},
    "channel_creep": lambda rng, at, scale: {"share": scale * near(rng, 0.08), "tau_s": near(rng, 5.0, 2.5)},
    "channel_hysteresis": lambda rng, at, scale: {"size": scale * near(rng, 0.05), "scale_N": near(rng, 1.0)},
    "channel_collapse": lambda rng, at, scale: {
        "size_per_N2": scale * near(rng, 0.03),
        "onset_N": at.peak_N * rng.uniform(0.45, 0.7),
    },
    "thermal_drift": lambda rng, at, scale: {"coefficient_per_K": scale * _signed(rng, 1.2e-3)},
    "ageing_drift": lambda rng, at, scale: {"size": scale * _signed(rng, 6e-3), "tau_s": near(rng, 10.0, 2.5)},
    "intermittent_contact": lambda rng, at, scale: {
        "step_ohm": scale * at.rig.r0_ohm * near(rng, 0.06),
        "count": float(rng.integers(2, 5)),
        "mean_s": near(rng, 0.6),
    },
    "readout_lag": lambda rng, at, scale: {"tau_s": scale * near(rng, 0.1)},
    "wiring_resistance": lambda rng, at, scale: {"wire_ohm": scale * at.rig.r0_ohm * near(rng, 0.2)},
    "reference_drift": lambda rng, at, scale: {"rate_per_s": scale * _signed(rng, 3e-4)},
    "mains_hum": lambda rng, at, scale: {
        "amplitude_V": scale * near(rng, 4e-3),
        "frequency_Hz": _hum_Hz(rng, at.rig.sample_rate_Hz),
    },
    "adc_saturation": _saturation,
    "loadcell_saturation": lambda rng, at, scale: {
        "saturation_N": float(at.peak_N * near(rng, 2.6, 1.25) / np.sqrt(scale))
    },
    "loadcell_nonlinearity": lambda rng, at, scale: {
        "size": scale * _signed(rng, 0.05),
        "capacity_N": at.peak_N * rng.uniform(1.1, 1.6),
    },
    "loadcell_creep": lambda rng, at, scale: {"share": scale * near(rng, 0.025), "tau_s": near(rng, 12.0)},
    "loadcell_drift": lambda rng, at, scale: {"rate_N_per_s": scale * _signed(rng, 2e-3)},
    "clock_offset": lambda rng, at, scale: {"delay_s": scale * _signed(rng, 0.05)},
    "clock_skew": lambda rng, at, scale: {"skew": scale * _signed(rng, 1e-3)},
    "dropped_samples": lambda rng, at, scale: {"count": float(max(1, round(scale * rng.integers(5, 13))))},
}

OUTSIDE_SIZES: dict[str, Draw] = {
    "slip": lambda rng, at, scale: {"jump_mm": scale * near(rng, 0.08)},
    "pitch_error": lambda rng, at, scale: {"amplitude_mm": scale * near(rng, 0.015), "pitch_mm": near(rng, 0.7)},
    "permanent_set": lambda rng, at, scale: {"share": scale * near(rng, 0.02)},
    "adhesion": lambda rng, at, scale: {"pull_N": scale * near(rng, 0.2), "reach_mm": near(rng, 0.2)},
    "guide_friction": lambda rng, at, scale: {"friction_N": scale * near(rng, 0.15)},
    "modulus_temperature": lambda rng, at, scale: {"coefficient_per_K": scale * _signed(rng, 5e-3)},
    "contact_growth": lambda rng, at, scale: {
        "growth": scale * near(rng, 0.35),
        "half_N": at.peak_N * rng.uniform(0.1, 0.3),
    },
    "sensitivity_ageing": lambda rng, at, scale: {"rate_per_s": scale * _signed(rng, 1.5e-3)},
    "divider_temperature": lambda rng, at, scale: {"coefficient_per_K": scale * _signed(rng, 1e-3)},
    "adc_inl": lambda rng, at, scale: {
        "amplitude_V": scale * near(rng, 6e-3),
        "period_V": at.span_V * rng.uniform(0.3, 0.6),
    },
    "spikes": lambda rng, at, scale: {"height_V": scale * near(rng, 0.06), "rate_per_s": near(rng, 0.5)},
    "cable_drag": lambda rng, at, scale: {"drag_N_per_mm": scale * near(rng, 0.06)},
    "inertia": lambda rng, at, scale: {"mass_kg": scale * near(rng, 2.5)},
    "cell_filter": lambda rng, at, scale: {"tau_s": scale * near(rng, 0.12)},
    "cell_hysteresis": lambda rng, at, scale: {"size": scale * near(rng, 0.04), "scale_N": near(rng, 1.0)},
    "cell_span_temperature": lambda rng, at, scale: {"coefficient_per_K": scale * _signed(rng, 4e-3)},
    "jitter": lambda rng, at, scale: {"spread_s": scale * near(rng, 6e-3)},
}
