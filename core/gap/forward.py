"""What the twin predicts for one run of a case: the clean value of every recorded channel.

The mean of the codes of an ADC that is coarse against its noise is a soft staircase of the clean output. With noise σ
before a rounding to steps q, E[round(V + n)] = V + Σ (−1)ᵏ·q/(πk)·sin(2πkV/q)·exp(−2(πkσ/q)²), and the variance around
that mean, averaged over V, is σ² + q²/12 − Σ q²/(2π²k²)·exp(−(2πkσ/q)²) (Widrow and Kollár, Quantization Noise, 2008).
From σ = 0.45 q on the stairs are below 1 % of a step.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.optimize import brentq

from softcal.core.gap.case import Run
from softcal.core.recording import Array
from softcal.core.twin.effects import Flow, Hook
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.signals import compiled
from softcal.core.twin.simulate import Chain, Values

if TYPE_CHECKING:
    from softcal.core.gap.problem import Problem

RETRACTED_mm = -1e3
"""Stage position that stands for a rest: far above the pad."""

INVERSE_STEPS = 4
"""Fixed-point steps from a reading back to a force: a few per cent are undone to 1e-6."""

TOUCHING_share = 0.05
"""A rigid block is taken as touched above this share of the largest force."""

Prediction: TypeAlias = dict[str, Array]
"""Clean channels that a run can show, (n,) each, NaN where nobody can know; of a rigid block `stage_mm`, where the
stage must be when this force is read."""


def predict_run(
    run: Run, index: int, base: BaseParameters, chain: Chain, values: Values, episodes: Mapping[str, Array]
) -> Prediction:
    """Return what the base twin with the effects of a chain says of one run.

    Args:
        index: position of the run in its case, for effects with values of their own per run.
    """
    stage_mm = run.elapsed_s if run.stage_mm is None else run.stage_mm
    flow = Flow(run.elapsed_s, run.step_s, stage_mm, run.temperature_rise_K, run.readout.vref_V, episodes, index)
    if run.kind == "rigid_block":
        return _rigid_block(run, flow, chain, values)
    if run.kind == "dead_weights":
        flow.force_N = np.asarray(run.known_force_N)
        chain.weigh(flow, values, chain.fresh_memories())
        return {"force_N": flow.reading_N}
    if run.kind == "dummy_resistor":
        flow.resistance_ohm = np.full(len(run), float(run.dummy_ohm or 0.0))
        chain.read_out(flow, run.readout, values, chain.fresh_memories())
        return {"output_V": _read_output(flow)}
    if run.kind == "rest":
        flow.stage_mm = np.full(len(run), RETRACTED_mm)
    elif run.stage_mm is None:
        force_N = reading_N = run.driving_force.force_N
        for _ in range(INVERSE_STEPS):
            flow.force_N = force_N
            chain.weigh(flow, values, chain.fresh_memories())
            # What the cell would read beyond its reading is taken off the force until both agree.
            force_N = force_N + reading_N - flow.reading_N
        flow.force_N = flow.deformation_mm = force_N
        chain.sense(flow, base, run.readout, values, chain.fresh_memories())
        return {"output_V": _read_output(flow)}
    chain.run(flow, base, run.readout, values, chain.fresh_memories())
    return {"force_N": flow.reading_N, "output_V": _read_output(flow)}


def _read_output(flow: Flow) -> Array:
    # Not np.clip, which takes three times as long.
    output_V = np.minimum(np.maximum(flow.output_V, 0.0), flow.vref_V)
    return output_V if flow.is_unforeseeable is None else np.where(flow.is_unforeseeable, np.nan, output_V)


def _rigid_block(run: Run, flow: Flow, chain: Chain, values: Values) -> Prediction:
    """A rigid block gives way as the frame does: u − play = const + c_f·F while touched."""
    force_N = np.asarray(run.force_N)
    flow.pad_mm = flow.stage_mm
    memories = chain.fresh_memories()
    chain.apply(Hook.MOTION, flow, values, memories)
    chain.apply(Hook.CONTACT, flow, values, memories)
    is_touched = force_N > TOUCHING_share * force_N.max()
    bent_mm = flow.compliance_mm_N * force_N + (flow.stage_mm - flow.pad_mm)
    if not is_touched.any():
        return {"stage_mm": flow.stage_mm}
    # Nobody measured where the block stands: its level is what the touched samples say on average.
    level_mm = float(np.mean((flow.stage_mm - bent_mm)[is_touched]))
    return {"stage_mm": np.where(is_touched, level_mm + bent_mm, flow.stage_mm)}


SMOOTH = 0.45
"""Noise, in steps, from which the staircase is a straight line."""

SHARPEST = 0.05
"""Least noise, in steps, that is told apart: sharper stairs than that have no slope to fit by."""

HARMONICS = 12


@lru_cache(maxsize=256)
def dither_V(sigma_V: float, step_V: float) -> float | None:
    """Return the noise before the ADC from that of its codes, None where the stairs are smooth."""
    target = (sigma_V / step_V) ** 2
    if target >= _variance(SMOOTH):
        return None
    if target <= _variance(SHARPEST):
        return SHARPEST * step_V
    return step_V * float(brentq(lambda noise: _variance(noise) - target, SHARPEST, SMOOTH))


def dither_of(problem: "Problem") -> float | None:
    """Return the noise before an ADC that is coarse against it; None where its stairs do not show."""
    if "output_V" not in problem.sigma:
        return None
    return dither_V(problem.floor("output_V"), problem.case.readout.step_V)


def _variance(noise: float) -> float:
    """Return the variance of the codes in steps², for noise in steps."""
    k = np.arange(1, 40)
    return float(noise**2 + 1 / 12 - np.sum(np.exp(-((2 * np.pi * k * noise) ** 2)) / (2 * np.pi**2 * k**2)))


@compiled
def mean_code_V(clean_V: Array, noise_V: float, step_V: float) -> Array:
    """Return the mean of the codes, (n,) V, for a clean output and noise before the ADC."""
    out = clean_V.copy()
    for k in range(1, HARMONICS + 1):
        height = step_V / (np.pi * k) * np.exp(-2.0 * (np.pi * k * noise_V / step_V) ** 2)
        # Higher harmonics die out faster than exponentially: the rest is still smaller.
        if height < 1e-4 * step_V:
            break
        height = -height if k % 2 else height
        for i in range(len(out)):
            out[i] += height * np.sin(2.0 * np.pi * k * clean_V[i] / step_V)
    return out


def bases_of(base: BaseParameters, sizes: Mapping[int, Array]) -> dict[int, BaseParameters]:
    """Return the base of every run that has one of its own."""
    return {
        run: base.with_values(u0_mm=base.u0_mm + seat, r0_ohm=base.r0_ohm * (1.0 + resistance))
        for run, (_, resistance, seat) in sizes.items()
    }


@compiled
def offset_rows(
    kinds: tuple[bool, bool], stage_mm: Array, clean: Array, vref_V: float, base: tuple[float, float, float, float]
) -> Array:
    """(3, n) change of a channel per N of tare, share of R0 and mm of seat, by the base."""
    is_force, is_strain = kinds
    u0_mm, k1_N_mm, k3_N_mm3, kappa_per_N = base
    out = np.zeros((3, len(clean)))
    for k in range(len(clean)):
        depth_mm = max(stage_mm[k] - u0_mm, 0.0)
        force_per_mm = -(k1_N_mm + 3.0 * k3_N_mm3 * depth_mm**2) if depth_mm > 0.0 else 0.0
        if is_force:
            out[0, k], out[2, k] = 1.0, force_per_mm
        elif not np.isnan(clean[k]):
            out[1, k] = clean[k] * (1.0 - clean[k] / vref_V)
            drive = depth_mm if is_strain else k1_N_mm * depth_mm + k3_N_mm3 * depth_mm**3
            per_mm = (-1.0 if depth_mm > 0.0 else 0.0) if is_strain else force_per_mm
            # A fit on its way may drive the base's resistance to infinity.
            out[2, k] = out[1, k] * kappa_per_N / max(1.0 - kappa_per_N * drive, 0.05) * per_mm
    return out
