"""What the twin predicts for one run of a case: the clean value of every recorded channel."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.case import Run
from softcal.core.recording import Array
from softcal.core.twin.effects import Flow, Hook
from softcal.core.twin.load_cell import read_force
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Chain, Values

RETRACTED_mm = -1e3
"""Stage position that stands for a rest: far above the pad."""

INVERSE_STEPS = 4
"""Fixed-point steps that turn a reading back into a force; effects of a few per cent are undone to 1e-6."""

TOUCHING_share = 0.05
"""A rigid block is taken as touched above this share of the largest force."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Clean channels of one run, (n,) each, None where the run cannot show it, NaN where nobody can know."""

    force_N: Array | None = None
    output_V: Array | None = None
    stage_mm: Array | None = None
    """Of a rigid block: where the stage must be when this force is read."""

    def channel(self, name: str) -> Array | None:
        """Return the predicted channel by its column name."""
        return {"force_N": self.force_N, "output_V": self.output_V, "stage_mm": self.stage_mm}[name]


def predict(
    run: Run, index: int, base: BaseParameters, chain: Chain, values: Values, episodes: Mapping[str, Array]
) -> Prediction:
    """Return what the base twin with the effects of a chain says of one run.

    Args:
        run: its stage position drives the chain; where there is none, its force does.
        index: position of the run in its case, for effects with values of their own per run.
        values: parameter values, one row per effect of the chain.
        episodes: rows of episodic effects in this run.
    """
    stage_mm = run.elapsed_s if run.stage_mm is None else run.stage_mm
    flow = Flow(run.elapsed_s, run.step_s, stage_mm, run.temperature_rise_K, run.readout.vref_V, episodes, index)
    if run.kind == "rigid_block":
        return _rigid_block(run, flow, chain, values)
    if run.kind == "dead_weights":
        flow.force_N = np.asarray(run.known_force_N)
        memories = chain.fresh_memories()
        read_force(flow)
        chain.apply(Hook.READING, flow, values, memories)
        return Prediction(force_N=flow.reading_N)
    if run.kind == "dummy_resistor":
        flow.resistance_ohm = np.full(len(run), float(run.dummy_ohm or 0.0))
        chain.read_out(flow, run.readout, values, chain.fresh_memories())
        return Prediction(output_V=_read_output(flow))
    if run.kind == "rest":
        flow.stage_mm = np.full(len(run), RETRACTED_mm)
    elif run.stage_mm is None:
        return _from_force(run, flow, base, chain, values)
    memories = chain.fresh_memories()
    chain.run(flow, base, run.readout, values, memories)
    return Prediction(flow.reading_N, _read_output(flow))


def _read_output(flow: Flow) -> Array:
    """Return the output as far as the run tells it; NaN after its end and at the first sample of a step."""
    # Not np.clip, which takes three times as long.
    output_V = np.minimum(np.maximum(flow.output_V, 0.0), flow.vref_V)
    return output_V if flow.is_unforeseeable is None else np.where(flow.is_unforeseeable, np.nan, output_V)


def _from_force(run: Run, flow: Flow, base: BaseParameters, chain: Chain, values: Values) -> Prediction:
    reading_N = run.driving_force.force_N
    force_N = reading_N
    for _ in range(INVERSE_STEPS):
        flow.force_N = force_N
        chain.weigh(flow, values, chain.fresh_memories())
        # What the cell would read beyond its reading is taken off the force until both agree.
        force_N = force_N + reading_N - flow.reading_N
    flow.force_N = flow.deformation_mm = force_N
    chain.sense(flow, base, run.readout, values, chain.fresh_memories())
    return Prediction(output_V=_read_output(flow))


def _rigid_block(run: Run, flow: Flow, chain: Chain, values: Values) -> Prediction:
    """A rigid block gives way only where the frame does: u − play = const + c_f·F while it is touched."""
    force_N = np.asarray(run.force_N)
    flow.pad_mm = flow.stage_mm
    memories = chain.fresh_memories()
    chain.apply(Hook.MOTION, flow, values, memories)
    chain.apply(Hook.CONTACT, flow, values, memories)
    is_touched = force_N > TOUCHING_share * force_N.max()
    bent_mm = flow.compliance_mm_N * force_N + (flow.stage_mm - flow.pad_mm)
    if not is_touched.any():
        return Prediction(stage_mm=flow.stage_mm)
    # Nobody measured where the block stands: its level is what the touched samples say on average.
    level_mm = float(np.mean((flow.stage_mm - bent_mm)[is_touched]))
    return Prediction(stage_mm=np.where(is_touched, level_mm + bent_mm, flow.stage_mm))
