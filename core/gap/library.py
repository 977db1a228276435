"""What a residual may follow: variables that the chain knows, as columns over the samples."""

from collections.abc import Iterator, Mapping

import numpy as np

from softcal.core.gap.case import Run
from softcal.core.gap.fit import Fit
from softcal.core.gap.method import METHOD
from softcal.core.recording import Array
from softcal.core.twin.mechanics import elastic_force
from softcal.core.twin.signals import low_pass


def variables(found: Fit, channel: str) -> Mapping[str, Array]:
    """Return (samples,) columns by name, each 0 outside the pressed runs of a channel.

    Depth, speed and load are those of the fitted base; a load of 1 is the largest of the case.
    """
    problem = found.problem
    out: dict[str, Array] = {}
    blocks = [b for b in problem.blocks_of(channel, "press") if problem.case.runs[b.run].stage_mm is not None]
    if not blocks:
        return {}
    runs = [problem.case.runs[b.run] for b in blocks]
    depths = [np.maximum(np.asarray(run.stage_mm) - found.base.u0_mm, 0.0) for run in runs]
    loads = [elastic_force(depth, found.base.k1_N_mm, found.base.k3_N_mm3) for depth in depths]
    deepest, largest = (max(float(part.max()) for part in parts) or 1.0 for parts in (depths, loads))
    for block, run, depth, load in zip(blocks, runs, depths, loads, strict=True):
        for name, column in _columns(run, depth / deepest, load / largest):
            out.setdefault(name, np.zeros(len(problem.measured)))[block.place] = column
    return out


def columns_of(signal: Array, run: Run, times: float) -> dict[str, list[Array]]:
    """Return what a residual may follow of any signal: groups of (n,) columns, as they may be tested one by one.

    Args:
        signal: (n,) within −1 and 1.
        times: by what this rig is slower than a common one; the memories fade by so much more slowly.
    """
    rate = np.gradient(signal, run.t_s)
    way, quick = np.sign(rate), np.gradient(rate, run.t_s)
    places = [2.0 * k / (METHOD.floor.hats - 1) - 1.0 for k in range(METHOD.floor.hats)]
    memories = [low_pass(signal, run.step_s, times * tau_s, np.zeros(2)) for tau_s in METHOD.floor.memory_s]
    return {
        "level": [np.maximum(0.0, 1.0 - 0.5 * (METHOD.floor.hats - 1) * np.abs(signal - place)) for place in places],
        "way": [way, signal * way, signal**2 * way],
        "rate": [rate, np.abs(rate), rate * np.abs(rate), signal * rate, quick],
        "memory": [*memories, *(signal * remembered for remembered in memories)],
        "time": [run.elapsed_s, signal * run.elapsed_s],
    }


def _columns(run: Run, depth: Array, load: Array) -> Iterator[tuple[str, Array]]:
    """Yield every variable of a run; depth and load are relative to the largest of the case."""
    t_s = run.elapsed_s
    rate = np.gradient(load, t_s)
    for k in range(METHOD.floor.hats):
        place = (k + 1) / METHOD.floor.hats
        yield (
            f"depth near {place:.2f}",
            np.maximum(0.0, 1.0 - METHOD.floor.hats * np.abs(depth - place)) * (depth > 0.0),
        )
    direction = np.sign(rate)
    yield "time", t_s
    yield "load × time", load * t_s
    yield "direction", direction
    yield "load × direction", load * direction
    yield "load² × direction", load**2 * direction
    yield "load rate", rate
    yield "load × load rate", load * rate
    yield "acceleration", np.gradient(np.gradient(depth, t_s), t_s)
    yield "position", np.asarray(run.stage_mm)
    yield "deepest so far", np.maximum.accumulate(depth)
    yield "load × deepest so far", load * np.maximum.accumulate(depth)
    if run.temperature_rise_K is not None:
        yield "temperature", run.temperature_rise_K
        yield "load × temperature", load * run.temperature_rise_K
    for tau_s in METHOD.floor.memory_s:
        remembered = low_pass(load, run.step_s, tau_s, np.zeros(2))
        yield f"load over the last {tau_s:g} s", remembered
        yield f"load × load over the last {tau_s:g} s", load * remembered
