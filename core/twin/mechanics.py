"""Mechanics: the pad's position becomes a force, F = k1·δ + k3·δ³ with δ = max(0, u − u0)."""

from collections.abc import Sequence

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs, memory
from softcal.core.twin.forms import POWER, STOPS, constant, in_form, loops, plus, stop_form, stops, two, two_low_passes
from softcal.core.twin.motion import PLATEN
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.probes import Shapes, Sizes, Times
from softcal.core.twin.signals import compiled, completed_presses, direction_state, low_pass


def press(flow: Flow, base: BaseParameters) -> None:
    """Set deformation and force from the pad's position, with a toe and a soft frame."""
    indentation = np.maximum(0.0, flow.pad_mm - flow.contact_mm)
    if flow.toe_mm or flow.compliance_mm_N:
        frame = (flow.toe_mm, flow.toe_tail, flow.compliance_mm_N)
        indentation = soft_contact(indentation, frame, base.k1_N_mm, base.k3_N_mm3)
    flow.deformation_mm = indentation
    flow.force_N = elastic_force(indentation, base.k1_N_mm, base.k3_N_mm3)


@compiled
def elastic_force(deformation: Array, k1: float, k3: float) -> Array:
    """Return F = k1·δ + k3·δ³ in N; δ in mm."""
    return deformation * (k1 + k3 * deformation * deformation)


def elastic_force_at(stage_mm: Array, base: BaseParameters) -> Array:
    """Return the force of the base alone, in N, at stage positions."""
    return elastic_force(np.maximum(0.0, stage_mm - base.u0_mm), base.k1_N_mm, base.k3_N_mm3)


@compiled
def soft_contact(travel: Array, softness: tuple[float, float, float], k1: float, k3: float) -> Array:
    """Solve δ = toe(max(0, travel − c_f·F(δ))) for δ by Newton from the sample before; monotone, so one root.

    Args:
        travel: (n,) u − u0 where positive, else 0, mm.
        softness: length ℓ and tail s of the toe, compliance c_f of the frame. The toe is x − ℓ·(1 − rest(x)) with
            rest(x) = exp(−x/ℓ), or (1 + s·x/ℓ)^(−1/s) with a tail; ℓ = 0 mm for none. c_f in mm/N, 0 for a rigid frame.
    """
    toe, tail, compliance = softness
    out = np.empty_like(travel)
    x = 0.0
    for k in range(len(travel)):
        target = travel[k]
        # The root moves little from sample to sample; the target itself is the root of a rigid frame.
        x = min(x, target) if x > 0.0 else target
        deformation = 0.0
        for _ in range(30):
            rest, bend = _toe_rest(x, toe, tail)
            deformation = x - toe * (1.0 - rest)
            error = x + compliance * deformation * (k1 + k3 * deformation * deformation) - target
            slope = 1.0 + compliance * (k1 + 3.0 * k3 * deformation * deformation) * (1.0 - bend)
            # The root lies between no compression and the whole travel: a step beyond either would only come back.
            x = min(max(x - error / slope, 0.0), target)
            if abs(error) <= 1e-11 * target:
                break
        out[k] = x - toe * (1.0 - _toe_rest(x, toe, tail)[0])
    return out


@compiled
def _toe_rest(x: float, toe: float, tail: float) -> tuple[float, float]:
    """Return rest(x) of a toe and −ℓ·rest′(x); 0 and 0 without a toe."""
    if toe <= 0.0:
        return 0.0, 0.0
    if tail < 1e-6:
        rest = np.exp(-x / toe)
        return rest, rest
    reach = 1.0 + tail * x / toe
    rest = reach ** (-1.0 / tail)
    return rest, rest / reach


