"""Motion and mechanics: the stage carries the pad, whose position becomes a force.

F = k1·δ + k3·δ³ with δ = max(0, u − u0).
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from softcal.core.messages.reason import Reason
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs, grows, hands_on, memory, set_signal
from softcal.core.twin.forms import (
    POWER,
    STOPS,
    constant,
    custom_form,
    doubled_form,
    extended_form,
    loops,
    low_passes,
    pairs,
    stop_form,
    stops,
)
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.probes import Shapes, Sizes, TimeConstants
from softcal.core.twin.signals import compiled, completed_presses, largest_so_far, play

PLATEN = Reason("gap.remedy.platen")
"""What tells effects of motion and mechanics apart where no run does."""


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
    """Solve δ = toe(max(0, travel − c_f·F(δ))), monotone, by Newton from the sample before.

    Args:
        travel: (n,) u − u0 where positive, else 0, mm.
        softness: length ℓ and tail s of the toe, compliance c_f of the frame. The toe is x − ℓ·(1 −
            rest(x)) with rest(x) = exp(−x/ℓ), or (1 + s·x/ℓ)^(−1/s) with a tail; ℓ = 0 mm for none.
            c_f in mm/N, 0 for a rigid frame.
    """
    toe, tail, compliance = softness
    out = np.empty_like(travel)
    x = 0.0
    for k in range(len(travel)):
        target = travel[k]
        # The root moves little from sample to sample; a rigid frame has it at the target.
        x = min(x, target) if x > 0.0 else target
        deformation = 0.0
        for _ in range(30):
            rest, slope_part = _toe_rest(x, toe, tail)
            deformation = x - toe * (1.0 - rest)
            error = x + compliance * deformation * (k1 + k3 * deformation * deformation) - target
            slope = 1.0 + compliance * (k1 + 3.0 * k3 * deformation * deformation) * (1.0 - slope_part)
            # The root lies between 0 and the whole travel: a step beyond would only come back.
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
    growth = 1.0 + tail * x / toe
    rest = growth ** (-1.0 / tail)
    return rest, rest / growth


def _settled(flow: Flow, v: Sequence[float], _: Memory) -> Array:
    # expm1, since 1 - exp(-x) loses its digits where x is small.
    return np.asarray(flow.contact_mm + sum(s * -np.expm1(-flow.t_s / tau_s) for s, tau_s in pairs(v)))


def _force_stops(flow: Flow, v: Sequence[float], state: Memory) -> Array:
    return np.maximum(0.0, flow.force_N + (flow.deformation_mm > 0) * stops(flow.force_N, v, state, "reach_N"))


def _stroke_stops(flow: Flow, v: Sequence[float], state: Memory) -> Array:
    # Stops act on lengths here; the mean stiffness of the run carries them to newtons.
    def read() -> float:
        return float(np.max(flow.force_N)) / (float(np.max(flow.deformation_mm)) or 1.0)

    stiffness = constant(v, state, len(STOPS) + 1, "stiffness_N_mm", read)
    bent_mm = stops(flow.deformation_mm, v, state, "reach_mm")
    return np.maximum(0.0, flow.force_N + (flow.deformation_mm > 0) * stiffness * bent_mm)


def _presses(flow: Flow, state: Memory) -> Array:
    return completed_presses(flow.deformation_mm, memory(state, "presses", 0.0, 0.0))


SOFTENING = Parameter("m", "", 0.0, 0.8, 0.1, neutral=0.0)

in_stage = partial(Effect, stage="mechanics")

EFFECTS = (
    Effect(
        id="backlash",
        stage="motion",
        hook=Hook.MOTION,
        equation="the pad follows u through a play operator of width b",
        source="play operator, Brokate and Sprekels 1996; 5–20 µm for ball screws, 20–150 µm for lead screws",
        parameters=(Parameter("b", "mm", 0.0, 1.0, 0.05, neutral=0.0),),
        step=set_signal(
            "pad_mm", lambda flow, v, state: play(flow.pad_mm, v[0], memory(state, "y", flow.pad_mm[0] - v[0]))
        ),
        signs=Signs(
            probes=Sizes((0.007, 0.035), "depth_mm"),
            confounders=("loadcell_creep", "mechanical_hysteresis"),
            best_experiments=("small_reversals", "rigid_block"),
            remedy=PLATEN,
        ),
    ),
    in_stage(
        id="contact_shift",
        hook=Hook.CONTACT,
        equation="u0(t) = u0 + s·(1 − exp(−t/τ))",
        source="settling of an adhesive or of the pad on its bed; exponential approach",
        parameters=(
            Parameter("s", "mm", -0.5, 0.5, 0.08, neutral=0.0),
            Parameter("tau", "s", 2.0, 1000.0, 40.0, scale="log"),
        ),
        step=set_signal("contact_mm", _settled),
        signs=Signs(
            probes=Shapes(0.007, (0.05, 0.15, 0.5, 1.5), "duration_s", "depth_mm"),
            confounders=("mullins_softening", "stress_relaxation"),
            best_experiments=("slow_touch_down",),
            remedy=PLATEN,
        ),
    ).with_forms(doubled_form("two settling times")),
    in_stage(
        id="frame_compliance",
        hook=Hook.CONTACT,
        equation="δ = max(0, u − u0 − c_f·F), solved for F",
        source="spring in series, Hooke; 1–50 µm/N for bench stands",
        parameters=(Parameter("c_f", "mm/N", 0.0, 0.2, 0.03, neutral=0.0),),
        step=hands_on("compliance_mm_N"),
        signs=Signs(
            probes=Sizes((0.02, 0.06), "softness_mm_N"),
            confounders=("loadcell_saturation", "misaligned_contact", "loadcell_nonlinearity"),
            best_experiments=("rigid_block",),
            remedy=PLATEN,
        ),
    ).with_forms(
        extended_form(
            hands_on("compliance_mm_N", "toe_mm"), "joint that closes", (Parameter("l", "mm", 0.0, 0.5, 0.05), 0.01)
        )
    ),
    in_stage(
        id="misaligned_contact",
        hook=Hook.CONTACT,
        equation="δ → δ − ℓ·(1 − exp(−δ/ℓ))",
        source="toe region of a compression curve, ASTM D695 annex on toe compensation",
        parameters=(Parameter("l", "mm", 0.0, 0.8, 0.2, neutral=0.0),),
        step=hands_on("toe_mm"),
        signs=Signs(
            probes=Sizes((0.03, 0.15), "depth_mm"),
            confounders=("frame_compliance",),
            best_experiments=("slow_touch_down",),
            remedy=PLATEN,
        ),
    ).with_forms(
        # An edge that is rounded or not straight goes on closing long after the pad is touched.
        extended_form(
            hands_on("toe_mm", "toe_tail"), "toe that fades by a power", (Parameter("tail", "", 0.0, 3.0, 0.5), 0.3)
        )
    ),
    in_stage(
        id="stress_relaxation",
        hook=Hook.FORCE,
        equation="F = max(0, Fe − g·LP_τ[Fe])",
        source="standard linear solid, Zener 1948; 2–20 % per decade in virgin Ecoflex",
        parameters=(
            Parameter("g", "", 0.0, 0.8, 0.1, neutral=0.0),
            Parameter("tau", "s", 0.03, 300.0, 5.0, scale="log"),
        ),
        step=set_signal(
            "force_N",
            lambda flow, v, state: np.maximum(0.0, flow.force_N - low_passes(flow.force_N, flow.step_s, v, state)),
        ),
        signs=Signs(
            probes=TimeConstants(0.02),
            confounders=("mechanical_hysteresis", "loadcell_creep"),
            best_experiments=("steps_with_holds", "rate_sweep", "long_hold"),
        ),
    ).with_forms(doubled_form("two relaxation times")),
    in_stage(
        id="mechanical_hysteresis",
        hook=Hook.FORCE,
        equation="F = Fe·(1 + a·z), dz/dt = (dδ/dt)/d0·(1 − z·sign(dδ/dt))",
        source="rate-independent hysteresis, Duhem form; loops of 2–10 % in silicone rubber",
        parameters=(
            Parameter("a", "", 0.0, 0.5, 0.05, neutral=0.0),
            Parameter("d0", "mm", 0.02, 5.0, 0.3, scale="log"),
        ),
        step=set_signal("force_N", lambda flow, v, state: flow.force_N * loops(flow.deformation_mm, v, state)),
        signs=Signs(
            probes=Shapes(0.01, (0.02, 0.06, 0.2, 0.6), "depth_mm"),
            confounders=("stress_relaxation", "backlash"),
            best_experiments=("rate_sweep", "small_reversals"),
        ),
    ).with_forms(
        doubled_form("two loops"),
        stop_form(set_signal("force_N", _force_stops), "stop operators on the force", "reach_N"),
        stop_form(
            set_signal("force_N", _stroke_stops), "stop operators on the compression", "reach_mm", "stiffness_N_mm"
        ),
    ),
    in_stage(
        id="mullins_softening",
        hook=Hook.FORCE,
        equation="F = Fe·(1 − m·(1 − exp(−N/N0))), N = completed compressions",
        source="Mullins 1969; 5–30 % in virgin silicone",
        parameters=(SOFTENING, Parameter("N0", "", 0.2, 50.0, 3.0, scale="log")),
        step=grows("force_N", lambda flow, v, state: np.expm1(-_presses(flow, state) / v[1])),
        signs=Signs(
            probes=Shapes(0.02, (0.5, 2.0, 8.0)),
            confounders=("contact_shift",),
            best_experiments=("amplitude_ladder", "rest"),
        ),
    ).with_forms(
        extended_form(
            grows("force_N", lambda flow, v, state: (1.0 + _presses(flow, state) / v[1]) ** -v[2] - 1.0),
            "power of the presses",
            (POWER, 0.5),
        ),
        custom_form(
            grows(
                "force_N",
                lambda flow, v, state: np.expm1(
                    -largest_so_far(flow.deformation_mm, memory(state, "deepest_mm", 0.0)) / v[1]
                ),
            ),
            "softening with the deepest press so far",
            (SOFTENING, Parameter("depth", "mm", 0.1, 20.0, 2.0, scale="log")),
            ((0, 1.0), (None, 2.0)),
        ),
    ),
)
