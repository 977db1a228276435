"""Where the search for each effect begins on a given case: probe sizes and grids for its shape parameters."""

from dataclasses import dataclass

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Effect

TAU_s = (0.05, 0.2, 0.6, 2.0, 6.0, 20.0, 60.0)


@dataclass(frozen=True)
class Probe:
    """An effect at a small size and one shape, to see which way it would move the prediction.

    Args:
        values: parameter values, the size first.
        is_one_sided: the size cannot change its sign.
    """

    effect: Effect
    values: tuple[float, ...]
    is_one_sided: bool


@dataclass(frozen=True)
class Extent:
    """How far a case reaches: deepest press, largest force, outputs, longest run, sample period."""

    depth_mm: float
    force_N: float
    lowest_V: float
    highest_V: float
    duration_s: float
    period_s: float

    @classmethod
    def of(cls, case: Case, deformation_mm: float, force_N: float) -> "Extent":
        """Measure a case; deformation and force come from the fitted base."""
        outputs = [run.output_V for run in case.presses if run.output_V is not None]
        every_V = np.concatenate(outputs) if outputs else np.array([0.0, 1.0])
        return cls(
            depth_mm=max(deformation_mm, 1e-3),
            force_N=max(force_N, 1e-3),
            lowest_V=float(every_V.min()),
            highest_V=float(every_V.max()),
            duration_s=max(float(run.elapsed_s[-1]) for run in case.presses),
            period_s=1.0 / case.readout.sample_rate_Hz,
        )


def visible_effects(case: Case) -> tuple[str, ...]:
    """Return the identifiers of the effects that the recorded channels can show at all."""
    temperature = any(run.temperature_C is not None and np.ptp(run.temperature_C) > 0 for run in case.presses)
    return tuple(
        e.id for e in EFFECTS.values() if e.stage not in case.unseen_stages and (temperature or e.id != "thermal_drift")
    )


def probes(case: Case, extent: Extent) -> tuple[Probe, ...]:
    """Return the probes of every visible effect whose place in time need not be searched first."""
    out = []
    for effect_id in visible_effects(case):
        effect = EFFECTS[effect_id]
        if effect.is_episodic or effect_id == "mains_hum":
            continue
        first = effect.parameters[0]
        one_sided = first.low == 0.0 or first.scale == "inverse_square" or effect_id == "adc_saturation"
        out += [Probe(effect, tuple(map(float, row)), one_sided) for row in _grid(effect_id, extent)]
    return tuple(out)


def _grid(effect_id: str, at: Extent) -> list[tuple[float, ...]]:
    sizes: dict[str, Array | tuple[float, ...]] = {
        "backlash": (0.02, 0.1),
        "frame_compliance": (0.02 * at.depth_mm / at.force_N, 0.06 * at.depth_mm / at.force_N),
        "misaligned_contact": (0.03 * at.depth_mm, 0.15 * at.depth_mm),
        "thermal_drift": (0.001,),
        "readout_lag": (0.5 * at.period_s, 3 * at.period_s, 10 * at.period_s),
        "wiring_resistance": (0.1, 1.0),
        "reference_drift": (0.01 / at.duration_s,),
        "adc_saturation": at.highest_V - (at.highest_V - at.lowest_V) * np.array([1e-3, 0.01, 0.03, 0.08]),
        "loadcell_saturation": (4.0 * at.force_N,),
        "loadcell_nonlinearity": (0.01,),
        "loadcell_drift": (0.1 / at.duration_s,),
        "clock_offset": (0.5 * at.period_s, -0.5 * at.period_s),
        "clock_skew": (2 * at.period_s / at.duration_s,),
    }
    if effect_id in sizes:
        return [(size,) for size in sizes[effect_id]]
    taus = [tau for tau in TAU_s if tau < at.duration_s]
    shapes: dict[str, tuple[float, list[float]]] = {
        "contact_shift": (0.02, [at.duration_s * share for share in (0.05, 0.15, 0.5, 1.5)]),
        "stress_relaxation": (0.02, taus),
        "channel_creep": (0.02, taus),
        "loadcell_creep": (0.01, taus[2:]),
        "mechanical_hysteresis": (0.01, [at.depth_mm * share for share in (0.02, 0.06, 0.2, 0.6)]),
        "channel_hysteresis": (0.01, [at.force_N * share for share in (0.02, 0.06, 0.2, 0.6)]),
        "mullins_softening": (0.02, [0.5, 2.0, 8.0]),
        "channel_collapse": (0.01, [at.force_N * share for share in (0.1, 0.3, 0.5, 0.65, 0.8, 0.9)]),
        "ageing_drift": (0.001, [at.duration_s * share for share in (0.01, 0.05, 0.2, 1.0)]),
    }
    size, grid = shapes[effect_id]
    low, high = EFFECTS[effect_id].parameters[1].low, EFFECTS[effect_id].parameters[1].high
    return [(size, float(np.clip(shape, low, high))) for shape in grid]