def _contact_shift(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.contact_mm = flow.contact_mm + values[0] * -np.expm1(-flow.t_s / values[1])


def _frame_compliance(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.compliance_mm_N = values[0]


def _misaligned_contact(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.toe_mm = values[0]


def _toe_with_tail(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.toe_mm = v[0]
    flow.toe_tail = v[1]


def _stress_relaxation(flow: Flow, values: Sequence[float], state: Memory) -> None:
    relaxed = low_pass(flow.force_N, flow.step_s, values[1], memory(state, "low_pass_N", 0.0, 0.0))
    flow.force_N = np.maximum(0.0, flow.force_N - values[0] * relaxed)


def _mechanical_hysteresis(flow: Flow, values: Sequence[float], state: Memory) -> None:
    start = memory(state, "z", 0.0, flow.deformation_mm[0])
    flow.force_N = flow.force_N * (1.0 + values[0] * direction_state(flow.deformation_mm, values[1], start))


def _mullins_softening(flow: Flow, values: Sequence[float], state: Memory) -> None:
    presses = completed_presses(flow.deformation_mm, memory(state, "presses", 0.0, 0.0))
    flow.force_N = flow.force_N * (1.0 + values[0] * np.expm1(-presses / values[1]))


def _shift_2(flow: Flow, v: Sequence[float], _: Memory) -> None:
    # expm1, since 1 - exp(-x) loses its digits where x is small.
    settled = v[0] * -np.expm1(-flow.t_s / v[1]) + v[2] * -np.expm1(-flow.t_s / v[3])
    flow.contact_mm = flow.contact_mm + settled


def _frame_joint(flow: Flow, v: Sequence[float], _: Memory) -> None:
    flow.compliance_mm_N = v[0]
    flow.toe_mm = v[1]


def _relaxation_2(flow: Flow, v: Sequence[float], state: Memory) -> None:
    flow.force_N = np.maximum(0.0, flow.force_N - two_low_passes(flow.force_N, flow.step_s, v, state))


def _mechanical_2(flow: Flow, v: Sequence[float], state: Memory) -> None:
    flow.force_N = flow.force_N * loops(flow.deformation_mm, v, state)


def _force_stops(flow: Flow, v: Sequence[float], state: Memory) -> None:
    flow.force_N = np.maximum(0.0, flow.force_N + _touching(flow) * stops(flow.force_N, v, state, "reach_N"))


def _stroke_stops(flow: Flow, v: Sequence[float], state: Memory) -> None:
    # Stops act on lengths here; the mean stiffness of the run carries them to newtons.
    def read() -> float:
        return float(np.max(flow.force_N)) / (float(np.max(flow.deformation_mm)) or 1.0)

    stiffness = constant(v, state, len(STOPS) + 1, "stiffness_N_mm", read)
    bent_mm = stops(flow.deformation_mm, v, state, "reach_mm")
    flow.force_N = np.maximum(0.0, flow.force_N + _touching(flow) * stiffness * bent_mm)


def _touching(flow: Flow) -> Array:
    return (flow.deformation_mm > 0).astype(np.float64)


def _mullins_power(flow: Flow, v: Sequence[float], state: Memory) -> None:
    done = completed_presses(flow.deformation_mm, memory(state, "presses", 0.0, 0.0))
    flow.force_N = flow.force_N * (1.0 + v[0] * ((1.0 + done / v[1]) ** -v[2] - 1.0))


def _mullins_deepest(flow: Flow, v: Sequence[float], state: Memory) -> None:
    last = memory(state, "deepest_mm", 0.0)
    deepest = np.maximum(np.maximum.accumulate(flow.deformation_mm), last[0])
    last[0] = deepest[-1]
    flow.force_N = flow.force_N * (1.0 + v[0] * np.expm1(-deepest / v[1]))


SOFTENING = Parameter("m", "", 0.0, 0.8, 0.1, neutral=0.0)

EFFECTS = (
    Effect(
        id="contact_shift",
        stage="mechanics",
        hook=Hook.CONTACT,
        equation="u0(t) = u0 + s·(1 − exp(−t/τ))",
        source="settling of an adhesive or of the pad on its bed; exponential approach",
        parameters=(
            Parameter("s", "mm", -0.5, 0.5, 0.08, neutral=0.0),
            Parameter("tau", "s", 2.0, 1000.0, 40.0, scale="log"),
        ),
        step=_contact_shift,
        signs=Signs(
            probes=Shapes(0.007, (0.05, 0.15, 0.5, 1.5), "duration_s", "depth_mm"),
            hides_behind=("mullins_softening", "stress_relaxation"),
            shown_by=("slow_touch_down",),
            remedy=PLATEN,
        ),
    ).with_forms(two(_shift_2, "two settling times")),
    Effect(
        id="frame_compliance",
        stage="mechanics",
        hook=Hook.CONTACT,
        equation="δ = max(0, u − u0 − c_f·F), solved for F",
        source="spring in series, Hooke; 1–50 µm/N for bench stands",
        parameters=(Parameter("c_f", "mm/N", 0.0, 0.2, 0.03, neutral=0.0),),
        step=_frame_compliance,
        signs=Signs(
            probes=Sizes((0.02, 0.06), "softness_mm_N"),
            hides_behind=("loadcell_saturation", "misaligned_contact", "loadcell_nonlinearity"),
            shown_by=("rigid_block",),
            remedy=PLATEN,
        ),
    ).with_forms(plus(_frame_joint, "joint that closes", (Parameter("l", "mm", 0.0, 0.5, 0.05), 0.01))),
    Effect(
        id="misaligned_contact",
        stage="mechanics",
        hook=Hook.CONTACT,
        equation="δ → δ − ℓ·(1 − exp(−δ/ℓ))",
        source="toe region of a compression curve, ASTM D695 annex on toe compensation",
        parameters=(Parameter("l", "mm", 0.0, 0.8, 0.2, neutral=0.0),),
        step=_misaligned_contact,
        signs=Signs(
            probes=Sizes((0.03, 0.15), "depth_mm"),
            hides_behind=("frame_compliance",),
            shown_by=("slow_touch_down",),
            remedy=PLATEN,
        ),
    ).with_forms(
        # An edge that is rounded or not straight goes on closing long after the pad is touched.
        plus(_toe_with_tail, "toe that fades by a power", (Parameter("tail", "", 0.0, 3.0, 0.5), 0.3))
    ),
    Effect(
        id="stress_relaxation",
        stage="mechanics",
        hook=Hook.FORCE,
        equation="F = max(0, Fe − g·LP_τ[Fe])",
        source="standard linear solid, Zener 1948; 2–20 % per decade in virgin Ecoflex",
        parameters=(
            Parameter("g", "", 0.0, 0.8, 0.1, neutral=0.0),
            Parameter("tau", "s", 0.03, 300.0, 5.0, scale="log"),
        ),
        step=_stress_relaxation,
        signs=Signs(
            probes=Times(0.02),
            hides_behind=("mechanical_hysteresis", "loadcell_creep"),
            shown_by=("steps_with_holds", "rate_sweep", "long_hold"),
        ),
    ).with_forms(two(_relaxation_2, "two relaxation times")),
    Effect(
        id="mechanical_hysteresis",
        stage="mechanics",
        hook=Hook.FORCE,
        equation="F = Fe·(1 + a·z), dz/dt = (dδ/dt)/d0·(1 − z·sign(dδ/dt))",
        source="rate-independent hysteresis, Duhem form; loops of 2–10 % in silicone rubber",
        parameters=(
            Parameter("a", "", 0.0, 0.5, 0.05, neutral=0.0),
            Parameter("d0", "mm", 0.02, 5.0, 0.3, scale="log"),
        ),
        step=_mechanical_hysteresis,
        signs=Signs(
            probes=Shapes(0.01, (0.02, 0.06, 0.2, 0.6), "depth_mm"),
            hides_behind=("stress_relaxation", "backlash"),
            shown_by=("rate_sweep", "small_reversals"),
        ),
    ).with_forms(
        two(_mechanical_2, "two loops"),
        stop_form(_force_stops, "stop operators on the force", "reach_N"),
        stop_form(_stroke_stops, "stop operators on the compression", "reach_mm", "stiffness_N_mm"),
    ),
    Effect(
        id="mullins_softening",
        stage="mechanics",
        hook=Hook.FORCE,
        equation="F = Fe·(1 − m·(1 − exp(−N/N0))), N = completed compressions",
        source="Mullins 1969; 5–30 % in virgin silicone",
        parameters=(SOFTENING, Parameter("N0", "", 0.2, 50.0, 3.0, scale="log")),
        step=_mullins_softening,
        signs=Signs(
            probes=Shapes(0.02, (0.5, 2.0, 8.0)), hides_behind=("contact_shift",), shown_by=("amplitude_ladder", "rest")
        ),
    ).with_forms(
        plus(_mullins_power, "power of the presses", (POWER, 0.5)),
        in_form(
            _mullins_deepest,
            "softening with the deepest press so far",
            (SOFTENING, Parameter("depth", "mm", 0.1, 20.0, 2.0, scale="log")),
            ((0, 1.0), (None, 2.0)),
        ),
    ),
)
