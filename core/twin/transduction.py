"""Transduction: the channel turns the force F into a resistance, R = R0/(1 − κ·F)."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from softcal.core.messages.reason import Reason
from softcal.core.recording import Array
from softcal.core.twin.effects import (
    Alias,
    Effect,
    Flow,
    Hook,
    Memory,
    Parameter,
    SearchTarget,
    Signs,
    grows,
    memory,
    set_signal,
)
from softcal.core.twin.forms import doubled_form, extended_form, loops, low_passes, stop_form, stops
from softcal.core.twin.probes import Shapes, Sizes, TimeConstants
from softcal.core.twin.signals import compiled, low_pass

COLLAPSED = 0.02
"""Smallest 1 − κ·F that is computed: below, the channel is shut and the form has no meaning."""


@compiled
def channel_resistance(drive: Array, r0: float, kappa: float) -> Array:
    """Return R = R0/(1 − κ·F) in Ω (Park and others 2010, pressure form; Kim and others 2020)."""
    out = np.empty_like(drive)
    for k in range(len(drive)):
        # There is a pole where the channel is shut; a fit that steps over it must not see a sign change.
        out[k] = r0 / max(1.0 - kappa * drive[k], COLLAPSED)
    return out


def _creep(flow: Flow, v: Sequence[float], state: Memory) -> Array:
    prompt_share = 1.0 - v[0] - sum(v[2::2])
    return np.asarray(prompt_share * flow.drive + low_passes(flow.drive, flow.step_s, v, state))


def _thermal_drift(flow: Flow, v: Sequence[float], state: Memory) -> None:
    if flow.temperature_rise_K is not None:
        delayed_K, (alpha, alpha2, tau_s) = flow.temperature_rise_K, (*v, 0.0, 0.0)[:3]
        if tau_s > 0:
            delayed_K = low_pass(delayed_K, flow.step_s, tau_s, memory(state, "felt_K", 0.0, 0.0))
        flow.resistance_ohm = flow.resistance_ohm * (1.0 + alpha * delayed_K + alpha2 * delayed_K**2)


def _ageing_power(flow: Flow, v: Sequence[float], _: Memory) -> Array:
    x = 1.0 + flow.t_s / v[1]
    return np.asarray(np.log(x) if abs(v[2]) < 1e-6 else (x ** v[2] - 1.0) / v[2])


def _over(flow: Flow, onset: float) -> Array:
    # Below its threshold the walls do not touch; the term and its slope are both 0 there.
    return np.maximum(0.0, flow.drive - onset)


def _intermittent_contact(flow: Flow, values: Sequence[float], _: Memory) -> None:
    bad = np.zeros(len(flow.t_s), dtype=np.bool_)
    for start_s, stop_s in flow.episodes.get("intermittent_contact", ()):
        bad |= (flow.t_s >= start_s) & (flow.t_s < stop_s)
    flow.resistance_ohm = flow.resistance_ohm + values[0] * bad
    # The samples at which a contact opens or closes: no straight line between samples holds there.
    flow.is_unforeseeable = np.diff(bad, prepend=bad[:1])


CLIMATE = Reason("gap.remedy.climate")
"""What tells the slow drifts of the output apart where no run does."""

DIVIDER = Alias(
    stage="electronics",
    detail=Reason("gap.alias.divider"),
    # A channel of liquid metal (1e-3/K) follows the temperature more than a resistor does.
    share=0.4,
    distinguished_by="dummy_resistor",
    changing="temperature_C",
    by=1.0,
    advice=Reason("gap.advice.warm_dummy"),
)

in_stage = partial(Effect, stage="transduction")

EFFECTS = (
    in_stage(
        id="channel_creep",
        hook=Hook.CHANNEL,
        equation="Fc = (1 − c)·F + c·LP_τ[F]",
        source="delayed closing of an embedded channel, Kelvin–Voigt; 1–10 % over 0.05–100 s",
        parameters=(
            Parameter("c", "", 0.0, 1.0, 0.08, neutral=0.0),
            Parameter("tau", "s", 0.03, 300.0, 5.0, scale="log"),
        ),
        step=set_signal("drive", _creep),
        signs=Signs(
            probes=TimeConstants(0.02),
            confounders=("readout_lag", "clock_offset"),
            best_experiments=("rate_sweep", "steps_with_holds"),
        ),
    ).with_forms(doubled_form("two creep times")),
    in_stage(
        id="channel_hysteresis",
        hook=Hook.CHANNEL,
        equation="Fc = F·(1 + a·z), dz/dt = (dF/dt)/f0·(1 − z·sign(dF/dt))",
        source="rate-independent hysteresis, Duhem form; 1–5 % in eGaIn channels",
        parameters=(
            Parameter("a", "", 0.0, 0.5, 0.04, neutral=0.0),
            Parameter("f0", "N", 0.05, 20.0, 1.0, scale="log"),
        ),
        step=set_signal("drive", lambda flow, v, state: flow.drive * loops(flow.drive, v, state)),
        signs=Signs(
            probes=Shapes(0.01, (0.02, 0.06, 0.2, 0.6), "force_N"),
            confounders=("clock_offset", "channel_creep"),
            best_experiments=("rate_sweep", "small_reversals"),
        ),
    ).with_forms(
        doubled_form("two loops"),
        stop_form(
            set_signal("drive", lambda flow, v, state: flow.drive + stops(flow.drive, v, state, "reach_N")),
            "stop operators on the force",
            "reach_N",
        ),
    ),
    in_stage(
        id="channel_collapse",
        hook=Hook.RESISTANCE,
        equation="R = R0/(1 − κ·F)·(1 + β·max(0, F − Fc)²)",
        source="closing of a microchannel under pressure, Park and others 2010; above 60–80 % of the limit",
        parameters=(Parameter("beta", "1/N²", 0.0, 5.0, 0.03, neutral=0.0), Parameter("Fc", "N", 0.2, 50.0, 4.0)),
        step=grows("resistance_ohm", lambda flow, v, state: _over(flow, v[1]) ** 2),
        signs=Signs(
            probes=Shapes(0.6, (0.1, 0.3, 0.5, 0.65, 0.8, 0.9), "force_N", "per_force2"),
            confounders=("wiring_resistance", "loadcell_nonlinearity", "loadcell_saturation"),
            best_experiments=("dummy_resistor", "dead_weights"),
        ),
    ).with_forms(
        extended_form(
            grows("resistance_ohm", lambda flow, v, state: _over(flow, v[1]) ** v[2]),
            "power law",
            (Parameter("power", "", 0.7, 6.0, 0.5), 2.0),
        )
    ),
    in_stage(
        id="thermal_drift",
        hook=Hook.RESISTANCE,
        equation="R0(t) = R0·(1 + α·(T(t) − T(0)))",
        source="temperature coefficient of a liquid-metal channel, about 1e-3/K",
        parameters=(Parameter("alpha", "1/K", -0.02, 0.02, 0.001, neutral=0.0),),
        step=_thermal_drift,
        signs=Signs(
            needs=("temperature_C",),
            probes=Sizes((0.001,)),
            confounders=("ageing_drift", "reference_drift"),
            best_experiments=("dummy_resistor",),
            remedy=CLIMATE,
            alias=DIVIDER,
        ),
    ).with_forms(
        extended_form(
            _thermal_drift,
            "curved, felt with a delay",
            (Parameter("alpha2", "1/K²", -0.01, 0.01, 1e-4), 0.0),
            (Parameter("tau", "s", 0.0, 200.0, 5.0), 0.5),
        )
    ),
    in_stage(
        id="ageing_drift",
        hook=Hook.RESISTANCE,
        equation="R0(t) = R0·(1 + γ·ln(1 + t/τ))",
        source="logarithmic ageing; 0.1–5 % per day",
        parameters=(
            Parameter("gamma", "", -0.06, 0.06, 0.005, neutral=0.0),
            Parameter("tau", "s", 0.5, 2000.0, 30.0, scale="log"),
        ),
        step=grows("resistance_ohm", lambda flow, v, state: np.log1p(flow.t_s / v[1])),
        signs=Signs(
            probes=Shapes(0.001, (0.01, 0.05, 0.2, 1.0), "duration_s"),
            confounders=("thermal_drift", "reference_drift"),
            best_experiments=("rest", "long_hold", "dummy_resistor"),
            remedy=CLIMATE,
        ),
    ).with_forms(
        extended_form(
            grows("resistance_ohm", _ageing_power), "power law", (Parameter("power", "", -2.0, 1.0, 0.3), 0.2)
        )
    ),
    in_stage(
        id="intermittent_contact",
        hook=Hook.RESISTANCE,
        equation="R + ΔR during a few intervals",
        source="loose lead of a channel; steps tied to the motion of the cable",
        parameters=(Parameter("dR", "ohm", -5.0, 50.0, 0.3, neutral=0.0),),
        step=_intermittent_contact,
        is_episodic=True,
        signs=Signs(
            search_target=SearchTarget.INTERVALS,
            confounders=("channel_creep", "dropped_samples"),
            best_experiments=("long_hold",),
        ),
    ),
)
