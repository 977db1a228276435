"""The pad sticks: on the way out it is pulled by −Fa·exp(−δ/d) while the surfaces touch."""

from collections.abc import Sequence

import numpy as np

from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs, memory
from softcal.core.twin.probes import Shapes
from softcal.core.twin.signals import direction_state

TURN_mm = 0.02
"""Way on which the contact line turns round after a reversal."""


def _adhesion(flow: Flow, values: Sequence[float], state: Memory) -> None:
    pull_N, reach_mm = values
    start = memory(state, "z", 0.0, flow.deformation_mm[0])
    leaving = 0.5 * (1.0 - direction_state(flow.deformation_mm, TURN_mm, start))
    touching = flow.deformation_mm > 0.0
    flow.force_N = flow.force_N - pull_N * np.exp(-flow.deformation_mm / reach_mm) * leaving * touching


ADHESION = Effect(
    id="adhesion",
    stage="mechanics",
    hook=Hook.FORCE,
    equation="F = Fe − Fa·exp(−δ/d) on the way out, while the surfaces touch",
    source="tack of silicone on a flat punch; 0.01–0.5 N",
    parameters=(
        Parameter("Fa", "N", 0.0, 2.0, 0.2, neutral=0.0),
        Parameter("d", "mm", 0.02, 2.0, 0.2, scale="log"),
    ),
    step=_adhesion,
    signs=Signs(
        probes=Shapes(0.02, (0.02, 0.06, 0.2), "depth_mm"),
        confounders=("loadcell_drift",),
        best_experiments=("slow_touch_down", "small_reversals"),
    ),
)
