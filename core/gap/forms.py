"""Other realisations of the catalogue's causes: what a rig may show instead of the catalogue's own equation.

A cause is named by its place and character, not by its formula: several relaxation times instead of one, stop
operators instead of a Duhem loop, a power law instead of a logarithm. Each form carries the identifier of its cause,
so that a diagnosis can name the cause and describe what the catalogue's equation leaves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Effect, Flow, Memory, Parameter, Step
from softcal.core.twin.signals import direction_state, low_pass, play

STOPS = (0.03, 0.1, 0.25, 0.6)
"""Strokes of the stop operators of a Prandtl–Ishlinskii loop, as shares of the largest value of their input."""

SPLIT = 4.0
"""Two time constants or loop widths begin this factor above and below the one that was fitted."""


@dataclass(frozen=True)
class Form:
    """Another realisation of a cause.

    Args:
        effect: the realisation; its identifier is that of the cause.
        carry: value of every parameter from the catalogue's values, as (index of the value or None, factor or value).
    """

    effect: Effect
    carry: tuple[tuple[int | None, float], ...]

    def start(self, values: Sequence[float]) -> list[float]:
        """Return where a fit of this form begins when the catalogue's equation ended at these values."""
        return [number if index is None else values[index] * number for index, number in self.carry]


def _relaxation_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    slow = v[0] * low_pass(flow.force_N, flow.step_s, v[1], np.zeros(2))
    slow += v[2] * low_pass(flow.force_N, flow.step_s, v[3], np.zeros(2))
    flow.force_N = np.maximum(0.0, flow.force_N - slow)


def _creep_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    slow = v[0] * low_pass(flow.drive, flow.step_s, v[1], np.zeros(2))
    slow += v[2] * low_pass(flow.drive, flow.step_s, v[3], np.zeros(2))
    flow.drive = (1.0 - v[0] - v[2]) * flow.drive + slow


def _cell_creep_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    slow = v[0] * low_pass(flow.reading_N, flow.step_s, v[1], np.zeros(2))
    slow += v[2] * low_pass(flow.reading_N, flow.step_s, v[3], np.zeros(2))
    flow.reading_N = flow.reading_N + slow


def _shift_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    settled = v[0] * -np.expm1(-flow.t_s / v[1]) + v[2] * -np.expm1(-flow.t_s / v[3])
    flow.contact_mm = flow.contact_mm + settled


def _loops(signal: Array, v: Sequence[float]) -> Array:
    one = direction_state(signal, v[1], np.array([0.0, signal[0]]))
    two = direction_state(signal, v[3], np.array([0.0, signal[0]]))
    return 1.0 + v[0] * one + v[2] * two


def _mechanical_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.force_N = flow.force_N * _loops(flow.deformation_mm, v)


def _channel_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.drive = flow.drive * _loops(flow.drive, v)


def _stops(signal: Array, weights: Sequence[float]) -> Array:
    """Return Σ wᵢ·(x − play_rᵢ(x)): stop operators, each saturating after its own stroke (Brokate, Sprekels 1996)."""
    out = np.zeros_like(signal)
    largest = float(np.max(np.abs(signal))) or 1.0
    for weight, share in zip(weights, STOPS, strict=True):
        width = share * largest
        out += weight * (signal - play(signal, width, np.array([signal[0] - width])))
    return out


