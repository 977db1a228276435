"""Acquisition: all channels are sampled at the same instants, but for the output's clock.

A stream cannot know the output of later instants. Where an effect asks for them (a clock that runs ahead, samples that
were lost), the last two samples are extended by a straight line; a batch uses the true ones.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, SearchTarget, Signs
from softcal.core.twin.forms import extended_form
from softcal.core.twin.probes import Sizes
from softcal.core.twin.signals import extend_buffer, read_at


def _read_at(flow: Flow, instants_s: Array, state: Memory) -> None:
    buffer_s, buffer_V = extend_buffer(flow.t_s, flow.output_V, instants_s, state)
    flow.output_V = np.interp(instants_s, buffer_s, buffer_V)
    late = instants_s > buffer_s[-1] + 1e-9
    earlier = flow.is_unforeseeable
    flow.is_unforeseeable = late
    if earlier is not None and len(earlier) == len(buffer_s):
        # Straight lines between the samples beside a step cut its corner.
        at = np.clip(np.searchsorted(buffer_s, instants_s), 1, len(buffer_s) - 1)
        flow.is_unforeseeable = late | earlier[at] | earlier[at - 1]
    if late.any() and len(buffer_s) > 1:
        slope = (buffer_V[-1] - buffer_V[-2]) / (buffer_s[-1] - buffer_s[-2])
        flow.output_V[late] = buffer_V[-1] + slope * (instants_s[late] - buffer_s[-1])


def _clock_offset(flow: Flow, values: Sequence[float], state: Memory) -> None:
    _read_at(flow, flow.t_s - values[0], state)


def _clock_skew(flow: Flow, values: Sequence[float], state: Memory) -> None:
    _read_at(flow, flow.t_s * (1.0 + values[0]), state)


def _dropped_samples(flow: Flow, _: Sequence[float], state: Memory) -> None:
    # The median: the step across a gap is no sampling period.
    period_s = float(np.median(flow.step_s[flow.step_s > 0])) if np.any(flow.step_s > 0) else 0.0
    instants_s = flow.t_s.copy()
    for loss_s, count in flow.episodes.get("dropped_samples", ()):
        # Later samples close up: each loss moves all that follow it.
        instants_s = instants_s + count * period_s * (flow.t_s >= loss_s)
    _read_at(flow, instants_s, state)


def _skew_curve(flow: Flow, v: Sequence[float], state: Memory) -> None:
    instants_s = flow.t_s * (1.0 + v[0] + v[1] * flow.t_s)
    flow.output_V = read_at(flow.t_s, flow.output_V, instants_s, state)


in_stage = partial(Effect, stage="acquisition", hook=Hook.CLOCK)

EFFECTS = (
    in_stage(
        id="clock_offset",
        equation="output_V(t) is the true V(t − Δ)",
        source="latency of a serial link; 1–50 ms over USB",
        parameters=(Parameter("delta", "s", -2.0, 2.0, 0.04, neutral=0.0),),
        step=_clock_offset,
        signs=Signs(
            probes=Sizes((0.5, -0.5), "period_s"),
            clock="delay",
            confounders=("channel_creep", "readout_lag"),
            best_experiments=("rate_sweep", "fast_ramps"),
        ),
    ),
    in_stage(
        id="clock_skew",
        equation="output_V(t) is V(t·(1 + ε))",
        source="10–100 ppm for a crystal, up to 1 % for an RC clock",
        parameters=(Parameter("epsilon", "", -0.03, 0.03, 0.001, neutral=0.0),),
        step=_clock_skew,
        signs=Signs(
            probes=Sizes((2.0,), "period_per_duration"),
            clock="rate",
            confounders=("dropped_samples", "clock_offset"),
            best_experiments=("fast_ramps",),
        ),
    ).with_forms(extended_form(_skew_curve, "bending clock", (Parameter("bend", "1/s", -1e-3, 1e-3, 1e-5), 0.0))),
    in_stage(
        id="dropped_samples",
        equation="output samples missing, later ones closed up",
        source="overrun of a serial buffer; blocks of 1–100 samples",
        parameters=(Parameter("count", "", 0.0, 1000.0, 5.0, neutral=0.0),),
        step=_dropped_samples,
        is_episodic=True,
        signs=Signs(search_target=SearchTarget.LOSSES, confounders=("clock_skew",), best_experiments=("fast_ramps",)),
    ),
)
