"""Motion: the recorded stage position becomes the position of the pad."""

from collections.abc import Sequence

from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, Signs, memory
from softcal.core.twin.probes import Sizes
from softcal.core.twin.signals import play
from softcal.core.words.reason import Reason

PLATEN = Reason("gap.remedy.platen")
"""What tells effects of motion and mechanics apart where no run does."""


def _backlash(flow: Flow, values: Sequence[float], state: Memory) -> None:
    start = memory(state, "position_mm", flow.pad_mm[0] - values[0])
    flow.pad_mm = play(flow.pad_mm, values[0], start)


BACKLASH = Effect(
    id="backlash",
    stage="motion",
    hook=Hook.MOTION,
    equation="the pad follows u through a play operator of width b",
    source="play operator, Brokate and Sprekels 1996; 5–20 µm for ball screws, 20–150 µm for lead screws",
    parameters=(Parameter("b", "mm", 0.0, 1.0, 0.05, neutral=0.0),),
    step=_backlash,
    signs=Signs(
        probes=Sizes((0.007, 0.035), "depth_mm"),
        hides_behind=("loadcell_creep", "mechanical_hysteresis"),
        shown_by=("small_reversals", "rigid_block"),
        remedy=PLATEN,
    ),
)

EFFECTS = (BACKLASH,)