def _force_stops(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.force_N = np.maximum(0.0, flow.force_N + _touching(flow) * _stops(flow.force_N, v))


def _stroke_stops(flow: Flow, v: Sequence[float], _: Memory) -> None:
    stiffness = float(np.max(flow.force_N)) / (float(np.max(flow.deformation_mm)) or 1.0)
    flow.force_N = np.maximum(0.0, flow.force_N + _touching(flow) * stiffness * _stops(flow.deformation_mm, v))


def _touching(flow: Flow) -> Array:
    return (flow.deformation_mm > 0).astype(np.float64)


def _channel_stops(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.drive = flow.drive + _stops(flow.drive, v)


def _mullins_deepest(flow: Flow, v: Sequence[float], _: Memory) -> None:
    deepest = np.maximum.accumulate(flow.deformation_mm)
    flow.force_N = flow.force_N * (1.0 + v[0] * np.expm1(-deepest / v[1]))


def _mullins_power(flow: Flow, v: Sequence[float], _: Memory) -> None:
    done = _completed(flow.deformation_mm)
    flow.force_N = flow.force_N * (1.0 + v[0] * ((1.0 + done / v[1]) ** -v[2] - 1.0))


def _completed(deformation: Array) -> Array:
    touching = deformation > 0
    return np.concatenate([[0.0], np.cumsum(touching[:-1] & ~touching[1:])])


def _ageing_power(flow: Flow, v: Sequence[float], _: Memory) -> None:
    x = 1.0 + flow.t_s / v[1]
    grown = np.log(x) if abs(v[2]) < 1e-6 else (x ** v[2] - 1.0) / v[2]
    flow.resistance_ohm = flow.resistance_ohm * (1.0 + v[0] * grown)


def _thermal_curve(flow: Flow, v: Sequence[float], _: Memory) -> None:
    if flow.temperature_rise_K is not None:
        felt = flow.temperature_rise_K
        if v[2] > 0:
            felt = low_pass(felt, flow.step_s, v[2], np.zeros(2))
        flow.resistance_ohm = flow.resistance_ohm * (1.0 + v[0] * felt + v[1] * felt**2)


def _collapse_power(flow: Flow, v: Sequence[float], _: Memory) -> None:
    over = np.maximum(0.0, flow.drive - v[1])
    flow.resistance_ohm = flow.resistance_ohm * (1.0 + v[0] * over ** v[2])


def _lag_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    for tau_s in v[:2]:
        start = np.full(2, flow.output_V[0])
        flow.output_V = low_pass(flow.output_V, flow.step_s, max(tau_s, 1e-4), start)


def _lag_sampled(flow: Flow, v: Sequence[float], _: Memory) -> None:
    """A filter computed sample by sample: its input is held, and it answers up to a sample late."""
    start = np.full(2, flow.output_V[0])
    slow = low_pass(flow.output_V, flow.step_s, max(v[0], 1e-4), start)
    period_s = float(np.median(flow.step_s[1:]))
    flow.output_V = np.interp(flow.t_s - v[1] * period_s, flow.t_s, slow)


def _cell_knee(flow: Flow, v: Sequence[float], _: Memory) -> None:
    if np.isfinite(v[0]):
        bent = (1.0 + np.abs(flow.reading_N / v[0]) ** v[1]) ** (1.0 / v[1])
        flow.reading_N = flow.reading_N / bent


def _cell_curve(flow: Flow, v: Sequence[float], _: Memory) -> None:
    part = flow.reading_N / 10.0
    flow.reading_N = flow.reading_N * (1.0 + v[0] * (1.0 - part) + v[1] * (1.0 - part**2) + v[2] * (1.0 - part**3))


def _cell_drift_power(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.reading_N = flow.reading_N + v[0] * _bent_time(flow.t_s, v[1])


def _reference_power(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.reference_V = flow.reference_V * (1.0 + v[0] * _bent_time(flow.t_s, v[1]))


def _bent_time(t_s: Array, power: float) -> Array:
    """Return a time that runs straight for power 1, ever slower below and faster above; equal to t after 30 s."""
    return np.asarray(30.0 * (t_s / 30.0) ** power)


def _cell_drift_settling(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.reading_N = flow.reading_N + v[0] * _settling_time(flow.t_s, v[1])


def _reference_settling(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.reference_V = flow.reference_V * (1.0 + v[0] * _settling_time(flow.t_s, v[1]))


def _settling_time(t_s: Array, tau_s: float) -> Array:
    """Return a time that runs like t at first and stands still after a few τ."""
    return np.asarray(-tau_s * np.expm1(-t_s / tau_s))


def _soft_clip(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.output_V = v[0] - v[1] * np.logaddexp(0.0, (v[0] - flow.output_V) / v[1])


def _frame_joint(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.compliance_mm_N = v[0]
    flow.toe_mm = v[1]


def _skew_curve(flow: Flow, v: Sequence[float], _: Memory) -> None:
    wanted_s = flow.t_s * (1.0 + v[0] + v[1] * flow.t_s)
    flow.output_V = np.interp(wanted_s, flow.t_s, flow.output_V)


def _form(
    effect_id: str,
    step: Step,
    what: str,
    parameters: Sequence[Parameter],
    carry: Sequence[tuple[int | None, float]],
) -> Form:
    effect = replace(EFFECTS[effect_id], step=step, parameters=tuple(parameters), equation=what)
    return Form(effect, tuple(carry))


def _two(effect_id: str, step: Step, what: str) -> Form:
    size, shape = EFFECTS[effect_id].parameters
    second = (replace(size, name=f"{size.name}2"), replace(shape, name=f"{shape.name}2"))
    carry = ((0, 0.5), (1, 1 / SPLIT), (0, 0.5), (1, SPLIT))
    return _form(effect_id, step, what, (size, shape, *second), carry)


def _stop_form(effect_id: str, step: Step, what: str) -> Form:
    weights = [Parameter(f"w{k}", "", -0.5, 1.0, 0.05, neutral=0.0) for k in range(len(STOPS))]
    return _form(effect_id, step, what, weights, [(0, 0.5)] * len(STOPS))


def _plus(effect_id: str, step: Step, what: str, *extra: tuple[Parameter, float]) -> Form:
    own = EFFECTS[effect_id].parameters
    carry: list[tuple[int | None, float]] = [(k, 1.0) for k in range(len(own))]
    return _form(effect_id, step, what, (*own, *(p for p, _ in extra)), [*carry, *((None, v) for _, v in extra)])


def _build() -> dict[str, tuple[Form, ...]]:
    def extra(name: str, unit: str, low: float, high: float, usual: float) -> Parameter:
        return Parameter(name, unit, low, high, usual)

    power = extra("power", "", 0.15, 3.0, 0.3)
    settling = Parameter("tau", "s", 3.0, 1000.0, 30.0, scale="log")
    tau_2 = extra("tau2", "s", 0.0, 3.0, 0.05)
    return {
        "contact_shift": (_two("contact_shift", _shift_2, "two settling times"),),
        "frame_compliance": (
            _plus("frame_compliance", _frame_joint, "joint that closes", (extra("l", "mm", 0.0, 0.5, 0.05), 0.01)),
        ),
        "stress_relaxation": (_two("stress_relaxation", _relaxation_2, "two relaxation times"),),
        "mechanical_hysteresis": (
            _two("mechanical_hysteresis", _mechanical_2, "two loops"),
            _stop_form("mechanical_hysteresis", _force_stops, "stop operators on the force"),
            _stop_form("mechanical_hysteresis", _stroke_stops, "stop operators on the compression"),
        ),
        "mullins_softening": (
            _plus("mullins_softening", _mullins_power, "power of the presses", (power, 0.5)),
            _form(
                "mullins_softening",
                _mullins_deepest,
                "softening with the deepest press so far",
                (EFFECTS["mullins_softening"].parameters[0], Parameter("depth", "mm", 0.1, 20.0, 2.0, scale="log")),
                ((0, 1.0), (None, 2.0)),
            ),
        ),
        "channel_creep": (_two("channel_creep", _creep_2, "two creep times"),),
        "channel_hysteresis": (
            _two("channel_hysteresis", _channel_2, "two loops"),
            _stop_form("channel_hysteresis", _channel_stops, "stop operators on the force"),
        ),
        "channel_collapse": (
            _plus("channel_collapse", _collapse_power, "power law", (extra("power", "", 0.7, 6.0, 0.5), 2.0)),
        ),
        "thermal_drift": (
            _plus(
                "thermal_drift",
                _thermal_curve,
                "curved, felt with a delay",
                (extra("alpha2", "1/K²", -0.01, 0.01, 1e-4), 0.0),
                (extra("tau", "s", 0.0, 200.0, 5.0), 0.5),
            ),
        ),
        "ageing_drift": (_plus("ageing_drift", _ageing_power, "power law", (extra("power", "", -2.0, 1.0, 0.3), 0.2)),),
        "readout_lag": (
            _plus("readout_lag", _lag_2, "second order", (tau_2, 0.02)),
            _plus("readout_lag", _lag_sampled, "computed sample by sample", (extra("late", "", -0.6, 1.1, 0.5), 0.0)),
        ),
        "reference_drift": (
            _plus("reference_drift", _reference_power, "power of time", (power, 0.8)),
            _plus("reference_drift", _reference_settling, "settling", (settling, 40.0)),
        ),
        "adc_saturation": (
            _plus("adc_saturation", _soft_clip, "soft clip", (extra("width", "V", 1e-4, 0.5, 0.01), 0.01)),
        ),
        "loadcell_saturation": (
            _plus("loadcell_saturation", _cell_knee, "knee", (extra("sharpness", "", 0.8, 30.0, 1.0), 2.0)),
        ),
        "loadcell_nonlinearity": (
            _plus(
                "loadcell_nonlinearity",
                _cell_curve,
                "cubic and quartic term",
                (extra("quadratic", "", -0.5, 0.5, 0.01), 0.0),
                (extra("cubic", "", -0.5, 0.5, 0.01), 0.0),
            ),
        ),
        "loadcell_creep": (_two("loadcell_creep", _cell_creep_2, "two creep times"),),
        "loadcell_drift": (
            _plus("loadcell_drift", _cell_drift_power, "power of time", (power, 0.8)),
            _plus("loadcell_drift", _cell_drift_settling, "settling", (settling, 40.0)),
        ),
        "clock_skew": (
            _plus("clock_skew", _skew_curve, "bending clock", (extra("bend", "1/s", -1e-3, 1e-3, 1e-5), 0.0)),
        ),
    }


FORMS: Mapping[str, tuple[Form, ...]] = MappingProxyType(_build())
"""Other realisations by cause; a cause that is missing here has one realisation only."""
