"""Published equations that the solver was not written for: five forms of causes, five effects outside.

Each docstring cites the model. No equation was chosen by the capability of the diagnosis.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls
from scipy.signal import butter, lfilter
from scipy.special import erf

from softcal.core.challenge.equations import equations, hum, in_other_forms
from softcal.core.challenge.operators import low_passes, recursion
from softcal.core.challenge.rig import Moment
from softcal.core.recording import Array

BRANCHES = 24
"""Exponentials that stand for a published relaxation law, over six decades of time."""


def _as_branches(law: Callable[[Array], Array], tau_s: float) -> tuple[list[float], list[float]]:
    """Return weights >= 0 and times of exponentials 1 − exp(−t/τᵢ) that add up to a law."""
    taus_s = np.geomspace(1e-3 * tau_s, 1e3 * tau_s, BRANCHES)
    t_s = np.geomspace(1e-3 * tau_s, 1e2 * tau_s, 300)
    weights, _ = nnls(1.0 - np.exp(-t_s[:, None] / taus_s), law(t_s))
    return weights.tolist(), taus_s.tolist()


def _kohlrausch_relaxation(force_N: Array, at: Moment, share: float, tau_s: float) -> Array:
    """1 − exp(−√(t/τ)): Kohlrausch 1854; Williams and Watts, Trans. Faraday Soc. 66 (1970)."""
    weights, taus_s = _as_branches(lambda t_s: 1.0 - np.exp(-np.sqrt(t_s / tau_s)), tau_s)
    return np.maximum(0.0, force_N - share * low_passes(force_N, at.step_s, weights, taus_s))


def _ogden_roxburgh(force_N: Array, at: Moment, size: float, cycles: float) -> Array:
    """η = 1 − erf((Wm − W)/m)/r: Ogden and Roxburgh, Proc. R. Soc. Lond. A 455 (1999).

    W is the stored energy, Wm the largest so far, 1/r the size; `cycles` scales m in units of the
    largest energy of a press to 3 N.
    """
    energy = at.rig.k1_N_mm * at.compression_mm**2 / 2.0 + at.rig.k3_N_mm3 * at.compression_mm**4 / 4.0
    max_energy = np.maximum.accumulate(energy)
    scale = cycles * 0.5 * 3.0**2 / (2.0 * at.rig.k1_N_mm)
    return np.asarray(force_N * (1.0 - size * erf((max_energy - energy) / scale)))


@recursion
def _dahl_state(signal: Array, scale: float) -> Array:  # pragma: no cover - compiled
    out = np.empty_like(signal)
    state = 0.0
    out[0] = state
    for k in range(1, len(signal)):
        step = (signal[k] - signal[k - 1]) / scale
        sign = 1.0 if step > 0.0 else -1.0
        # dz/dx = (1 − z·sign)² has the solution 1/(1 − z·sign) = 1/(1 − z₀·sign) + |x|.
        remainder = max(1.0 - state * sign, 1e-12)
        state = sign * (1.0 - 1.0 / (1.0 / remainder + abs(step)))
        out[k] = state
    return out


def _dahl_channel(load: Array, at: Moment, size: float, scale_N: float) -> Array:
    """dz/dx = (1 − z·sign ẋ)²/scale: Dahl, Aerospace Corporation TOR-0158(3107-18)-1 (1968)."""
    return load * (1.0 + size * _dahl_state(load, scale_N))


def _butterworth_lag(volts: Array, at: Moment, tau_s: float) -> Array:
    """Maximally flat third-order low-pass of the delay τ: Butterworth, Wireless Engineer 7 (1930).

    Symmetric weights (sinc³) would be a delay with some smoothing: the catalogue's clock offset.
    """
    numerator, denominator = butter(3, 2.0 / tau_s * at.step_s / np.pi)
    return np.asarray(lfilter(numerator, denominator, volts - volts[0]) + volts[0])


def _andrade_creep(force_N: Array, at: Moment, share: float, tau_s: float) -> Array:
    """Transient creep of a metal spring, (t/τ)^(1/3): Andrade, Proc. R. Soc. Lond. A 84 (1910)."""
    weights, taus_s = _as_branches(lambda t_s: np.cbrt(t_s / tau_s), tau_s)
    return force_N + 0.6 * share * low_passes(force_N, at.step_s, weights, taus_s)


def _screw_growth(stage_mm: Array, at: Moment, growth: float, tau_s: float) -> Array:
    """Return the growth of a ball screw with warming: Ramesh and others, Int. J. Mach. Tools Manuf. 40 (2000)."""
    return np.asarray(stage_mm * (1.0 - growth * -np.expm1(-at.t_s / tau_s)))


def _rate_stiffening(force_N: Array, at: Moment, size: float, speed_mm_s: float) -> Array:
    """Stiffness grows as (v/C)^(1/4): Cowper and Symonds, Brown University report C11-28 (1957)."""
    speed = np.abs(np.gradient(at.compression_mm, at.step_s))
    return np.asarray(force_N * (1.0 + size * (speed / speed_mm_s) ** 0.25))


def _film_contact(ohm: Array, at: Moment, film_ohm: float, load_N: float) -> Array:
    """A film resistance that falls as F^(−1/2): Holm, Electric Contacts, 4th edition (1967)."""
    return np.asarray(ohm + film_ohm / np.sqrt(1.0 + np.maximum(0.0, at.force_N) / load_N))


def _cell_ringing(force_N: Array, at: Moment, frequency_Hz: float, damping: float) -> Array:
    """Cell and platen swing: Boschetti and others, Mech. Syst. Signal Process. 34 (2013)."""
    turn = 2.0 * np.pi * frequency_Hz * at.step_s
    # ẍ = ω²·(u − x) − 2·d·ω·ẋ by semi-implicit steps from rest.
    swing = [1.0, turn**2 + 2.0 * damping * turn - 2.0, 1.0 - 2.0 * damping * turn]
    return np.asarray(force_N[0] + lfilter([turn**2], swing, force_N - force_N[0]))


PUBLISHED_FORMS = in_other_forms(
    {
        ("stress_relaxation", "kohlrausch"): _kohlrausch_relaxation,
        ("mullins_softening", "ogden_roxburgh"): _ogden_roxburgh,
        ("channel_hysteresis", "dahl"): _dahl_channel,
        ("readout_lag", "butterworth"): _butterworth_lag,
        ("loadcell_creep", "andrade"): _andrade_creep,
    }
)
"""By (effect, form); each takes the parameters of the catalogue's and is about as large."""

PUBLISHED_OUTSIDE = equations(
    {
        "screw_growth": ("position", _screw_growth),
        "rate_stiffening": ("elastic", _rate_stiffening),
        "film_contact": ("resistance", _film_contact),
        # Pick-up that is not the mains: Ott, Electromagnetic Compatibility Engineering (2009), ch. 2.
        "stray_tone": ("pickup", hum),
        "cell_ringing": ("cell", _cell_ringing),
    }
)
"""Published effects outside the catalogue by name."""
