"""Shrink of the gap by a report's twin on a held-out run.

The twin's numbers come from the report; the equations, the recording and the refit of the bare base
are this package's own, so a mistake of the diagnosis cannot hide here.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from softcal.core.challenge.answers import MIN_REPORTED_PROBABILITY
from softcal.core.challenge.cases import SealedCase
from softcal.core.challenge.equations import CATALOGUE_FORM
from softcal.core.challenge.rig import Cause, Measured, Rig
from softcal.core.recording import Array

PER_RUN = ("intermittent_contact", "dropped_samples", "mains_hum")
"""Effects whose places or phases belong to one recording and tell nothing of another."""

MIN_GAP = 0.05
"""Least gap, in units of the noise, whose shrink can be told from the noise."""

BASE = ("u0_mm", "k1_N_mm", "k3_N_mm3", "r0_ohm", "kappa_per_N")

PARAMETERS: Mapping[str, tuple[tuple[str, str], ...]] = {
    "backlash": (("b", "width_mm"),),
    "contact_shift": (("s", "shift_mm"), ("tau", "tau_s")),
    "frame_compliance": (("c_f", "compliance_mm_per_N"),),
    "misaligned_contact": (("l", "length_mm"),),
    "stress_relaxation": (("g", "share"), ("tau", "tau_s")),
    "mechanical_hysteresis": (("a", "size"), ("d0", "scale_mm")),
    "mullins_softening": (("m", "size"), ("N0", "cycles")),
    "channel_creep": (("c", "share"), ("tau", "tau_s")),
    "channel_hysteresis": (("a", "size"), ("f0", "scale_N")),
    "channel_collapse": (("beta", "size_per_N2"), ("Fc", "onset_N")),
    "thermal_drift": (("alpha", "coefficient_per_K"),),
    "ageing_drift": (("gamma", "size"), ("tau", "tau_s")),
    "readout_lag": (("tau", "tau_s"),),
    "wiring_resistance": (("Rw", "wire_ohm"),),
    "reference_drift": (("rho", "rate_per_s"),),
    "adc_saturation": (("V_max", "high_V"),),
    "loadcell_saturation": (("F_sat", "saturation_N"),),
    "loadcell_nonlinearity": (("lambda", "size"), ("F_max", "capacity_N")),
    "loadcell_creep": (("k", "share"), ("tau", "tau_s")),
    "loadcell_drift": (("r", "rate_N_per_s"),),
    "clock_offset": (("delta", "delay_s"),),
    "clock_skew": (("epsilon", "skew"),),
}
"""Per effect, the report's parameter and the name of the same quantity here."""

OTHER_PARAMETERS = {"adc_saturation": (("V_min", "low_V"),)}
"""What a report names where the other side of an effect is at work."""

UNFITTED: Mapping[str, Mapping[str, float]] = {
    "adc_saturation": {"low_V": 0.0, "high_V": 1e3},
    "loadcell_nonlinearity": {"capacity_N": 10.0},
}
"""Values where a report has none."""


def explained_fraction(case: SealedCase, report: Mapping[str, Any]) -> float:
    """Return 1 − (after − floor)/(before − floor) on the held-out run, channels in units of noise.

    Args:
        report: of schema `softcal.gap/1` with the fitted `base`; the twin has its named causes.

    Returns:
        NaN where the report names no twin, a cause belongs to one recording only, or the bare base
        leaves no gap; 0 where its numbers make no twin.
    """
    parameters_by_effect = {
        c["effect"]: c.get("parameters") for c in report["causes"] if c["probability"] >= MIN_REPORTED_PROBABILITY
    }
    if "base" not in report or not parameters_by_effect or any(effect in PER_RUN for effect in parameters_by_effect):
        return float("nan")
    try:
        rig, causes = with_base(case.rig, report["base"]), []
        for effect, fitted in parameters_by_effect.items():
            names = (*PARAMETERS[effect], *OTHER_PARAMETERS.get(effect, ()))
            values = {
                parameter: _finite(fitted[report_name]["value"])
                for report_name, parameter in names
                if report_name in fitted
            }
            causes.append(Cause(effect, CATALOGUE_FORM, {**UNFITTED.get(effect, {}), **values}))
        measured = case.measure(case.kept_back)
        with np.errstate(all="ignore"):
            after = _gap(case, measured, rig, tuple(causes))
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError):
        return 0.0
    if not np.isfinite(after):
        return 0.0
    before = _gap(case, measured, refit_base(case), ())
    return float("nan") if before < MIN_GAP else 1.0 - after / before


def _finite(value: Any) -> float:
    if not np.isfinite(number := float(value)):
        raise ValueError(f"{value} is no finite number")
    return number


def with_base(rig: Rig, base: Mapping[str, float]) -> Rig:
    """Return the rig with other base parameters, by the names of `BASE`."""
    parameters: dict[str, Any] = {name: _finite(base[name]) for name in BASE}
    return replace(rig, **parameters)


def _gap(case: SealedCase, measured: Measured, rig: Rig, causes: tuple[Cause, ...]) -> float:
    """Return the sum over channels of (RMS residual − floor)/noise; the floor is the residual of the true rig."""
    residuals = residual_rms(case, measured, rig, causes)
    min_share = residual_rms(case, measured, case.rig, case.causes)
    return sum(max(0.0, after - noise_floor) for after, noise_floor in zip(residuals, min_share, strict=True))


def residual_rms(case: SealedCase, measured: Measured, rig: Rig, causes: tuple[Cause, ...]) -> list[float]:
    """RMS of measured − predicted per channel, in units of its noise."""
    model = replace(case, rig=rig.without_noise(), causes=causes)
    predicted = model.measure(case.kept_back).columns
    return [float(np.sqrt(np.mean(part**2))) for part in _residuals(case.rig, measured.columns, predicted)]


def _residuals(rig: Rig, measured: Mapping[str, Array], predicted: Mapping[str, Array]) -> list[Array]:
    noise = {"output_V": rig.noise_floor_V, "force_N": rig.noise_N}
    return [(measured[name] - predicted[name]) / noise[name] for name in noise if name in measured]


def refit_base(case: SealedCase) -> Rig:
    """Fit the bare base model to the runs handed over, by SciPy's trust-region least squares."""
    recordings = [(plan, case.measure(plan).columns) for plan in case.plans]
    start = np.array([getattr(case.rig, name) for name in BASE])

    def moved(factors: Array) -> Rig:
        return with_base(case.rig, dict(zip(BASE, (start * factors).tolist(), strict=True)))

    def residuals(factors: Array) -> Array:
        model = replace(case, rig=moved(factors).without_noise(), causes=())
        parts = [_residuals(case.rig, columns, model.measure(plan).columns) for plan, columns in recordings]
        return np.concatenate([part for run in parts for part in run])

    bounds = (np.array([0.05, 0.2, 0.0, 0.3, 0.3]), np.array([4.0, 3.0, 5.0, 2.0, 1.5]))
    return moved(least_squares(residuals, np.ones(len(BASE)), bounds=bounds, diff_step=1e-4, max_nfev=12).x)
