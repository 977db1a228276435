"""Load cell: the force becomes the force reading, F_meas = F + Gaussian noise."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs, adds, grows, set_signal
from softcal.core.twin.forms import doubled_form, drift_forms, extended_form, low_passes
from softcal.core.twin.probes import Shapes, Sizes, TimeConstants

SPAN = Parameter("F_max", "N", 10.0, 10.0, 10.0, weight=0.0, is_fixed=True)
"""Capacity of the cell of the common rig; it grows with the rig and is not fitted: another one is a
change of λ and of the gain."""


def _tanh(flow: Flow, v: Sequence[float], _: Memory) -> Array:
    return v[0] * np.tanh(flow.reading_N / v[0]) if np.isfinite(v[0]) else flow.reading_N


def _knee(flow: Flow, v: Sequence[float], _: Memory) -> Array:
    if not np.isfinite(v[0]):
        return flow.reading_N
    return np.asarray(flow.reading_N / (1.0 + np.abs(flow.reading_N / v[0]) ** v[1]) ** (1.0 / v[1]))


def _curve(flow: Flow, v: Sequence[float], _: Memory) -> Array:
    part = flow.reading_N / v[1]
    return flow.reading_N * (1.0 + v[0] * (1.0 - part) + v[2] * (1.0 - part**2) + v[3] * (1.0 - part**3))


in_stage = partial(Effect, stage="load_cell", hook=Hook.READING)

EFFECTS = (
    in_stage(
        id="loadcell_saturation",
        equation="F_meas = F_sat·tanh(F/F_sat)",
        source="cell or amplifier near its capacity",
        parameters=(Parameter("F_sat", "N", 0.5, 1000.0, 15.0, neutral=np.inf, scale="inverse_square"),),
        step=set_signal("reading_N", _tanh),
        signs=Signs(
            probes=Sizes((4.0,), "force_N"),
            confounders=("loadcell_nonlinearity", "channel_collapse", "frame_compliance"),
            best_experiments=("dead_weights",),
        ),
    ).with_forms(
        extended_form(set_signal("reading_N", _knee), "knee", (Parameter("sharpness", "", 0.8, 30.0, 1.0), 2.0))
    ),
    in_stage(
        id="loadcell_nonlinearity",
        equation="F_meas = F + λ·F·(1 − F/F_max)",
        source="terminal-line nonlinearity of a strain-gauge cell; 0.02–3 % of full scale",
        parameters=(Parameter("lambda", "", -0.25, 0.25, 0.03, neutral=0.0), SPAN),
        step=grows("reading_N", lambda flow, v, state: 1.0 - flow.reading_N / v[1]),
        signs=Signs(
            # The span has one value on a rig, whatever is tried.
            probes=Shapes(0.01, (1.0,), "force_N"),
            confounders=("loadcell_saturation", "channel_collapse", "wiring_resistance"),
            best_experiments=("dead_weights",),
        ),
    ).with_forms(
        extended_form(
            set_signal("reading_N", _curve),
            "cubic and quartic term",
            (Parameter("quadratic", "", -0.5, 0.5, 0.01), 0.0),
            (Parameter("cubic", "", -0.5, 0.5, 0.01), 0.0),
        )
    ),
    in_stage(
        id="loadcell_creep",
        equation="F_meas = F + k·LP_τ[F]",
        source="creep of the spring element, OIML R60; 0.05–0.2 % for cheap bars, more when overloaded",
        parameters=(
            Parameter("k", "", 0.0, 0.2, 0.02, neutral=0.0),
            Parameter("tau", "s", 0.3, 1000.0, 20.0, scale="log"),
        ),
        step=set_signal(
            "reading_N", lambda flow, v, state: flow.reading_N + low_passes(flow.reading_N, flow.step_s, v, state)
        ),
        signs=Signs(
            probes=TimeConstants(0.01, without=2),
            confounders=("loadcell_drift", "stress_relaxation"),
            best_experiments=("dead_weights", "long_hold"),
        ),
    ).with_forms(doubled_form("two creep times")),
    in_stage(
        id="loadcell_drift",
        equation="F_meas = F + r·t",
        source="zero drift of the amplifier; 0.01–0.1 % of full scale per K",
        parameters=(Parameter("r", "N/s", -0.1, 0.1, 0.001, neutral=0.0),),
        step=adds("reading_N", lambda flow, v, state: flow.t_s),
        signs=Signs(
            probes=Sizes((0.0125,), "force_rate_N_s"), confounders=("loadcell_creep",), best_experiments=("rest",)
        ),
    ).with_forms(*drift_forms(partial(adds, "reading_N"))),
)
