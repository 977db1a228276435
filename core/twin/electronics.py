"""Electronics: V = Vref·R/(R + Rs), with Gaussian noise and an ideal ADC.

The mean of the codes of an ADC that is coarse against its noise is a soft staircase of the clean output. With noise σ
before a rounding to steps q, E[round(V + n)] = V + Σ (−1)ᵏ·q/(πk)·sin(2πkV/q)·exp(−2(πkσ/q)²), and the variance around
that mean, averaged over V, is σ² + q²/12 − Σ q²/(2π²k²)·exp(−(2πkσ/q)²) (Widrow and Kollár, Quantization Noise, 2008).
From σ = 0.45 q on the stairs are below 1 % of a step.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from scipy.optimize import brentq

from softcal.core.recording import Array
from softcal.core.twin.effects import (
    Effect,
    Flow,
    Hook,
    Memory,
    Parameter,
    SearchTarget,
    Signs,
    adds,
    grows,
    hands_on,
    memory,
    set_signal,
)
from softcal.core.twin.forms import constant, drift_forms, extended_form
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.probes import ExcitationRange, Sizes
from softcal.core.twin.signals import compiled, low_pass, read_at
from softcal.core.twin.transduction import CLIMATE


def digitise(clean_V: Array, noise_V: Array, readout: ReadoutMetadata) -> Array:
    """Return the codes of an ideal ADC in V: rounded to q = Vref/(2ⁿ − 1), clipped to [0, Vref]."""
    step_V = readout.step_V
    return np.asarray(np.clip(np.round((clean_V + noise_V) / step_V) * step_V, 0.0, readout.vref_V))


SMOOTH = 0.45
"""Noise, in steps, from which the staircase is a straight line."""

SHARPEST = 0.05
"""Least noise, in steps, that is told apart: sharper stairs than that have no slope to fit by."""

HARMONICS = 12


@lru_cache(maxsize=256)
def dither_V(sigma_V: float, step_V: float) -> float | None:
    """Return the standard deviation of the noise before the ADC, from its codes; None if it smooths all steps."""
    target = (sigma_V / step_V) ** 2
    if target >= _variance(SMOOTH):
        return None
    if target <= _variance(SHARPEST):
        return SHARPEST * step_V
    return step_V * float(brentq(lambda noise: _variance(noise) - target, SHARPEST, SMOOTH))


def _variance(noise: float) -> float:
    """Return the variance of the codes in steps², for noise in steps."""
    k = np.arange(1, 40)
    return float(noise**2 + 1 / 12 - np.sum(np.exp(-((2 * np.pi * k * noise) ** 2)) / (2 * np.pi**2 * k**2)))


@compiled
def mean_code_V(clean_V: Array, noise_V: float, step_V: float) -> Array:
    """Return the mean of the codes, (n,) V, for a clean output and noise before the ADC."""
    out = clean_V.copy()
    for k in range(1, HARMONICS + 1):
        height = step_V / (np.pi * k) * np.exp(-2.0 * (np.pi * k * noise_V / step_V) ** 2)
        # Higher harmonics die out faster than exponentially: the rest is still smaller.
        if height < 1e-4 * step_V:
            break
        height = -height if k % 2 else height
        for i in range(len(out)):
            out[i] += height * np.sin(2.0 * np.pi * k * clean_V[i] / step_V)
    return out


def _lag(flow: Flow, state: Memory, name: str, tau_s: float) -> Array:
    return low_pass(flow.output_V, flow.step_s, tau_s, memory(state, name, flow.output_V[0], flow.output_V[0]))


def _lag_2(flow: Flow, v: Sequence[float], state: Memory) -> None:
    for name, tau_s in zip(("first_V", "second_V"), v, strict=True):
        flow.output_V = _lag(flow, state, name, max(tau_s, 1e-4))


def _lag_sampled(flow: Flow, v: Sequence[float], state: Memory) -> Array:
    """A first-order low pass computed sample by sample: its input is held, and its output is up to a sample late."""
    slow = _lag(flow, state, "low_pass_V", max(v[0], 1e-4))
    period_s = constant(v, state, 2, "period_s", lambda: float(np.median(flow.step_s[1:])))
    return read_at(flow.t_s, slow, flow.t_s - v[1] * period_s, state)


def _hum(flow: Flow, v: Sequence[float], _: Memory) -> Array:
    # The phase of this run, or the one there is.
    return np.asarray(np.sin(2 * np.pi * v[1] * flow.t_s + v[min(2 + flow.run, len(v) - 1)]))


HUM_STEP_Hz = 0.05
"""Scale on which the fit moves the frequency: it turns the phase about once in a run."""

PHASE_WEIGHT = 0.5
"""What the phase of one run counts as: known to a fifth of a period, far less than ln n."""

HUM = (
    Parameter("A", "V", 0.0, 0.5, 0.004, neutral=0.0),
    Parameter("f", "Hz", 0.0, 500.0, 10.0),
    Parameter("phi", "rad", -np.pi, np.pi, 0.0),
)


def _hum_of_runs(runs: int) -> Effect:
    """Return the hum with a phase per run: when a run begins is no property of the rig."""
    phases = [Parameter(f"phi{k}", "rad", -20.0, 20.0, 1.0, weight=PHASE_WEIGHT) for k in range(runs)]
    parameters = (HUM[0], replace(HUM[1], usual=HUM_STEP_Hz), *phases)
    return replace(MAINS_HUM, parameters=parameters)


def _near_the_top(at: ExcitationRange) -> list[tuple[float, ...]]:
    span_V = at.highest_V - at.lowest_V
    return [(at.highest_V - share * span_V,) for share in (1e-3, 0.01, 0.03, 0.08)]


in_stage = partial(Effect, stage="electronics")

MAINS_HUM = in_stage(
    id="mains_hum",
    hook=Hook.OUTPUT,
    equation="V + A·sin(2πft + φ), f the alias of 50 or 60 Hz at the sample rate",
    source="pick-up of the mains; 1–10 mV",
    parameters=HUM,
    step=adds("output_V", _hum),
    signs=Signs(search_target=SearchTarget.LINE, best_experiments=("rest",)),
    of_runs=_hum_of_runs,
)

CLIPPED_BELOW = in_stage(
    id="adc_saturation",
    hook=Hook.OUTPUT,
    equation="V clipped below V_min > 0",
    source="range of an amplifier or an ADC that does not reach zero",
    parameters=(Parameter("V_min", "V", 0.0, 100.0, 0.5, neutral=0.0),),
    step=set_signal("output_V", lambda flow, v, state: np.maximum(flow.output_V, v[0])),
    signs=Signs(search_target=SearchTarget.FLOOR),
)
"""The other side of a clipped output; a setting that gives `V_min` means this one."""

ADC_SATURATION = in_stage(
    id="adc_saturation",
    hook=Hook.OUTPUT,
    equation="V clipped above V_max < Vref",
    source="range of an amplifier or an ADC short of the rail",
    parameters=(Parameter("V_max", "V", 0.05, 100.0, 2.2, neutral=np.inf),),
    # A hard ceiling here, a soft one among the forms: amplifiers differ in how they clip.
    step=set_signal("output_V", lambda flow, v, state: np.minimum(flow.output_V, v[0])),
    signs=Signs(
        probes=_near_the_top,
        search_target=SearchTarget.CEILING,
        confounders=("loadcell_nonlinearity",),
        best_experiments=("dummy_resistor",),
    ),
    sides=(CLIPPED_BELOW,),
).with_forms(
    extended_form(
        set_signal("output_V", lambda flow, v, state: v[0] - v[1] * np.logaddexp(0.0, (v[0] - flow.output_V) / v[1])),
        "soft clip",
        (Parameter("width", "V", 1e-4, 0.5, 0.01), 0.01),
    )
)

EFFECTS = (
    in_stage(
        id="readout_lag",
        hook=Hook.OUTPUT,
        equation="V passes a first-order low-pass before the ADC",
        source="RC filter of the divider's input; 1–300 ms",
        parameters=(Parameter("tau", "s", 0.0005, 3.0, 0.08, neutral=0.0),),
        step=set_signal("output_V", lambda flow, v, state: _lag(flow, state, "low_pass_V", v[0])),
        signs=Signs(
            probes=Sizes((0.5, 3.0, 10.0), "period_s"),
            confounders=("channel_creep", "clock_offset"),
            best_experiments=("rate_sweep",),
        ),
    ).with_forms(
        extended_form(_lag_2, "second order", (Parameter("tau2", "s", 0.0, 3.0, 0.05), 0.02)),
        extended_form(
            set_signal("output_V", _lag_sampled),
            "computed sample by sample",
            (Parameter("late", "", -0.6, 1.1, 0.5), 0.0),
            constants=("period_s",),
        ),
    ),
    in_stage(
        id="wiring_resistance",
        hook=Hook.REFERENCE,
        equation="V = Vref·(R + Rw)/(R + Rw + Rs)",
        source="leads and contacts in series with the channel, Ohm; 0.05–1 Ω",
        parameters=(Parameter("Rw", "ohm", 0.0, 50.0, 0.5, neutral=0.0),),
        step=hands_on("wiring_ohm"),
        signs=Signs(
            probes=Sizes((0.01, 0.1), "series_ohm"),
            confounders=("channel_collapse", "loadcell_nonlinearity"),
            best_experiments=("dummy_resistor",),
        ),
    ),
    in_stage(
        id="reference_drift",
        hook=Hook.REFERENCE,
        equation="Vref(t) = Vref·(1 + ρ·t); the ADC reads against the nominal Vref",
        source="supply that warms up; linear over a run",
        parameters=(Parameter("rho", "1/s", -0.003, 0.003, 0.0001, neutral=0.0),),
        step=grows("reference_V", lambda flow, v, state: flow.t_s),
        signs=Signs(
            probes=Sizes((0.01,), "rate_per_s"),
            confounders=("ageing_drift", "thermal_drift"),
            best_experiments=("dummy_resistor", "long_hold"),
            remedy=CLIMATE,
        ),
    ).with_forms(*drift_forms(partial(grows, "reference_V"))),
    MAINS_HUM,
    ADC_SATURATION,
)
